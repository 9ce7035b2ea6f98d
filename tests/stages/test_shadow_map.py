"""Shadows of one directional light: none where nothing is above, and how near they come to the exact projection."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from hand_made import surface

from jaxraster.geometry.shapes import merge
from jaxraster.light import shadow_map as file
from jaxraster.light.shadow_map import ShadowMap
from jaxraster.math.transform import frame
from jaxraster.scene import Directional, Mesh
from jaxraster.stack import stack_lights

# One shape for all: meshes are padded with faces without area, and there are always so many receivers.
VERTICES, FACES, SIDE = 48, 20, 64
SETTINGS = {size: ShadowMap(resolution=size) for size in (32, 64, 128)}
MARGIN = SETTINGS[64].margin
CAMERA = small.camera()


def shares(here, mesh, sun: Directional, settings) -> jax.Array:
    """The share of each directional light at each place."""
    lights = replace(stack_lights(), directional=sun)
    share = file.shadow_map(here, mesh, lights, CAMERA, settings)
    return share["directional"] if share else jnp.ones((len(sun.direction), *here.alpha.shape))


@jax.jit
def shadow_map(here, mesh, sun, settings):
    return shares(here, mesh, sun, settings)[0]


def padded(vertices, faces) -> Mesh:
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces, np.int32)
    vertices = np.concatenate([vertices, np.repeat(vertices[:1], VERTICES - len(vertices), axis=0)])
    faces = np.concatenate([faces, np.zeros((FACES - len(faces), 3), np.int32)])
    sizes = {"normals": 3, "tangents": 4, "uvs": 2}
    unused = {name: jnp.zeros((VERTICES, size)) for name, size in sizes.items()}
    return Mesh(
        vertices=jnp.asarray(vertices), faces=jnp.asarray(faces), material=jnp.zeros(FACES, jnp.int32), **unused
    )


def quads(*corners) -> Mesh:
    """Squares `[4, 3]` as a mesh."""
    faces = 4 * np.arange(len(corners))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return padded(np.concatenate(corners), faces.reshape(-1, 3))


def level(half: float, height: float = 0.0) -> np.ndarray:
    """A square that faces +Y."""
    return np.array([[-half, height, -half], [-half, height, half], [half, height, half], [half, height, -half]])


def cube(half: float) -> list[np.ndarray]:
    """Six sides of a cube that stands on the floor."""
    sides = []
    for axis in range(3):
        for sign in (-1, 1):
            corners = np.zeros((4, 3))
            corners[:, axis] = sign * half
            corners[:, [(axis + 1) % 3, (axis + 2) % 3]] = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
            sides.append(corners[::sign] + np.array([0, half, 0]))
    return sides


def sun(*directions) -> Directional:
    directions = np.array(directions, float)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Directional(direction=jnp.asarray(directions, jnp.float32), irradiance=jnp.ones(directions.shape))


def lit(places, normal, mesh, direction, size=64) -> np.ndarray:
    return np.asarray(shadow_map(surface(places, normal), mesh, sun(direction), SETTINGS[size]))


STEPS = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
SQUARE = np.stack(np.meshgrid(STEPS, STEPS), axis=-1).reshape(-1, 2)
# 4096 places all over a floor of ±4 m.
FLOOR = np.stack([4 * SQUARE[:, 0], 0 * SQUARE[:, 0], 4 * SQUARE[:, 1]], axis=-1)
UP = (0.0, 1.0, 0.0)


def fitted(mesh: Mesh, direction, size: int) -> tuple[np.ndarray, np.ndarray]:
    """The map's two axes `[3, 2]` across the light, and its texels on either axis in metres; double precision."""
    axes = np.concatenate(frame(-sun(direction).direction)).astype(np.float64).T
    return axes, np.ptp(np.asarray(mesh.vertices, np.float64) @ axes, axis=0) / (size - 2 * MARGIN)


def in_texels(points, mesh: Mesh, direction, size: int) -> np.ndarray:
    """Places in the map, in texels."""
    axes, texel = fitted(mesh, direction, size)
    return points @ axes / texel


# -- What is lit -------------------------------------------------------------------------------------------------------


def tilted(degrees: float, azimuth: float) -> np.ndarray:
    """A rotation by an angle about a horizontal axis."""
    x, z, angle = np.cos(azimuth), np.sin(azimuth), np.radians(degrees)
    across = np.array([[0, -z, 0], [z, 0, -x], [0, x, 0]])
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("tilt", [0, 15, 30, 45, 60, 75, 85, 89, 89.9])
def test_nothing_shadows_a_plane_of_itself(tilt, scale):
    """At the default bias, whichever way it leans, and at any size: exactly 1."""
    for azimuth in (0.0, 0.3, 1.0, 2.2, 4.0):
        turn = tilted(tilt, azimuth)
        corners, places = (scale * (points @ turn.T) for points in (level(4.0), FLOOR * 0.99999))
        assert (lit(places, turn @ UP, quads(corners), (0, -1, 0)) == 1).all(), azimuth


def test_less_bias_than_the_plane_needs_shows():
    """The receiver's plane must be followed in full: with half of it a steep plane shadows itself."""
    turn = tilted(75, 0.3)
    here, mesh, light = surface(FLOOR @ turn.T, turn @ UP), quads(level(4.0) @ turn.T), sun((0, -1, 0))
    bare = replace(SETTINGS[64], constant_bias=0.0, slope_bias=0.0, receiver_plane=0.5)
    assert shadow_map(here, mesh, light, bare).min() < 1


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
def test_light_along_each_axis(direction):
    """A large square across the light and a small one before it: the middle is dark, the rest lit."""
    direction = np.array(direction, float)
    axes = np.roll(np.eye(3), int(np.abs(direction).argmax()) - 1, axis=1)  # UP goes to the light's axis
    large, small = level(4.0) @ axes, level(1.0) @ axes - 2.0 * direction
    share = lit(FLOOR @ axes, direction, quads(large, small), direction)
    far = np.abs(FLOOR[:, [0, 2]]).max(axis=1)
    assert (share[far < 0.7] == 0).all() and (share[far > 1.3] == 1).all()
    # The small one itself is lit.
    near = lit(FLOOR @ axes * 0.2 - 2.0 * direction, direction, quads(large, small), direction)
    assert (near == 1).all()


def test_lit_from_below_the_floor_shadows_what_stands_on_it():
    mesh = quads(level(4.0), level(1.0, 2.0))
    assert (lit(FLOOR * 0.9, UP, mesh, (0.2, 1, 0.1)) == 1).all()
    above = FLOOR * 0.2 + np.array([0, 2, 0])
    assert (lit(above, UP, mesh, (0.2, 1, 0.1)) == 0).all()


def test_outside_the_map_everything_is_lit():
    """Far aside, above and below all there is; nothing is there to shadow it."""
    mesh = quads(level(4.0), level(1.0, 2.0))
    for offset in ((100, 0, 0), (0, 0, -100), (-50, -50, 3), (1e6, 1e6, 1e6), (-1e6, -1e7, 1e6), (0, 50, 0)):
        assert (lit(FLOOR + offset, UP, mesh, (0.3, -1, 0.2)) == 1).all(), offset
    # Straight below it the shadow goes on.
    assert (lit(FLOOR * 0.1 - [0, 50, 0], UP, mesh, (0, -1, 0)) == 0).all()


# -- What is not -------------------------------------------------------------------------------------------------------


def outside(points, polygon) -> np.ndarray:
    """Signed distance to a convex polygon's edges, the largest: negative inside."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=-1) / np.linalg.norm(edges, axis=1, keepdims=True)
    normals *= np.sign(((polygon - polygon.mean(axis=0)) * normals).sum(axis=1))[:, None]
    return ((points[:, None] - polygon) * normals).sum(axis=-1).max(axis=1)


@pytest.mark.parametrize("size", [32, 64, 128])
@pytest.mark.parametrize(
    ("direction", "reach"), [((0, -1, 0), 2.0), ((0.3, -1, 0.2), 2 * np.sqrt(2)), ((-1, -1, 0.5), 2 * np.sqrt(2))]
)
def test_a_floating_square_throws_its_projection(direction, reach, size):
    """Exact from two texels on along both axes, which is 2√2 across a corner of the filter's reach."""
    card = level(1.6, 2.0)
    mesh = quads(level(4.0), card)
    share = lit(FLOOR, UP, mesh, direction, size)
    beyond = outside(*(in_texels(points, mesh, direction, size) for points in (FLOOR, card)))
    wrong = np.abs(share - (beyond > 0)) > 0
    print(f"{size} texels: wrong up to {np.abs(beyond[wrong]).max():.2f} texels from the edge")
    assert (beyond < -reach).sum() > 10 and (beyond > reach).sum() > 1000
    assert (share[beyond < -reach] == 0).all() and (share[beyond > reach] == 1).all()


def test_the_error_halves_when_the_resolution_doubles():
    card = level(1.0, 2.0)
    mesh = quads(level(4.0), card)
    error = {}
    for size in SETTINGS:
        error[size] = np.mean(
            [
                np.abs(
                    lit(FLOOR, UP, mesh, d, size) - (outside(*(in_texels(p, mesh, d, size) for p in (FLOOR, card))) > 0)
                )
                for d in ((0.3, -1, 0.2), (-1, -1, 0.5), (0.1, -1, -0.7))
            ]
        )
    print(error)
    assert 1.7 < error[32] / error[64] < 2.5 and 1.7 < error[64] / error[128] < 2.5


def test_the_edge_is_a_ramp_of_three_texels():
    """Straight above, across the middle of an edge: linear, from 0 to 1 over three texels, within half of one."""
    mesh = quads(level(4.0), level(1.0, 2.0))
    for axis in (0, 2):
        places = np.zeros((SIDE * SIDE, 3))
        places[:, axis] = np.linspace(0.3, 1.7, SIDE * SIDE)
        share = lit(places, UP, mesh, (0, -1, 0), 64)
        texel = 8 / (64 - 2 * MARGIN)
        assert (np.diff(share) >= 0).all() and share[0] == 0 and share[-1] == 1
        first, last = places[share > 0][0, axis], places[share == 1][0, axis]
        np.testing.assert_allclose((last - first) / texel, 3, atol=0.05)
        assert abs((first + last) / 2 - 1) < 0.51 * texel
        np.testing.assert_allclose(share, np.clip((places[:, axis] - first) / (last - first), 0, 1), atol=0.01)


CONTACT = np.zeros((SIDE * SIDE, 3))


@pytest.mark.parametrize("direction", [(1, -1, 0), (1, -2, 0.3), (3, -1, 0.5)])
@pytest.mark.parametrize("size", [64, 128])
def test_a_cubes_shadow_starts_at_its_foot(direction, size):
    places = CONTACT.copy()
    places[:, 0] = 0.5 + np.linspace(1e-4, 0.1, SIDE * SIDE)
    assert (lit(places, UP, quads(level(4.0), *cube(0.5)), direction, size) < 0.5).all()


@pytest.mark.parametrize(("slope", "most"), [(1.0, 0.5), (0.3, 0.26)])
@pytest.mark.parametrize("size", [64, 128])
def test_light_at_the_foot_of_a_thin_wall(slope, most, size):
    """As far as the docstring says, in texels: where the wall rises above the floor by less than the bias."""
    wall = np.array([[0, 0, -1], [0, 0, 1], [0, 1, 1], [0, 1, -1]], float)
    mesh, direction = quads(level(4.0), wall), (1, -slope, 0)
    places = CONTACT.copy()
    places[:, 0] = np.linspace(1e-4, 1.5, SIDE * SIDE)
    share = lit(places, UP, mesh, direction, size)
    texel = fitted(mesh, direction, size)[1].max()
    gap = places[share < 0.5][0, 0] / texel
    print(f"{gap:.2f} texels of light at the foot")
    assert 0.9 * most < gap < most


# -- Invariances -------------------------------------------------------------------------------------------------------

SCENE = [level(4.0), level(1.0, 2.0), np.array([[2, 0, -1], [2, 0, 1], [2, 1, 1], [2, 1, -1]], float)]
LIGHT = (0.4, -1, 0.3)


@pytest.fixture(scope="module")
def usual() -> np.ndarray:
    share = lit(FLOOR, UP, quads(*SCENE), LIGHT)
    assert 0.02 < (share == 0).mean() < 0.3 and (share == 1).mean() > 0.5
    return share


@pytest.mark.parametrize("power", [-30, -10, 1, 10, 30])
def test_scaling_by_a_power_of_two_changes_no_bit(usual, power):
    scale = 2.0**power
    np.testing.assert_array_equal(lit(FLOOR * scale, UP, quads(*(q * scale for q in SCENE)), LIGHT), usual)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scaling_changes_next_to_nothing(usual, scale):
    other = lit(FLOOR * scale, UP, quads(*(q * scale for q in SCENE)), LIGHT)
    assert (np.abs(other - usual) > 0.01).mean() < 0.01


def test_a_vertex_that_is_not_finite_changes_nothing(usual):
    vertices = np.concatenate(SCENE)
    faces = np.asarray(quads(*SCENE).faces)[: 2 * len(SCENE)]
    for value in (np.nan, np.inf, -np.inf):
        broken = np.concatenate([vertices, [[value, 0, 0], [0, 5, value]]])
        more = np.concatenate([faces, [[0, 1, len(vertices)], [2, 3, len(vertices) + 1]]])
        np.testing.assert_array_equal(lit(FLOOR, UP, padded(broken, more), LIGHT), usual)


def test_the_order_of_the_faces_does_not_matter(usual):
    mesh = quads(*SCENE)
    order = np.random.default_rng(0).permutation(FACES)
    turned = replace(mesh, faces=jnp.roll(mesh.faces[order], 1, axis=1))
    np.testing.assert_array_equal(lit(FLOOR, UP, turned, LIGHT), usual)


def test_the_other_side_of_a_face_throws_the_same_shadow(usual):
    mesh = quads(*SCENE)
    np.testing.assert_array_equal(lit(FLOOR, UP, replace(mesh, faces=mesh.faces[:, ::-1]), LIGHT), usual)


def test_the_number_of_the_light_counts():
    """The second of two lights has the share that it would have alone, and so have both; others have none."""
    here, mesh = surface(FLOOR, UP), quads(*SCENE)
    alone = [shares(here, mesh, sun(light), SETTINGS[64])[0] for light in ((1, -2, 0), LIGHT)]
    assert (alone[0] != alone[1]).any()
    two = sun((1, -2, 0), LIGHT)
    for rows in (None, (0, 1), (1,), (1, 0)):
        found = shares(here, mesh, two, replace(SETTINGS[64], directional=rows))
        expected = [alone[row] if rows is None or row in rows else jnp.ones_like(alone[0]) for row in (0, 1)]
        np.testing.assert_array_equal(found, jnp.stack(expected))
    with pytest.raises(ValueError, match=r"^ShadowMap\.directional names light 2, but the scene has 2 of that kind"):
        shares(here, mesh, two, replace(SETTINGS[64], directional=(0, 2)))


# -- Ugly meshes -------------------------------------------------------------------------------------------------------


def test_one_triangle():
    corners = np.array([[-4.0, 0, -4], [-4, 0, 4], [4, 0, 4]])
    for direction in ((0, -1, 0), (0.5, -1, -0.2), (3, -1, 2)):
        on_it = FLOOR[FLOOR[:, 0] <= FLOOR[:, 2]]
        places = np.resize(on_it, FLOOR.shape)
        assert (lit(places, UP, padded(corners, [[0, 1, 2]]), direction) == 1).all()


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, -1), (1, 0, 1), (0.6, 0, -0.8)])
def test_light_along_a_flat_mesh_is_finite(direction):
    """It has no extent on one of the map's axes. It adds no light: n·l = 0."""
    share = lit(FLOOR, UP, quads(level(4.0)), direction)
    assert np.isfinite(share).all() and share.min() >= 0 and share.max() <= 1


@pytest.mark.parametrize("value", [0.0, 3.0, np.nan, np.inf])
def test_a_mesh_that_is_a_point_or_nowhere_throws_no_shadow(value):
    mesh = padded(np.full((4, 3), value), [[0, 1, 2], [0, 2, 3]])
    assert (lit(FLOOR, UP, mesh, (0.3, -1, 0.2)) == 1).all()


def test_an_empty_mesh_throws_no_shadow():
    assert (shares(surface(FLOOR[:8], UP), merge([]), sun(LIGHT), SETTINGS[64]) == 1).all()


def test_the_gradient_is_zero_on_purpose():
    def total(here, mesh, light, settings):
        return jnp.sum(shares(here, mesh, light, settings))

    arguments = surface(FLOOR, UP), quads(*SCENE), sun(LIGHT), SETTINGS[64]
    slopes = jax.jit(jax.grad(total, (0, 1, 2, 3), allow_int=True))(*arguments)
    assert all(leaf.dtype == jax.dtypes.float0 or (leaf == 0).all() for leaf in jax.tree.leaves(slopes))
