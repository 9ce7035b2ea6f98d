"""What leaves the picture lets go of its light little by little, where `edge` says so, and nothing else changes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from height_fields import camera, rays, seen

from jaxraster.screen import horizon as by_horizons
from jaxraster.screen import ssao as by_points
from jaxraster.screen.border import remaining
from jaxraster.screen.occlusion import on_screen

SIZE, HALF = 48, 1.2
PIXEL = 2 * HALF / SIZE
EDGE = 0.25
BAND = int(EDGE * SIZE)  # pixels
METHODS = {
    "horizon": (by_horizons.horizon, by_horizons.HorizonAO(radius=0.5, slices=1, steps=4)),
    "ssao": (by_points.ssao, by_points.SSAO(radius=0.5)),
}
BOTH = pytest.mark.parametrize("name", METHODS)


def bar(moved: float = 0.0):
    """A floor from above with a bar on it, four pixels wide, once the camera has moved to the right; and the camera."""
    above = camera((moved, 5, 0), (moved, 0, 0), half_height=HALF)
    origin, direction = rays(above, SIZE)
    height = np.where(np.abs(origin[..., 0]) < 2 * PIXEL, 0.4, 0.0)
    return seen(origin, direction, 5 - height, np.broadcast_to([0.0, 1.0, 0.0], origin.shape)), above


def shown(name, picture, **settings) -> np.ndarray:
    method, usual = METHODS[name]
    return np.asarray(method(*picture, jax.tree.map(jnp.float32, replace(usual, **settings))).visibility)


def test_the_share_falls_to_nothing_at_the_border():
    """(½ / band)² at the outermost pixel, 1 from the band's end on, growing between them, 0 outside."""
    at = jnp.arange(-3.0, SIZE + 3.0)
    share = np.asarray(remaining(at, SIZE, 12.0))
    assert (share[:3] == 0).all() and (share[-3:] == 0).all() and (share[3 + 12 : -15] == 1).all()
    np.testing.assert_allclose(share[3:15], ((np.arange(12) + 0.5) / 12) ** 2, rtol=1e-6)
    np.testing.assert_array_equal(share, share[::-1])
    for band in (0.0, -1.0, 0.5):
        np.testing.assert_array_equal(remaining(at, SIZE, band), (at >= 0) & (at < SIZE))
    assert np.isnan(remaining(at, SIZE, np.nan)).all() and (remaining(at, SIZE, np.inf) == 0).all()
    assert remaining(jnp.zeros(1), 1, 0.0) == 1


@BOTH
def test_nothing_vanishes_at_once_as_it_leaves(name):
    """A bar that leaves in one step gives back all light that it took; with a band, a fifth at most."""
    last, gone = (bar(PIXEL * (SIZE // 2 + move)) for move in (-2, 2))
    steps = []
    for edge in (0.0, EDGE):
        before, after = (shown(name, picture, edge=edge) for picture in (last, gone))
        assert (after == 1).all()
        steps.append(1 - before[:, 4:].min())
    assert steps[0] > 0.1 and steps[1] < 0.2 * steps[0]


@BOTH
def test_the_wider_the_band_the_less_is_occluded(name):
    """Nothing in the end; and what lies farther from the border than band and radius is as it was."""
    picture = bar()
    levels = [shown(name, picture, edge=edge) for edge in (0.0, EDGE, 1.0, 1e9)]
    assert (np.diff(levels, axis=0) >= -1e-6).all()
    assert levels[0].min() < 0.8 and levels[2].min() > levels[0].min() + 0.02
    np.testing.assert_allclose(levels[-1], 1, atol=1e-5)
    reach = BAND + int(0.5 / PIXEL) + 4
    within = slice(reach, -reach)
    np.testing.assert_array_equal(levels[1][within, within], levels[0][within, within])
    assert (levels[1][0] > levels[0][0]).any()


@BOTH
def test_no_band_leaves_every_bit_as_it_is(name, monkeypatch):
    file = {"horizon": by_horizons, "ssao": by_points}[name]
    picture, usual = bar(), METHODS[name][1]
    with_band, without = (jax.jit(lambda settings: on_screen(*picture, settings, file._estimate)) for _ in range(2))
    found = [with_band(replace(usual, edge=edge)) for edge in (0.0, -1.0)]
    monkeypatch.setattr(file, "remaining", lambda at, size, band: jnp.ones_like(at))
    expected = without(usual)
    assert expected.visibility.min() < 0.8
    for occlusion in found:
        jax.tree.map(np.testing.assert_array_equal, occlusion, expected)


@BOTH
def test_each_of_a_batch_has_a_band_of_its_own(name):
    """One that is not a number spoils no other."""
    picture, edges = bar(), [0.0, EDGE, np.nan]
    method, usual = METHODS[name]
    many = jax.vmap(lambda edge: method(*picture, replace(usual, edge=edge)).visibility)(jnp.array(edges))
    for edge, found in zip(edges[:2], many):
        np.testing.assert_allclose(found, shown(name, picture, edge=edge), atol=1e-5)
    assert np.isnan(many[2]).any()
