"""Exposure: exact stops, the clamp, the slope in both arguments, and a camera's settings."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.display.exposure import camera_ev, exposure

expose = jax.jit(exposure)
HDR = jnp.array([[0.0, 0.18, 1.0], [3.7, 1e-3, 250.0]])


@pytest.mark.parametrize("stops", [-126, -20, -3, -1, 0, 1, 2, 10, 100, 126])
def test_whole_stops_are_exact(stops):
    ones = jnp.ones(3)
    np.testing.assert_array_equal(expose(ones, float(stops)), np.float32(2.0**stops))
    np.testing.assert_array_equal(exposure(ones, float(stops)), np.float32(2.0**stops))


def test_fractions_of_a_stop():
    for stops in np.linspace(-8, 8, 33) + 0.3:
        stops = np.float32(stops)
        np.testing.assert_allclose(expose(HDR, stops), np.asarray(HDR, np.float64) * 2.0 ** float(stops), rtol=3e-7)


def test_ev_is_held_to_126_so_that_the_factor_stays_normal():
    for stops in (200.0, np.inf):
        np.testing.assert_array_equal(expose(jnp.ones(2), stops), np.float32(2.0**126))
        np.testing.assert_array_equal(expose(jnp.ones(2), -stops), np.float32(2.0**-126))
    np.testing.assert_array_equal(expose(jnp.array([0.0, 1e30]), 126.0), [0.0, np.inf])


def test_nan_passes():
    assert jnp.isnan(expose(jnp.array([jnp.nan]), 1.0)).all()
    assert jnp.isnan(expose(jnp.ones(1), jnp.nan)).all()
    np.testing.assert_array_equal(jnp.isnan(expose(jnp.array([jnp.nan, 1.0, jnp.inf]), 3.0)), [True, False, False])


@pytest.mark.parametrize("stops", [0.0, 1.0, -2.75, 0.5])
def test_slopes_in_light_and_in_stops(stops):
    with jax.enable_x64(True):
        hdr, ev, factor = jnp.asarray(np.asarray(HDR), float), jnp.float64(stops), 2.0**stops
        by_light, by_stops = jax.grad(lambda h, e: jnp.sum(exposure(h, e)), (0, 1))(hdr, ev)
        np.testing.assert_allclose(by_light, jnp.full(hdr.shape, factor), rtol=1e-14)
        np.testing.assert_allclose(by_stops, jnp.sum(hdr) * factor * np.log(2), rtol=1e-14)
        _, forward = jax.jvp(lambda e: jnp.sum(exposure(hdr, e)), (ev,), (jnp.ones_like(ev),))
        np.testing.assert_allclose(forward, by_stops, rtol=1e-14)
        numeric = jnp.sum(exposure(hdr, ev + 1e-6) - exposure(hdr, ev - 1e-6)) / 2e-6
        np.testing.assert_allclose(by_stops, numeric, rtol=1e-8)


def test_slope_in_stops_is_zero_beyond_the_clamp():
    slope = jax.grad(lambda e: jnp.sum(exposure(jnp.ones(2), e)))
    assert slope(200.0) == 0.0 and slope(-200.0) == 0.0 and slope(100.0) > 0.0


def test_stops_batch_by_vmap_and_plain_numbers_do_not_retrace():
    stops = jnp.array([-1.0, 0.0, 0.5])
    batched = jax.vmap(expose, (None, 0))(HDR, stops)
    for row, ev in zip(batched, stops):
        np.testing.assert_array_equal(row, expose(HDR, ev))
    traces = []
    traced = jax.jit(lambda hdr, ev: traces.append(ev) or exposure(hdr, ev))
    traced(HDR, 1.0), traced(HDR, 2.5)
    assert len(traces) == 1


def test_camera_settings():
    # N 16, 1/125 s, ISO 100 is EV100 14.9658; at EV100 0, white is 1.2 cd/m².
    np.testing.assert_allclose(camera_ev(16.0, 1 / 125, 100.0), -14.9658 - np.log2(1.2), atol=5e-5)
    np.testing.assert_allclose(exposure(jnp.ones(1), camera_ev(16.0, 1 / 125, 100.0)), 2.604167e-5, rtol=2e-6)
    np.testing.assert_allclose(exposure(jnp.ones(1), camera_ev(1.0, 1.0, 100.0)), 0.8333333, rtol=2e-7)
    # One stop more of each admits twice the light.
    base = camera_ev(8.0, 1 / 60, 200.0)
    for more in (camera_ev(8.0, 1 / 30, 200.0), camera_ev(8.0, 1 / 60, 400.0), camera_ev(8 / 2**0.5, 1 / 60, 200.0)):
        np.testing.assert_allclose(more - base, 1.0, atol=2e-6)
