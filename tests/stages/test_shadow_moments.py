"""The shadow with a gradient: its value against the box's and the bound's formula, its slopes against what moves it."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from hand_made import surface
from test_shadow_lights import half_plane
from test_shadow_map import FLOOR, SIDE, UP, level, padded, quads, sun, tilted
from test_shadow_map import shadow_map as sunlit

import jaxraster as jr
from jaxraster.light.shadow_frame import Receiver
from jaxraster.light.shadow_map import ShadowMap, shadow_map
from jaxraster.light.shadow_moments import moments
from jaxraster.stack import stack_lights

WIDTH, SIZE = 5, 64
SETTINGS = ShadowMap(resolution=SIZE, filter="moments", width=WIDTH)
BARE = replace(SETTINGS, constant_bias=1 / 64, slope_bias=0.0)
DOWN = (0.0, -1.0, 0.0)
HEIGHT = 4.0  # of the lamp
TEXEL = 8 / (SIZE - 2 * SETTINGS.margin)  # of a map of the floor from straight above


def lit(places, normal, mesh, direction=DOWN, settings=SETTINGS) -> np.ndarray:
    return np.asarray(sunlit(surface(places, normal), mesh, sun(direction), settings))


# -- Values ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("tilt", [0, 15, 30, 45, 60, 75, 85, 89, 89.5])
def test_nothing_shadows_a_plane_of_itself(tilt, scale):
    """Whichever way it leans, and at any size: lit exactly up to 60°, and in the mean within 0.001 on to where a plane
    is thinner in the map than a texel, whose boxes are mostly empty."""
    for azimuth in (0.0, 0.3, 2.2):
        turn = tilted(tilt, azimuth)
        corners, places = (scale * (points @ turn.T) for points in (level(4.0), FLOOR * 0.99999))
        share = lit(places, turn @ UP, quads(corners))
        print(tilt, scale, 1 - share.min(), 1 - share.mean())
        assert 1 - share.mean() <= (1e-5 if tilt <= 60 else 1e-3)


def test_one_caster_over_one_receiver_is_the_box_s_share():
    """Both level: the bound is reached by two depths, and linear in their shares."""
    mesh = quads(level(4.0), level(1.0, 2.0))
    ours, theirs = (lit(FLOOR, UP, mesh, settings=replace(BARE, filter=filter)) for filter in ("moments", "box"))
    assert ((theirs > 0.1) & (theirs < 0.9)).sum() > 50
    # A box's weights are whole 1/256.
    np.testing.assert_allclose(ours, theirs, atol=2 / 256)


def test_light_bleeds_through_two_casters_as_the_bound_says():
    """Of cards 1 m and 3 m above the floor, the share s of a box that sees the upper one has σ² = 4 s (1 - s) and
    μ = 1 + 2 s: where it is a quarter, a quarter of the light is there, and none should be."""
    places = np.zeros((SIDE * SIDE, 3))
    places[:, 0] = np.linspace(-1.0, 1.0, SIDE * SIDE)
    mesh = quads(level(4.0), level(2.0, 1.0), half_plane(3.0) * np.array([0.5, 1, 0.5]))
    share = lit(places, UP, mesh, settings=BARE)
    assert share[np.abs(places[:, 0]) > 4 * TEXEL].max() < 1e-3
    assert abs(share.max() - 0.25) < 0.002


def test_the_variance_of_a_map_does_not_cancel():
    """Of depths that differ by a millionth of themselves, where the mean of squares less the square of the mean is
    rounding alone: within a tenth of the share that doubles give."""
    rng = np.random.default_rng(0)
    depth = (0.9 + 1e-6 * rng.integers(0, 16, (16, 16))).astype(np.float32)
    x, y = rng.uniform(4, 12, (2, 200)).astype(np.float32)
    zero = jnp.zeros(200)
    place = Receiver(x=jnp.asarray(x), y=jnp.asarray(y), depth=zero + 0.9, slope_x=zero, slope_y=zero, unit=zero)
    found = np.asarray(moments(place, (jnp.asarray(depth), *[jnp.zeros((16, 16))] * 2), zero, WIDTH))

    def weights(position):
        """Of an interval of texels about a place, how much of each."""
        low, high = position - WIDTH / 2, position + WIDTH / 2
        return np.clip(np.minimum(high, np.arange(16) + 1) - np.maximum(low, np.arange(16)), 0, 1) / WIDTH

    for ours, column, line in zip(found, x.astype(float), y.astype(float)):
        weight = np.outer(weights(line), weights(column))
        mean = (weight * depth.astype(float)).sum()
        variance = (weight * (depth.astype(float) - mean) ** 2).sum()
        gap = max(mean - np.float32(0.9), 0.0)
        assert abs(ours - variance / (variance + gap**2)) < 0.1


@pytest.mark.parametrize("width", [1, 2, 9])
@pytest.mark.parametrize("depth", [0.0, 0.3, 1.0])
def test_of_a_map_of_one_depth_the_mean_is_that_depth(width, depth):
    """The smallest map there may be, of no variance: all is lit at that depth and dark below, and no number is NaN."""
    least = 4 * ShadowMap(filter="moments", width=width).margin + 1
    ShadowMap(filter="moments", width=width, resolution=least)
    places = jnp.linspace(-1.0, least + 1.0, 16)
    place = Receiver(x=places, y=places, depth=places, slope_x=places, slope_y=places, unit=places)
    for below, expected in ((0.0, 1.0), (0.01, 0.0)):
        drawn = jnp.full((least, least), depth), *[jnp.zeros((least, least))] * 2
        found = moments(place._replace(depth=jnp.full(16, depth - below)), drawn, jnp.zeros(16), width)
        np.testing.assert_allclose(found, np.full(16, expected), atol=1e-7)


# -- Gradients ---------------------------------------------------------------------------------------------------------


def lamps(direction=DOWN, place=(0.0, HEIGHT, 0.0)):
    return stack_lights(directional=[(direction, (1, 1, 1))], point=[(place, (1, 1, 1), np.inf)])


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1, 2))
def slopes(moved, vertices, lights, mesh, here, weights):
    """A weighted sum of shares, and its derivatives in receivers, which all move alike, in casters and in lights."""
    here = replace(here, position=here.position + jnp.broadcast_to(moved, here.position.shape))
    share = shadow_map(here, replace(mesh, vertices=vertices), lights, small.camera(), SETTINGS)
    return sum(jnp.sum(weights[kind] * share[kind][0]) for kind in weights)


def derivatives(kind: str, places, normal, mesh, lights, weight: float):
    weights = {name: jnp.full(len(FLOOR), weight if name == kind else 0.0) for name in ("directional", "point")}
    return slopes(jnp.zeros(3), mesh.vertices, lights, mesh, surface(places, normal), weights)


def dense(reach: float) -> np.ndarray:
    """Places across an edge at x = 0, each a little farther: their mean share, times the reach, is a shadow's width."""
    places = np.zeros((SIDE * SIDE, 3))
    places[:, 0] = np.linspace(-reach, reach, SIDE * SIDE)
    return places


RISE = 1.0  # of the card whose edge throws the shadow
LEVER = HEIGHT / (HEIGHT - RISE)  # of a lamp's projection
# How far the edge of the shadow moves for what moves by one.
MOVES = {
    ("directional", "card"): 1.0,
    ("directional", "receivers"): -1.0,
    ("point", "position"): 1.0 - LEVER,
    ("point", "card"): LEVER,
    ("point", "receivers"): -1.0,
}


@pytest.mark.parametrize(("kind", "part"), MOVES)
def test_the_edge_of_a_shadow_moves_as_the_projection_says(kind, part):
    """The lit width's derivative, within an eighth: the silhouette's own motion is in it."""
    reach, mesh = 1.5, quads(level(4.0), half_plane(RISE), level(0.1, 3.0) + np.array([3, 0, 3]))
    total, (receivers, vertices, lights) = derivatives(kind, dense(reach), UP, mesh, lamps(), 2 * reach / SIDE**2)
    found = {"receivers": receivers[0], "card": vertices[4:8, 0].sum()}.get(part)
    found = getattr(getattr(lights, kind), part)[0, 0] if found is None else found
    print(kind, part, float(total), float(found), -MOVES[kind, part])
    assert abs(total - reach) < (TEXEL if kind == "directional" else 2 * TEXEL)
    np.testing.assert_allclose(found, -MOVES[kind, part], atol=0.12)


def wide(tree):
    return jax.tree.map(lambda leaf: leaf.astype(float) if leaf.dtype == jnp.float32 else leaf, tree)


def test_a_smooth_shadow_s_slopes_are_those_of_finite_differences():
    """Deep in the shadow of a tilted card, where one face fills every box, in doubles: as the receivers or the card
    rise, and as the light turns."""
    lean = np.array([[-3, 1.0, -3], [-3, 1.6, 3], [3, 2.2, 3], [3, 1.6, -3]])
    with jax.enable_x64(True):
        mesh, here, lights = wide((quads(level(4.0), lean), surface(FLOOR * 0.2, UP), lamps()))
        lights, weights = replace(lights, point=stack_lights().point), {"directional": jnp.full(len(FLOOR), 1e4)}

        def call(moves):
            vertices = mesh.vertices.at[4:8, 1].add(moves[1])
            sun = replace(lights.directional, direction=jnp.array([[0.2 + moves[2], -1.0, 0.1 + moves[3]]]))
            receivers = jnp.array([0.0, moves[0], 0.0])
            return slopes(receivers, vertices, replace(lights, directional=sun), mesh, here, weights)

        total, (receivers, vertices, turned) = call(np.zeros(4))
        turned = turned.directional.direction[0]
        for found, move in zip((receivers[1], vertices[4:8, 1].sum(), turned[0], turned[2]), 0.02 * np.eye(4)):
            expected = (call(move)[0] - call(-move)[0]) / 0.04
            print(float(total), float(found), float(expected))
            assert found.dtype == np.float64
            # Vertices are snapped to 1/256 texel, and the map is in single precision.
            np.testing.assert_allclose(found, expected, rtol=0.01, atol=0.01 * total)


def test_the_stage_s_shadows_move_with_the_sun():
    """Of all that the sun reaches, as it turns: no pixel stands for a jump, and the sum is of the differences' sign and
    at most two and a half times as large."""
    scene, camera = jr.scenes.stage()
    plan, _ = jr.plan_for(scene, camera, width=96, height=72)
    seen = jax.jit(lambda scene, camera: jr.render(scene, camera, plan).surface)(scene, camera)
    settings = replace(plan.shadow_map, filter="moments")

    @jax.jit
    def share(turn):
        lights = scene.lights
        sun = replace(lights.directional, direction=lights.directional.direction + turn * jnp.array([[1.0, 0.0, 0.0]]))
        return shadow_map(seen, scene.mesh, replace(lights, directional=sun), camera, settings)["directional"][0]

    slope = jax.jit(lambda turn: jax.jvp(share, (turn,), (1.0,))[1])
    for turn in (-0.01, 0.02):
        found = np.asarray(slope(turn))
        expected = np.mean([(share(turn + h).mean() - share(turn - h).mean()) / (2 * h) for h in (0.01, 0.02, 0.03)])
        assert np.abs(found).max() < 200
        assert 0.5 * expected < found.mean() < 2.5 * expected


BROKEN = {
    "no area": padded(np.full((3, 3), 1.0), [[0, 1, 2]]),
    "nothing": padded(np.full((3, 3), np.nan), [[0, 1, 2]]),
    "one corner gone": padded(
        [*level(4.0), *level(1.0, 2.0), (np.nan, 0, 0), (0, np.inf, 0)],
        [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [0, 4, 8], [1, 2, 9]],
    ),
    "whole": quads(level(4.0), level(1.0, 2.0)),
}


@pytest.mark.parametrize("name", BROKEN)
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_slopes_are_finite(name, scale):
    """Of no casters, of broken ones, of light along the floor, of none, and with a lamp on a vertex."""
    mesh = replace(BROKEN[name], vertices=BROKEN[name].vertices * scale)
    for direction, place in (
        (DOWN, (0, 4, 0)),
        ((1, 0, 0), (4, 0, 4)),
        ((0, 0, 0), (0.5, 0, 0.5)),
        ((3, -1, 2), (0, 2, 0)),
    ):
        for kind in ("directional", "point"):
            lights = lamps(place=scale * np.array(place, float))
            sun = replace(lights.directional, direction=jnp.array([direction], jnp.float32))
            lights = replace(lights, directional=sun)
            for leaf in jax.tree.leaves(derivatives(kind, FLOOR * scale, UP, mesh, lights, 1.0)):
                assert np.isfinite(leaf).all(), (direction, place, kind)
