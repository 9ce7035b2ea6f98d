"""Each artefact of shadow maps with its cure, measured; cascades; and penumbras against formula and any-hit rays."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from hand_made import surface
from test_shadow_lights import across, half_plane, segment, shares
from test_shadow_map import CONTACT, FLOOR, SIDE, STEPS, UP, cube, level, quads, tilted

from jaxraster.geometry.bvh import build
from jaxraster.geometry.intersect import Rays
from jaxraster.light.shadow_cascades import splits
from jaxraster.light.shadow_map import ShadowMap, shadow_map
from jaxraster.stack import stack_lights
from jaxraster.visibility.trace import occluded

DOWN = (0.0, -1.0, 0.0)
BOX = ShadowMap(resolution=64)
SINGLE = replace(BOX, filter="single")
BARE = {"constant_bias": 0.0, "slope_bias": 0.0, "receiver_plane": 0.0}
TEXEL = 8 / 60  # of a map of 64 texels on the floor of 8 m, margins left out


def lit(settings, places, normal, mesh, direction=DOWN) -> np.ndarray:
    lights = stack_lights(directional=[(direction, (1, 1, 1))])
    return np.asarray(shares(surface(places, normal), mesh, lights, settings)["directional"][0])


# -- Artefacts ---------------------------------------------------------------------------------------------------------


def test_acne_and_its_cures():
    """Without a bias half of a tilted plane shadows itself; each cure alone ends it."""
    turn = tilted(60, 0.3)
    plane, normal, places = quads(level(4.0) @ turn.T), turn @ UP, FLOOR * 0.99 @ turn.T
    cures = {
        "none": {},
        "constant": {"constant_bias": 3.0},
        "slope": {"slope_bias": 0.6},
        "receiver plane": {"receiver_plane": 1.0, "slope_bias": 0.01},
        "normal offset": {"normal_offset": 1.5},
    }
    bare = replace(SINGLE, **BARE)
    share = {name: lit(replace(bare, **cure), places, normal, plane).mean() for name, cure in cures.items()}
    print(share)
    assert 0.3 < share.pop("none") < 0.7 and set(share.values()) == {1.0}


def test_peter_panning_grows_with_the_bias():
    """Light at the foot of a wall, in texels: as far along the floor as the bias reaches, and half of one."""
    wall = np.array([[0, 0, -1], [0, 0, 1], [0, 1, 1], [0, 1, -1]], float)
    places = CONTACT.copy()
    places[:, 0] = np.linspace(1e-4, 1.5, SIDE * SIDE)
    gap = {}
    for bias in (0.25, 2.0, 4.0):
        share = lit(replace(BOX, constant_bias=bias), places, UP, quads(level(4.0), wall), (1, -1, 0))
        gap[bias] = places[share < 0.5][0, 0] / TEXEL
    print(gap)
    assert gap[0.25] < 1 and 1.2 < gap[2.0] < 2.5 and 2.5 < gap[4.0] < 4.5


def test_jagged_edges_are_steps_that_a_filter_levels():
    """Along an edge that lies askew in the map: how far its place strays, in texels, by one texel and by 3 × 3."""
    angle = 0.3
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    places = across(0.0, 4 * TEXEL) @ turn.T
    mesh = quads(level(4.0), half_plane(1.0) @ turn.T * np.array([0.7, 1, 0.7]))
    stray = {}
    for name, settings in {"single": SINGLE, "box": BOX}.items():
        share = lit(settings, places, UP, mesh)
        stray[name] = np.std(share.sum(axis=1)) * (8 * TEXEL / SIDE) / TEXEL
    print(stray)
    assert stray["single"] > 0.2 and stray["box"] < 0.5 * stray["single"]


# -- Cascades ----------------------------------------------------------------------------------------------------------


def test_splits_are_the_published_ones_and_finite():
    np.testing.assert_allclose(
        splits(jnp.float32(0.1), jnp.float32(100.0), 4, 0.5), [0.1, 12.8187, 26.6061, 46.4039, 100], rtol=1e-5
    )
    for near, far in ((1.0, 1.0), (1e-30, 1e-30), (1e-3, 1e6)):
        depths = np.asarray(splits(jnp.float32(near), jnp.float32(far), 3, 0.7))
        assert np.isfinite(depths).all() and (np.diff(depths) >= -1e-6 * far).all()


def grazing(eye_x: float = 0.0):
    """A floor that runs away from the eye, posts of light and shadow on it, and what is seen of it."""
    z = -np.geomspace(1.0, 40.0, SIDE)
    places = np.stack(np.broadcast_arrays(0.4 * z[:, None] * STEPS + eye_x, 0.0, z[:, None]), axis=-1)
    camera = small.camera(eye=(eye_x, 1.0, 0.5), target=(eye_x, 0.9, -1.0))
    slats = [np.array([[-40, 1, z], [-40, 1, z + w], [40, 1, z + w], [40, 1, z]], float) for z, w in SLATS]
    return surface(places, UP), quads(level(40.0), *slats), camera, places


SLATS = [(-1.6, 0.2), (-3.0, 0.4), (-8.0, 1.0), (-30.0, 4.0)]
DIRECTIONAL = stack_lights(directional=[(DOWN, (1, 1, 1))])


@pytest.fixture(scope="module")
def split():
    """Shares of the floor with so many cascades, 0 for one map of the whole scene."""
    calls = {n: replace(BOX, cascades=n) for n in (0, 4)}
    compiled = jax.jit(lambda *inputs: shadow_map(*inputs)["directional"][0])
    return lambda n, here, mesh, camera: np.asarray(compiled(here, mesh, DIRECTIONAL, camera, calls[n]))


def test_cascades_end_perspective_aliasing(split):
    """The error of one map lies near the eye, where its texels are the largest on the screen."""
    here, mesh, camera, places = grazing()
    exact = ~np.any([(places[..., 2] > z) & (places[..., 2] < z + w) for z, w in SLATS], axis=0)
    error = {n: np.abs(split(n, here, mesh, camera) - exact).mean() for n in (0, 4)}
    print(error)
    assert error[4] < 0.5 * error[0]


def test_cascades_stay_while_the_camera_moves_by_less_than_a_texel(split):
    """What is seen at the same places is the same, but at the edges of what is seen."""
    here, mesh, camera, _ = grazing()
    _, _, moved, _ = grazing(1e-4)
    first, second = (split(4, here, mesh, eye) for eye in (camera, moved))
    assert (np.abs(first - second) > 1e-3).mean() < 0.01


def test_nothing_in_view_and_one_place_in_view(split):
    here, mesh, camera, _ = grazing()
    for mask in (jnp.zeros_like(here.mask), jnp.zeros_like(here.mask).at[3, 3].set(True)):
        assert np.isfinite(split(4, replace(here, mask=mask), mesh, camera)).all()


# -- Penumbras ---------------------------------------------------------------------------------------------------------

PENUMBRA = ShadowMap(resolution=512, filter="penumbra", angle=0.2, radius=0.3)
RADIUS, ANGLE, HEIGHT = 0.3, 0.2, 4.0
SAMPLES = 400


def disc_samples(axis: np.ndarray) -> np.ndarray:
    """Points all over the unit disc across an axis."""
    radius, around = np.sqrt((np.arange(SAMPLES) + 0.5) / SAMPLES), np.pi * (3 - 5**0.5) * np.arange(SAMPLES)
    right = np.cross(axis, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return radius[:, None] * (np.cos(around)[:, None] * right + np.sin(around)[:, None] * np.cross(axis, right))


@jax.jit
def blocked(origin, direction, tree):
    return occluded(Rays(origin=origin, direction=direction, t_max=1.0), tree)


def by_rays(places: np.ndarray, mesh, kind: str, towards: np.ndarray) -> np.ndarray:
    """The share of a disc light that places see: a thousand metres away, or at the height of a lamp."""
    if kind == "spot":
        ends = HEIGHT * towards + RADIUS * disc_samples(towards)
    else:
        ends = 1000 * (towards + ANGLE * disc_samples(towards))
    direction = ends[None] - (places[:, None] if kind == "spot" else 0.0 * places[:, None])
    origin = places[:, None] + np.array([0, 1e-4, 0]) + 0.0 * direction
    tree = build(mesh.vertices, mesh.faces)
    return 1 - np.asarray(blocked(jnp.asarray(origin, jnp.float32), jnp.asarray(direction, jnp.float32), tree)).mean(1)


SCENES = {
    "a card's edge in the sun": ("directional", lambda h: [half_plane(h)]),
    "a card's edge under a lamp": ("spot", lambda h: [half_plane(h)]),
    "a block's edge in the sun": ("directional", lambda h: [half_plane(h), *(c * [2, 0, 2] for c in cube(h / 4))]),
}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("degrees", [0, 25, 40])
def test_a_penumbra_is_as_wide_as_the_light_makes_it(scene, degrees):
    """In the mean along the edge: within 0.02 of rays and of the disc's segment; its width within 10 % of the formula.

    The light leans along the edge, so that the share across it stays that of a disc: of radius h tan α / cos θ in
    parallel light, and R h / (H - h) across the edge for a lamp that faces the floor's middle.
    """
    kind, cards = SCENES[scene]
    towards = np.array([0, np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    for share in (0.1, 0.3, 0.5):
        height = share * HEIGHT * towards[1]
        mesh = quads(level(4.0), *cards(height))
        if kind == "spot":
            lights = stack_lights(spot=[(HEIGHT * towards, -towards, (1, 1, 1), np.inf, 0.0, 0.7)])
            radius = RADIUS * share / (1 - share)
        else:
            lights, radius = stack_lights(directional=[(-towards, (1, 1, 1))]), ANGLE * share * HEIGHT
        places = across(0.0, 1.5 * radius) * np.array([1, 1, 0.2])
        found = np.asarray(shares(surface(places, UP), mesh, lights, PENUMBRA)[kind][0]).mean(axis=0)
        x = places[0, :, 0]
        middle = places[SIDE // 2]
        rays = by_rays(middle, mesh, kind, towards)
        width = (np.interp(0.75, found, x) - np.interp(0.25, found, x)) / (2 * 0.40397 * radius)
        print(f"{scene}, {degrees}°, h/H {share}: formula {np.abs(found - segment(x / radius)).max():.4f}", end=", ")
        print(f"rays {np.abs(found - rays).max():.4f}, width {width:.3f}")
        assert np.abs(found - segment(x / radius)).max() < 0.02
        assert np.abs(found - rays).max() < 0.02 + 1 / SAMPLES
        assert abs(width - 1) < 0.1


def test_vmap_over_lights_is_the_loop():
    directions = jnp.array([[0.2, -1.0, 0.1], [-0.3, -1.0, 0.4]])
    mesh, here = quads(level(4.0), level(1.0, 2.0)), surface(FLOOR[::8], UP)

    def shaded(direction):
        lights = replace(DIRECTIONAL, directional=replace(DIRECTIONAL.directional, direction=direction[None]))
        return shadow_map(here, mesh, lights, small.camera(), BOX)["directional"][0]

    together, loop = jax.vmap(shaded)(directions), jnp.stack([shaded(direction) for direction in directions])
    assert ((loop > 0.5).any() & (loop < 0.5).any()).item()
    np.testing.assert_allclose(together, loop, atol=0.02)
