"""Dither: an unbiased triangular noise whose rounding error no longer shows the picture, and ends that stay exact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.display.dither import Dither, dither
from jaxraster.math.hash import uniform

H, W = 128, 512
N = H * W * 3
DITHER = jax.jit(dither)


def flat(codes: float) -> jax.Array:
    """A picture of one level, in 8-bit codes."""
    return jnp.full((H, W, 3), codes / 255.0)


def quantized(image) -> np.ndarray:
    """What an 8-bit file keeps, in codes."""
    return np.rint(np.asarray(image, np.float64) * 255)


def noise_of(codes=100.0, amplitude=1.0) -> np.ndarray:
    return (np.asarray(DITHER(flat(codes), Dither(amplitude=amplitude)), np.float64) * 255 - codes) / amplitude


def test_noise_is_triangular_within_one_code():
    t = noise_of().ravel()
    # Adding to 100 codes rounds the noise to 24 bits of 0.4, hence the millionths.
    assert -1.00001 < t.min() < -0.99 and 0.99 < t.max() < 1.00001
    np.testing.assert_allclose(t.mean(), 0, atol=4 * np.sqrt(1 / 6 / N))
    np.testing.assert_allclose(t.var(), 1 / 6, rtol=4 * np.sqrt(1.4 / N))
    # Its distribution function is (1 + t)²/2 below 0 and 1 - (1 - t)²/2 above (Kolmogorov's bound at 1e-4).
    t = np.sort(t)
    exact = np.where(t < 0, (1 + t) ** 2 / 2, 1 - (1 - t) ** 2 / 2)
    assert np.abs(exact - (np.arange(N) + 0.5) / N).max() < 2.3 / np.sqrt(N)


def test_noise_is_the_documented_hash_of_the_place():
    out = DITHER(flat(100.0), Dither())
    for y, x, channel in ((0, 0, 0), (0, 0, 2), (3, 7, 1), (H - 1, W - 1, 2)):
        key = 2 * ((y * W + x) * 3 + channel)
        first, second = uniform(jnp.array([key, key + 1], jnp.uint32)).tolist()
        np.testing.assert_allclose(out[y, x, channel], (100 + first + second - 1) / 255, atol=5e-8)


def test_noise_of_neighbours_and_channels_is_unrelated():
    t = noise_of()
    pairs = [(t[..., 0], t[..., 1]), (t[..., 1], t[..., 2]), (t[..., 0], t[..., 2])]
    pairs += [(t[:-1], t[1:]), (t[:, :-1], t[:, 1:]), (t[:, :-2], t[:, 2:]), (t[:-1, :-1], t[1:, 1:])]
    for a, b in pairs:
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size)


@pytest.mark.parametrize("level", [100.0, 100.1, 100.25, 100.5, 101.9])
def test_rounding_error_has_mean_0_and_variance_a_quarter_at_every_level(level):
    # Without dither the mean error is the level's distance to its code, up to half a code, and the variance 0.
    error = quantized(DITHER(flat(level), Dither())) - level
    np.testing.assert_allclose(error.mean(), 0, atol=4 * np.sqrt(0.25 / N) + 2e-5)
    np.testing.assert_allclose(error.var(), 0.25, rtol=4 * np.sqrt(2 / N) + 0.01)


def test_bands_of_a_slow_ramp_vanish():
    ramp = np.linspace(100.0, 104.0, W)
    image = jnp.broadcast_to(jnp.asarray(ramp / 255, jnp.float32)[None, :, None], (H, W, 3))
    plain = (quantized(image) - ramp[None, :, None]).mean(axis=(0, 2))
    dithered = (quantized(DITHER(image, Dither())) - ramp[None, :, None]).mean(axis=(0, 2))
    # A column averages 384 values of deviation 1/2: five sigmas for the worst of 512 columns.
    assert np.abs(plain).max() > 0.49
    assert np.abs(dithered).max() < 5 * 0.5 / np.sqrt(H * 3)
    # Bands are a sawtooth of one period per code: dither must leave nothing of it.
    wave = np.sin(2 * np.pi * ramp)
    assert abs(plain @ wave) / W > 0.15
    assert abs(dithered @ wave) / W < 4 * np.sqrt(0.25 / 2 / N)


def test_black_and_white_stay_exact_and_nothing_leaves_the_range():
    levels = np.linspace(0, 2.0, 401)
    rows = jnp.asarray(np.stack([levels / 255, 1 - levels / 255]), jnp.float32)
    image = jnp.broadcast_to(rows[:, None, :, None], (2, 200, 401, 3))
    out = DITHER(image, Dither())
    assert out.min() >= 0 and out.max() <= 1
    np.testing.assert_array_equal(out[0, :, 0], 0)
    np.testing.assert_array_equal(out[1, :, 0], 1)
    # Up to the ends the mean stays the picture, before rounding: 600 values each of deviation 0.41 at most.
    np.testing.assert_allclose(jnp.mean(255 * (out - image), axis=(1, 3)), 0, atol=5 * 0.41 / np.sqrt(600))
    # An absurd amplitude ends in the same range.
    wild = DITHER(image, Dither(amplitude=1e9))
    assert wild.min() >= 0 and wild.max() <= 1


def test_what_is_outside_the_range_or_nan_is_left_alone():
    image = flat(100.0).at[0, 0].set(jnp.array([-0.5, 1.5, jnp.inf])).at[1, 1, 1].set(jnp.nan)
    out = DITHER(image, Dither())
    np.testing.assert_array_equal(out[0, 0], image[0, 0])
    np.testing.assert_array_equal(jnp.isnan(out), jnp.isnan(image))


def test_amplitude_scales_the_noise_and_zero_is_identity():
    np.testing.assert_array_equal(DITHER(flat(100.0), Dither(amplitude=0.0)), flat(100.0))
    np.testing.assert_allclose(noise_of(amplitude=8.0), noise_of(), atol=5e-5)
    np.testing.assert_allclose(noise_of(level := 37.0, amplitude=0.5), noise_of(level), atol=5e-5)


def test_repeats_itself_in_batches_eagerly_and_under_vmap():
    small = jnp.linspace(0.1, 0.9, 2 * 8 * 16 * 3).reshape(2, 8, 16, 3)
    batched = DITHER(small, Dither())
    np.testing.assert_array_equal(DITHER(small, Dither()), batched)
    np.testing.assert_array_equal(jax.vmap(DITHER, (0, None))(small, Dither()), batched)
    np.testing.assert_array_equal(DITHER(small[1], Dither()), batched[1])
    np.testing.assert_allclose(dither(small, Dither()), batched, rtol=1.2e-7)
    with jax.enable_x64(True):
        assert dither(small.astype(jnp.float64), Dither()).dtype == jnp.float64


def test_gradient_is_identity_in_the_picture_and_noise_in_the_amplitude():
    rng = np.random.default_rng(0)
    image = jnp.asarray(rng.uniform(size=(8, 16, 3)), jnp.float32).at[0, :3, 0].set(jnp.array([0.0, 1.0, 1e-3]))
    weights = jnp.asarray(rng.normal(size=image.shape), jnp.float32)
    by_image, by_settings = jax.grad(lambda i, s: jnp.sum(dither(i, s) * weights), (0, 1))(image, Dither())
    np.testing.assert_array_equal(by_image, weights)
    _, forward = jax.jvp(lambda i: dither(i, Dither()), (image,), (weights,))
    np.testing.assert_array_equal(forward, weights)
    # Linear in the amplitude: a difference over a quarter code is exact but for rounding.
    inner = jnp.clip(image, 0.1, 0.9)
    slope = jax.grad(lambda a: jnp.sum(dither(inner, Dither(amplitude=a)) * weights))(1.0)
    step = [jnp.sum(dither(inner, Dither(amplitude=a)) * weights) for a in (0.75, 1.25)]
    np.testing.assert_allclose(slope, (step[1] - step[0]) / 0.5, atol=2e-5)
    assert jnp.isfinite(by_settings.amplitude) and abs(float(slope)) > 1e-3


def test_changing_the_amplitude_does_not_trace_again():
    traces = []
    traced = jax.jit(lambda i, s: traces.append(s) or dither(i, s))
    for amplitude in (1.0, 0.5, 2.0):
        traced(jnp.full((4, 4, 3), 0.5), Dither(amplitude=amplitude))
    assert len(traces) == 1
