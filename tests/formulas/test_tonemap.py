"""Every tone curve: printed values, independent derivations, bounds from black to infinity, and slopes."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.display import tonemap as module
from jaxraster.display.tonemap import TONEMAPS, tonemap

LIGHT = [0.01, 0.05, 0.18, 0.5, 1, 2, 4, 10, 16, 100]
GREY = {
    "clip": [0.01, 0.05, 0.18, 0.5, 1, 1, 1, 1, 1, 1],
    "reinhard": [0.009901, 0.047619, 0.152542, 0.333333, 0.5, 0.666667, 0.8, 0.909091, 0.941176, 0.990099],
    "aces_narkowicz": [0.003770, 0.044283, 0.266899, 0.616307, 0.803797, 0.914855, 0.973417, 1, 1, 1],
    "aces_hill": [0.001053, 0.013877, 0.105591, 0.374308, 0.619115, 0.803562, 0.909014, 0.973822, 0.989935, 1],
    "pbr_neutral": [0.000625, 0.015625, 0.14, 0.46, 0.869091, 0.96, 0.983256, 0.993898, 0.996269, 0.999421],
    "agx": [0.005995, 0.061362, 0.214467, 0.425022, 0.589977, 0.743065, 0.860622, 0.954919, 0.994749, 0.996502],
}
GREY["reinhard_luminance"] = GREY["reinhard"]
COLOURS = {
    "aces_hill": {
        (1, 0, 0): (0.688028, 0, 0.002639),
        (1, 0.5, 0.1): (0.638871, 0.383867, 0.0822),
        (4, 0, 0): (1, 0.154313, 0.037482),
    },
    "pbr_neutral": {(1, 0.5, 0.1): (0.869091, 0.422529, 0.065279)},
    "agx": {(1, 0.5, 0.1): (0.62415, 0.439084, 0.174697)},
    # Rational numbers worked out by hand: L = 0.57744.
    "reinhard": {(1, 0.5, 0.1): (1 / 2, 1 / 3, 1 / 11)},
    "reinhard_luminance": {(1, 0.5, 0.1): (1 / 1.57742, 0.5 / 1.57742, 0.1 / 1.57742)},
    "aces_narkowicz": {(1, 0.5, 0.1): (2.54 / 3.16, 0.6425 / 1.0425, 0.0281 / 0.2233)},
    "clip": {(1, 0.5, 0.1): (1, 0.5, 0.1), (4, 0.25, -1): (1, 0.25, 0)},
}
FLOAT32 = 1e-6  # the largest error of float32 against float64
COMPILED = {name: jax.jit(lambda rgb, name=name: tonemap(rgb, name)) for name in TONEMAPS}
ALL = pytest.mark.parametrize("name", TONEMAPS)


def grey(values) -> np.ndarray:
    return np.repeat(np.asarray(values, np.float32)[:, None], 3, axis=1)


def curve(rgb, name) -> np.ndarray:
    """The curve in float32, in rows of up to 4096 so that each is compiled once."""
    rgb = np.asarray(rgb, np.float32).reshape(-1, 3)
    padded = np.zeros((-(-len(rgb) // 4096) * 4096, 3), np.float32)
    padded[: len(rgb)] = rgb
    rows = [np.asarray(COMPILED[name](jnp.asarray(part))) for part in padded.reshape(-1, 4096, 3)]
    return np.concatenate(rows)[: len(rgb)]


@ALL
def test_printed_values(name):
    with jax.enable_x64(True):
        rgb = jnp.repeat(jnp.asarray(LIGHT, float)[:, None], 3, axis=1)
        # AgX's printed column is its red channel: its matrices leave a grey 5e-4 off neutral at most.
        np.testing.assert_allclose(COMPILED[name](rgb)[:, 0], GREY[name], atol=6e-7, rtol=0)
        given = jnp.asarray(list(COLOURS[name]), float)
        np.testing.assert_allclose(COMPILED[name](given), list(COLOURS[name].values()), atol=6e-7, rtol=0)


def test_no_two_curves_could_be_mistaken_for_each_other():
    probe = np.array([[0.18] * 3, [1, 0.5, 0.1], [4, 4, 4]])
    results = [curve(probe, name) for name in TONEMAPS]
    for i, a in enumerate(results):
        for b in results[:i]:
            assert np.abs(a - b).max() > 0.01


@ALL
def test_float32_keeps_to_float64_and_eager_to_jit_and_vmap(name):
    rgb = np.random.default_rng(0).lognormal(0, 2, (4096, 3)).astype(np.float32)
    with jax.enable_x64(True):
        exact = COMPILED[name](jnp.asarray(rgb, jnp.float64))
        assert exact.dtype == jnp.float64
    np.testing.assert_allclose(curve(rgb, name), exact, atol=FLOAT32, rtol=0)
    few = jnp.asarray(rgb[:64]).reshape(4, 16, 3)
    batched = jax.vmap(COMPILED[name])(few)
    assert batched.shape == few.shape
    np.testing.assert_allclose(batched, curve(rgb[:64], name).reshape(4, 16, 3), atol=FLOAT32, rtol=0)
    np.testing.assert_allclose(tonemap(few, name), batched, atol=FLOAT32, rtol=0)


@ALL
def test_bounded_monotone_and_neutral_from_1e_8_to_the_largest_float(name):
    out = curve(grey([*np.geomspace(1e-8, 1e20, 4000), 1e30, np.finfo(np.float32).max, np.inf]), name)
    assert np.isfinite(out).all() and out.min() >= 0 and out.max() <= 1
    # Rounding may take back two ulps of a step.
    assert np.diff(out, axis=0).min() >= -2.5e-7
    spread = out.max(axis=1) - out.min(axis=1)
    # Hill's matrices have five digits, AgX's rows miss 1 by 1.4e-4; in the 8-bit picture both vanish.
    assert spread.max() <= {"aces_hill": 1.5e-5, "agx": 5.1e-4}.get(name, 0)


@ALL
def test_infinite_light_is_white_and_stays_in_its_channel(name):
    white = curve(grey([np.inf]), name)[0]
    np.testing.assert_array_equal(white, curve(grey([np.finfo(np.float32).max]), name)[0])
    if name == "agx":
        assert (white > 0.9964).all()  # 254.6 codes, rounds to 255
    else:
        np.testing.assert_array_equal(white, 1)
    one = curve([[np.inf, 0, 0], [0, 0, np.inf], [np.inf, np.inf, 0]], name)
    assert np.isfinite(one).all() and one.min() >= 0 and (one.max(axis=1) > 0.996).all()


@ALL
def test_black_is_black_and_negative_light_acts_as_none(name):
    for dark in ([0, 0, 0], [-0.0, -0.1, -np.inf], [-1e-30, -1, -1e30]):
        np.testing.assert_array_equal(curve([dark], name), 0)
    np.testing.assert_array_equal(curve([[0.3, -0.1, 2]], name), curve([[0.3, 0, 2]], name))


@ALL
def test_nan_stays_nan_and_in_its_pixel(name):
    out = curve([[np.nan] * 3, [0.5] * 3, [0.2, np.nan, 0.2]], name)
    assert np.isnan(out[0]).all() and np.isnan(out[2, 1]) and np.isfinite(out[1]).all()


# Interior points, away from kinks: in every curve's toe, middle and shoulder, all channels different.
SMOOTH = [[0.3, 0.2, 0.1], [0.05, 0.06, 0.04], [0.9, 0.5, 0.7], [2.0, 1.1, 0.4], [0.5, 0.02, 6.0]]
# Black of both signs, below it, the neutral curve's two seams, white, AgX's ends, the input clamp and beyond.
UGLY = [0.0, -0.0, -1.0, 1e-38, 0.08, 0.8, 1.0, 2**-12.47393, 2**4.026069, 2.0**30, 3.4e38, np.inf, -np.inf]


@ALL
def test_reverse_forward_and_finite_differences_agree(name):
    with jax.enable_x64(True):
        x = jnp.asarray(SMOOTH, float)
        weights = jnp.asarray([1.0, -0.7, 0.4])

        def shown(x):
            return jnp.sum(tonemap(x, name) * weights[None], axis=-1)

        shown_at = jax.jit(shown)
        tangent = jax.jit(lambda x, step: jax.jvp(shown, (x,), (step,))[1])
        reverse = jax.jit(jax.grad(lambda x: jnp.sum(shown(x))))(x)
        for channel in range(3):
            step = jnp.zeros_like(x).at[:, channel].set(1.0)
            numeric = (shown_at(x + 1e-6 * step) - shown_at(x - 1e-6 * step)) / 2e-6
            np.testing.assert_allclose(reverse[:, channel], tangent(x, step), rtol=1e-12, atol=1e-14)
            np.testing.assert_allclose(reverse[:, channel], numeric, rtol=1e-6, atol=1e-9)


@ALL
def test_gradients_are_finite_at_the_ugly_points(name):
    corners = [[1, 0, 0], [np.inf, 0, 0], [0, 0, 5], [0.5, 0.5, 0]]
    points = jnp.asarray(np.concatenate([grey(UGLY), corners]), jnp.float32)
    reverse = jax.grad(lambda x: jnp.sum(COMPILED[name](x)))(points)
    _, forward = jax.jvp(COMPILED[name], (points,), (jnp.ones_like(points),))
    assert jnp.isfinite(reverse).all() and jnp.isfinite(forward).all()
    # Light cannot darken a grey, and beyond the clamps there is nothing to gain.
    rows = dict(zip(UGLY, np.asarray(reverse).sum(axis=1)))
    assert min(rows.values()) > -1e-15
    for value in (-1.0, 3.4e38, np.inf, -np.inf):
        assert rows[value] == 0


@pytest.mark.parametrize(
    ("name", "slope"), [("clip", 1), ("reinhard", 1), ("reinhard_luminance", 1), ("aces_narkowicz", 0.03 / 0.14)]
)
def test_slope_at_black_is_the_curves_own(name, slope):
    np.testing.assert_allclose(jax.grad(lambda x: jnp.sum(tonemap(x, name)))(jnp.zeros(3)), slope, rtol=1e-6)


def test_slope_at_white_of_clip_is_not_halved():
    np.testing.assert_array_equal(jax.grad(lambda x: jnp.sum(tonemap(x, "clip")))(jnp.ones(3)), 1)


def test_reinhard_luminance_keeps_ratios_and_maps_luminance():
    weights = np.array([0.2126, 0.7152, 0.0722])
    rgb = np.random.default_rng(2).uniform(0.01, 0.9, (500, 3))
    out = curve(rgb, "reinhard_luminance").astype(np.float64)
    np.testing.assert_allclose(out @ weights, rgb @ weights / (1 + rgb @ weights), rtol=1e-6)
    np.testing.assert_allclose(out / rgb, np.repeat((out[:, :1] / rgb[:, :1]), 3, axis=1), rtol=1e-6)


def test_neutral_shows_base_colours_one_to_one():
    rgb = np.random.default_rng(3).uniform(0.08, 0.8, (1000, 3)).astype(np.float32)
    np.testing.assert_allclose(curve(rgb, "pbr_neutral"), rgb - np.float32(0.04), atol=1e-7, rtol=0)


def test_neutral_keeps_the_hue_and_can_be_inverted():
    rgb = np.sort(np.random.default_rng(4).lognormal(0, 1, (1000, 3)))
    with jax.enable_x64(True):
        out = np.asarray(COMPILED["pbr_neutral"](jnp.asarray(rgb)))
    # The order of channels and the middle one's place between the others make up the hue.
    place = (rgb[:, 1] - rgb[:, 0]) / (rgb[:, 2] - rgb[:, 0])
    np.testing.assert_allclose((out[:, 1] - out[:, 0]) / (out[:, 2] - out[:, 0]), place, rtol=1e-9)
    # Undo the fade to white, the compression of the peak, and the subtracted reflection.
    new_peak = out.max(axis=1, keepdims=True)
    peak = np.where(new_peak > 0.76, 0.24**2 / (1 - np.maximum(new_peak, 0.76)) + 2 * 0.76 - 1, new_peak)
    keep = 1 / (0.15 * (peak - new_peak) + 1)
    base = (out - new_peak * (1 - keep)) / keep * peak / new_peak
    low = base.min(axis=1, keepdims=True)
    back = base - low + np.where(low <= 0.04, np.sqrt(0.16 * np.maximum(low, 0)), low + 0.04)
    np.testing.assert_allclose(back, rgb, rtol=1e-9)


def test_neutral_is_smooth_across_its_seams():
    with jax.enable_x64(True):
        slope = jax.jit(jax.vmap(jax.grad(lambda x: tonemap(jnp.stack([x, x, x]), "pbr_neutral")[0])))
        for seam in (0.08, 0.8):
            below, above = slope(jnp.array([seam - 1e-9, seam + 1e-9]))
            np.testing.assert_allclose(below, 1, atol=1e-7)
            np.testing.assert_allclose(above, 1, atol=1e-7)


def test_hills_matrices_follow_from_the_primaries():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
    srgb, ap1 = (colour.RGB_COLOURSPACES[name] for name in ("sRGB", "ACEScg"))

    def desaturate(amount):
        return amount * np.eye(3) + (1 - amount) * ap1.matrix_RGB_to_XYZ[1]

    # ACES 1.0 desaturates by 0.96 in its RRT and by 0.93 in its ODT, both about AP1's luminance.
    into = desaturate(0.96) @ colour.matrix_RGB_to_RGB(srgb, ap1, "Bradford")
    back = colour.matrix_RGB_to_RGB(ap1, srgb, "Bradford") @ desaturate(0.93)
    np.testing.assert_allclose(module._ACES_IN, into, atol=7.5e-5)
    np.testing.assert_allclose(module._ACES_OUT, back, atol=2e-4)


def test_agxs_outset_undoes_its_inset():
    np.testing.assert_allclose(np.array(module._AGX_OUT) @ np.array(module._AGX_IN), np.eye(3), atol=1e-14)


def test_agx_scales_middle_grey_to_its_place_in_the_log_range():
    # The range is -10 to +6.5 stops about 0.18, shifted to absolute light.
    np.testing.assert_allclose(np.array(module._AGX_LOG2) - np.log2(0.18), [-10, 6.5], atol=2e-6)


@pytest.mark.parametrize(
    ("given", "hint"),
    [("agz", "did you mean 'agx'"), ("aces", "did you mean 'aces_hill'"), ("Reinhard", "did you mean 'reinhard'")],
)
def test_unknown_names_are_answered_with_the_known_ones(given, hint):
    with pytest.raises(ValueError, match=hint) as error:
        tonemap(jnp.zeros(3), given)
    assert all(name in str(error.value) for name in TONEMAPS) and "\n" not in str(error.value)
    with pytest.raises(ValueError, match=r"no curve is named 'qqq'; choose one of clip, "):
        tonemap(jnp.zeros(3), "qqq")
