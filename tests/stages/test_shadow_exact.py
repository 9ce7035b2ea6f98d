"""Exact shadows of pixels as samples: against rays in double precision, watertight, and in parts as in the whole."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from hand_made import surface
from test_shadow_map import FLOOR, UP, level, padded, quads, tilted

from jaxraster.geometry.shapes import icosphere
from jaxraster.light import shadow_exact, shadow_frame, shadow_samples
from jaxraster.light.shadow_map import ShadowMap, shadow_map
from jaxraster.scene import Mesh
from jaxraster.stack import stack_lights

SETTINGS = ShadowMap(filter="exact")
DOWN = (0.0, -1.0, 0.0)
rng = np.random.default_rng(5)


@jax.jit
def shares(here, mesh, lights) -> dict:
    return {kind: share[0] for kind, share in shadow_map(here, mesh, lights, small.camera(), SETTINGS).items()}


def lights(direction=DOWN, place=(0.0, 4.0, 0.0), outer=1.2):
    white = (1, 1, 1)
    return stack_lights(
        directional=[(direction, white)],
        point=[(place, white, np.inf)],
        spot=[(place, direction, white, np.inf, 0.0, outer)],
    )


def mesh_of(vertices, faces) -> Mesh:
    unused = {name: jnp.zeros((len(vertices), size)) for name, size in {"normals": 3, "tangents": 4, "uvs": 2}.items()}
    faces = jnp.asarray(faces, jnp.int32)
    material = jnp.zeros(len(faces), jnp.int32)
    return Mesh(vertices=jnp.asarray(vertices, jnp.float32), faces=faces, material=material, **unused)


# -- Against rays ------------------------------------------------------------------------------------------------------

# Triangles of all sizes on all sides of a lamp, some of them across its plane and behind it, and places among them.
# As many as a ball has faces, below: one shape for both.
SIZES = rng.uniform(0.02, 1.2, (320, 1, 1)) ** 2
SOUP = (rng.uniform(-3, 3, (320, 1, 3)) + SIZES * rng.uniform(-1, 1, (320, 3, 3))).astype(np.float32)
PLACES = rng.uniform(-4, 4, (4096, 3)).astype(np.float32)
LAMP, AIM = np.array([0.3, 0.5, -0.2]), np.array([0.4, -0.7, 0.3])


def by_rays(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Whether each place sees the light, and whether no ray passes so near to an edge or a plane that it may not."""
    places, (a, b, c) = PLACES.astype(float), (SOUP[:, k].astype(float) for k in range(3))
    way = np.broadcast_to(-AIM / np.linalg.norm(AIM) * 30, places.shape) if kind == "directional" else LAMP - places
    sides = []
    for p, q in ((a, b), (b, c), (c, a)):
        # Six times the volume of the tetrahedron of an edge and a ray, over both lengths.
        volume = np.einsum("rfk,rk->rf", np.cross(p[None] - places[:, None], q[None] - places[:, None]), way)
        sides.append(volume / (np.linalg.norm(way, axis=1)[:, None] * np.linalg.norm(q - p, axis=1)))
    normal = np.cross(b - a, c - a)
    t = np.einsum("rfk,fk->rf", a[None] - places[:, None], normal) / (way @ normal.T)
    covered = (np.array(sides) > 0).all(axis=0) | (np.array(sides) < 0).all(axis=0)
    end = 1.0 if kind == "directional" else 1.0 - shadow_frame.NEAR
    near_edge = np.abs(sides).min(axis=0) < 1e-4
    near_plane = np.abs(t) * np.linalg.norm(way, axis=1)[:, None] < 1e-4
    unsure = (near_edge & (t > 0) & (t < end)) | (covered & (near_plane | (np.abs(t - end) < 1e-3)))
    return ~(covered & (t > 0) & (t < end)).any(axis=1), ~unsure.any(axis=1)


@pytest.mark.parametrize("kind", ["directional", "point", "spot"])
def test_they_are_those_of_rays(kind):
    """Wherever rays in doubles pass no edge within a tenth of a millimetre: as many lit as dark, and all the same."""
    mesh = mesh_of(SOUP.reshape(-1, 3), np.arange(960).reshape(-1, 3))
    share = np.asarray(shares(surface(PLACES, UP), mesh, lights(AIM, LAMP))[kind])
    sees, sure = by_rays(kind)
    if kind == "spot":
        away = (PLACES - LAMP) / np.linalg.norm(PLACES - LAMP, axis=1)[:, None]
        sure &= away @ (AIM / np.linalg.norm(AIM)) > np.cos(1.19)
    print(kind, sure.mean(), sees[sure].mean(), (share[sure] != sees[sure]).sum())
    assert sure.mean() > (0.25 if kind == "spot" else 0.9) and 0.1 < sees[sure].mean() < 0.9
    np.testing.assert_array_equal(share[sure], sees[sure])


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("tilt", [0, 30, 60, 85, 89, 89.9])
def test_nothing_shadows_a_plane_of_itself(tilt, scale):
    """Whichever way it leans, and at any size, in the sun and under a lamp: exactly 1."""
    for azimuth in (0.0, 0.3, 2.2):
        turn = tilted(tilt, azimuth)
        corners, places = (scale * (points @ turn.T) for points in (level(4.0), FLOOR * 0.99999))
        lamp = scale * np.array([0.1, 1.0, 0.2])
        share = shares(surface(places, turn @ UP), quads(corners), lights(place=lamp))
        assert all((one == 1).all() for one in share.values()), azimuth


@pytest.mark.parametrize("place", [(0.0, 2.0, 0.0), (0.5, 2.0, 0.0), (0.5, 2.0, 0.5), (0.0, 2.0 + 1e-5, 0.0)])
def test_a_lamp_in_a_face_an_edge_or_a_corner_is_not_shadowed_by_it(place):
    """What is nearer than the near plane throws no shadow, and nothing else is here."""
    share = shares(surface(FLOOR, UP), quads(level(4.0), level(0.5, 2.0)), lights(place=place))
    assert (share["point"] == 1).all() and (share["spot"] == 1).all()


def test_no_light_leaks_into_a_ball():
    """Through 480 edges and 162 corners, on the rays of all of which a place lies."""
    ball = icosphere(1.0, 2)
    corners = np.asarray(ball.vertices, float)
    middles = 0.5 * (corners[np.asarray(ball.faces)] + corners[np.roll(np.asarray(ball.faces), 1, axis=1)]).reshape(
        -1, 3
    )
    inside = rng.uniform(-0.55, 0.55, (len(FLOOR) - 2 * len(corners) - len(middles), 3))
    lamp = np.array([0.5, 3.0, 0.2])
    # Right below corners in the sun, and on the lines from the lamp to corners and to the middles of edges.
    below = corners * np.array([0.7, 0, 0.7]) + 0.0
    to_corners, to_middles = (corner + 0.5 * (0.0 - corner) for corner in (corners, middles))
    places = np.concatenate([inside, below, to_corners, to_middles])
    ball = mesh_of(np.concatenate([corners, np.repeat(corners[:1], 960 - len(corners), axis=0)]), ball.faces)
    share = shares(surface(places, UP), ball, lights(place=lamp))
    assert all((one == 0).all() for one in share.values())


# -- Ugly meshes, and parts --------------------------------------------------------------------------------------------

BROKEN = {
    "a point": padded(np.full((3, 3), 3.0), [[0, 1, 2]]),
    "not finite": padded(np.full((3, 3), np.nan), [[0, 1, 2]]),
    "infinite": padded([(0, 0, 0), (1, 0, 0), (0, np.inf, 0)], [[0, 1, 2]]),
    "no such corner": padded(level(4.0, 2.0), [[0, 1, 99], [-1, 2, 3]]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_mesh_throws_no_shadow(name):
    for one in shares(surface(FLOOR, UP), BROKEN[name], lights((0.3, -1, 0.2))).values():
        assert (one == 1).all()


def test_what_is_not_seen_costs_and_changes_nothing():
    here, mesh = surface(FLOOR, UP), quads(level(4.0), level(1.0, 2.0))
    some = jnp.asarray(rng.uniform(size=len(FLOOR)) < 0.3)
    torn = replace(here, mask=some, position=jnp.where(some[:, None], here.position, jnp.nan))
    whole, part = (shares(one, mesh, lights()) for one in (here, torn))
    assert 0.01 < (whole["point"] == 0).mean() < 0.5
    for kind in whole:
        np.testing.assert_array_equal(jnp.where(some, whole[kind], 1.0), jnp.where(some, part[kind], 1.0))


def test_parts_give_what_the_whole_does(monkeypatch):
    """Bands of pixels, groups of faces and windows of pairs, the last of each not full."""
    mesh = mesh_of(SOUP.reshape(-1, 3), np.arange(960).reshape(-1, 3))
    view = shadow_frame.parallel_view(jnp.eye(3), jnp.full(3, -4.0), jnp.full(3, 4.0), 8, 0)
    place = shadow_frame.receiver(view, jnp.asarray(PLACES), jnp.broadcast_to(jnp.array(UP), PLACES.shape))
    draw = functools.partial(shadow_exact.exact, view, place, jnp.ones(len(PLACES), bool), mesh)
    whole = draw()
    assert 0.1 < whole.mean() < 0.9
    smaller = {"BAND": 1000, "FACES": 64, "WINDOW": 256, "BATCH": 16}
    for name, value in smaller.items():
        monkeypatch.setattr(shadow_exact, name, value)
    monkeypatch.setattr(shadow_samples, "BLOCK", 16)
    shadow_exact._core.cache_clear()
    np.testing.assert_array_equal(draw(), whole)
    shadow_exact._core.cache_clear()


def test_mapped_over_lights_it_is_the_loop():
    mesh, here = quads(level(4.0), level(1.0, 2.0)), surface(FLOOR, UP)
    directions = jnp.array([(0.2, -1, 0.1), (-0.3, -1, 0.4)])

    def sunlit(direction):
        sun = stack_lights(directional=[(DOWN, (1, 1, 1))])
        sun = replace(sun, directional=replace(sun.directional, direction=direction[None]))
        return shadow_map(here, mesh, sun, small.camera(), SETTINGS)["directional"][0]

    together = jax.jit(jax.vmap(sunlit))(directions)
    for share, direction in zip(together, directions):
        np.testing.assert_array_equal(share, shares(here, mesh, lights(tuple(direction.tolist())))["directional"])
