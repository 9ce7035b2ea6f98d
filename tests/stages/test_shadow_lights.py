"""Shadows of spots and points, cascades, penumbras and rays: against exact projections, formulas and any-hit rays."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from hand_made import surface
from test_shadow_map import CONTACT, FLOOR, SIDE, STEPS, UP, level, padded, quads, tilted

from jaxraster.light.shadow_map import ShadowMap, shadow_map
from jaxraster.scene import Lights
from jaxraster.stack import stack_lights

CAMERA = small.camera()
SETTINGS = ShadowMap(resolution=256)
# A lamp 4 m above the floor's middle, a card half as high: its shadow is a square twice as wide.
ABOVE, CARD = (0.0, 4.0, 0.0), level(0.5, 2.0)
DOWN = (0.0, -1.0, 0.0)


@jax.jit
def shares(here, mesh, lights, settings) -> dict:
    return shadow_map(here, mesh, lights, CAMERA, settings)


def lamp(kind: str, place=ABOVE, direction=DOWN, outer=1.2) -> Lights:
    row = (place, (1, 1, 1), np.inf) if kind == "point" else (place, direction, (1, 1, 1), np.inf, 0.0, outer)
    return stack_lights(**{kind: [row]})


def lit(kind, places, normal, mesh, settings=SETTINGS, **lights) -> np.ndarray:
    return np.asarray(shares(surface(places, normal), mesh, lamp(kind, **lights), settings)[kind][0])


@pytest.mark.parametrize(("kind", "filter"), [("spot", "box"), ("point", "box"), ("spot", "exact")])
def test_a_lamp_throws_a_square_s_projection(kind, filter):
    """Twice as wide at twice the distance, and exact but for the filter's reach about its edge."""
    share = lit(kind, FLOOR * 0.99, UP, quads(level(4.0), CARD), replace(SETTINGS, filter=filter))
    edge = np.abs(FLOOR[:, [0, 2]] * 0.99).max(axis=1) - 1.0
    # Texels on the floor, 4 m away: of a side of 90°, and of a cone of 1.2 rad.
    texel = 8 / 124 if kind == "point" else 8 * np.tan(1.2) / 252
    reach = {"box": 2.0 * np.sqrt(2), "exact": 1e-3}[filter] * texel
    assert (share[edge < -reach] == 0).all() and (edge < -reach).sum() > 100
    assert (share[edge > reach] == 1).all()
    assert ((share > 0) & (share < 1)).any() == (filter == "box")


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_point_s_six_sides(axis, sign):
    """A card on each side of a lamp, and a wall behind it, that also others' maps see: the same shadow on all."""
    turn = np.roll(np.eye(3), axis - 1, axis=1) * sign
    wall, card = (np.array(level(*size)) - [0, 4, 0] for size in ((4.0, 0.0), (0.5, 2.0)))
    places = (FLOOR * 0.99 - [0, 4, 0]) @ turn
    share = lit("point", places, turn[1], quads(wall @ turn, card @ turn), place=(0, 0, 0))
    edge = np.abs(FLOOR[:, [0, 2]] * 0.99).max(axis=1) - 1.0
    assert (share[edge < -0.2] == 0).all() and (share[edge > 0.2] == 1).all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("kind", ["point", "spot"])
def test_nothing_shadows_a_plane_of_itself_under_a_lamp(kind, scale):
    """At any tilt and size, out to where light grazes it: exactly 1."""
    for tilt in (0, 30, 60, 85, 89.5):
        turn = tilted(tilt, 0.3)
        corners, places = (scale * (points @ turn.T) for points in (level(4.0), FLOOR * 0.99999))
        place = tuple(scale * np.array([0.1, 1.0, 0.2]))
        assert (lit(kind, places, turn @ UP, quads(corners), place=place) == 1).all(), tilt


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_the_foot_of_a_wall_under_a_lamp(kind):
    """Lit for less than a texel's footprint on the floor."""
    wall = np.array([[0, 0, -1], [0, 0, 1], [0, 1, 1], [0, 1, -1]], float)
    places = CONTACT.copy()
    places[:, 0] = np.linspace(1e-4, 1.5, SIDE * SIDE)
    share = lit(kind, places, UP, quads(level(4.0), wall), place=(-2.0, 2.0, 0.0), direction=(1, -1, 0), outer=1.0)
    size = 2 * np.tan(1.0) / 252 if kind == "spot" else 2 / 124
    # A texel is so wide across the light at the foot, √8 m away, and √2 times as wide on the floor.
    texel = size * (np.sqrt(8) if kind == "spot" else 2.0) * np.sqrt(2)
    gap = places[share < 0.5][0, 0] / texel
    print(f"{kind}: {gap:.2f} texels of light at the foot")
    assert gap < 1


def test_beyond_its_cone_a_spot_casts_no_shadow():
    """Behind the lamp, beside its map, and on the lamp itself: lit, and finite."""
    mesh = quads(level(4.0), CARD)
    for places in (FLOOR + np.array([0, 9, 0]), FLOOR * 0 + ABOVE, FLOOR + np.array([40, 0, 0])):
        assert (lit("spot", places, UP, mesh) == 1).all()
        assert np.isfinite(lit("point", places, UP, mesh)).all()


@pytest.mark.parametrize("outer", [0.0, 1e-20, 0.7, np.pi / 2, 3.0, np.pi])
@pytest.mark.parametrize("direction", [DOWN, (0.0, 0.0, 0.0)])
def test_degenerate_cones(outer, direction):
    lights = lamp("spot")
    spot = replace(lights.spot, outer=jnp.full(1, outer, jnp.float32), direction=jnp.array([direction], jnp.float32))
    for mesh in (quads(level(4.0), CARD), quads(level(4.0, 4.0)), padded(np.full((3, 3), np.nan), [[0, 1, 2]])):
        share = shares(surface(FLOOR, UP), mesh, replace(lights, spot=spot), SETTINGS)["spot"]
        assert np.isfinite(share).all() and share.min() >= 0 and share.max() <= 1


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_a_lamp_in_a_corner_of_the_geometry(kind):
    """On a vertex, an edge and a face of the scene, and in a plane of its own."""
    for place in ((-4.0, 0.0, -4.0), (0.5, 2.0, 0.0), (0.0, 2.0, 0.0), (9.0, 0.0, 0.0)):
        share = lit(kind, FLOOR * 0.9, UP, quads(level(4.0), CARD), place=place)
        assert np.isfinite(share).all() and share.min() >= 0 and share.max() <= 1


# -- Filters -----------------------------------------------------------------------------------------------------------


def across(edge: float, reach: float) -> np.ndarray:
    """Rows of places on the floor across an edge along Z, many of each distance."""
    places = np.zeros((SIDE, SIDE, 3))
    places[..., 0] = edge + reach * STEPS[None, :]
    places[..., 2] = 0.5 * STEPS[:, None]
    return places


def half_plane(height: float) -> np.ndarray:
    """A card that ends at x = 0."""
    return np.array([[-4, height, -4], [-4, height, 4], [0, height, 4], [0, height, -4]], float)


def test_a_box_makes_a_ramp_of_its_width():
    width, settings = 5, replace(SETTINGS, width=5)
    texel = 8 / (256 - 2 * settings.margin)
    places = across(0.0, 6 * texel)
    share = shares(
        surface(places, UP), quads(level(4.0), half_plane(1.0)), stack_lights(directional=[(DOWN, DOWN)]), settings
    )
    profile = np.asarray(share["directional"][0]).mean(axis=0)
    middle = np.interp(0.5, profile, places[0, :, 0])
    assert abs(middle) < 0.51 * texel
    np.testing.assert_allclose(profile, np.clip((places[0, :, 0] - middle) / (width * texel) + 0.5, 0, 1), atol=0.02)


def test_taps_of_a_disc_make_the_ramp_of_a_disc():
    settings = replace(SETTINGS, filter="disc", width=24, taps=16)
    texel = 8 / (256 - 2 * settings.margin)
    places = across(0.0, 16 * texel)
    share = shares(
        surface(places, UP), quads(level(4.0), half_plane(1.0)), stack_lights(directional=[(DOWN, DOWN)]), settings
    )
    profile = np.asarray(share["directional"][0]).mean(axis=0)
    np.testing.assert_allclose(profile, segment(places[0, :, 0] / (12 * texel)), atol=0.04)


def segment(t: np.ndarray) -> np.ndarray:
    """The share of a disc of which a half plane leaves t radii beyond the middle."""
    t = np.clip(t, -1, 1)
    return 0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi
