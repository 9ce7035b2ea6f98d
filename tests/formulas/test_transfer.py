"""sRGB both ways and luminance: printed values, colour-science, every code's round trip, slopes at the ugly points."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.display.transfer import luminance, srgb_decode, srgb_encode

encode, decode = jax.jit(srgb_encode), jax.jit(srgb_decode)
# Below, at and above each threshold, 0 of both signs, below 0, inside, white and above it.
UGLY = [-1.0, -1e-3, -0.0, 0.0, 2e-38, 0.0031308, 0.0031309, 0.04045, 0.04046, 0.5, 1.0, 8.0]


@pytest.fixture(scope="module")
def colour():
    """colour-science takes a second to import and warns about plotting libraries it does not find."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("colour")


@pytest.mark.parametrize(
    ("code", "light"),
    [(0.5, 0.214041140), (128 / 255, 0.21586050), (188 / 255, 0.50288646), (0.1, 0.0100228), (0.2, 0.0331048)],
)
def test_decode_of_printed_values(code, light):
    np.testing.assert_allclose(decode(jnp.float32(code)), light, rtol=5e-7, atol=5e-8)


@pytest.mark.parametrize(
    ("light", "code"), [(0.18, 0.46135613), (0.18, 117.6458 / 255), (0.5, 0.73535698), (0.01, 0.0998528)]
)
def test_encode_of_printed_values(light, code):
    np.testing.assert_allclose(encode(jnp.float32(light)), code, rtol=4e-7, atol=5e-8)


def test_agrees_with_colour_science(colour):
    # This many steps avoid 0.04045 itself, which colour-science takes for the other side of its own threshold.
    x = np.linspace(0, 1, 99_999)
    f32 = jnp.asarray(x, jnp.float32)
    exact = np.asarray(f32, np.float64)
    np.testing.assert_allclose(encode(f32), colour.cctf_encoding(exact, function="sRGB"), atol=2.5e-7, rtol=0)
    np.testing.assert_allclose(decode(f32), colour.cctf_decoding(exact, function="sRGB"), atol=2.5e-7, rtol=0)
    with jax.enable_x64(True):
        f64 = jnp.asarray(x)
        np.testing.assert_allclose(srgb_encode(f64), colour.cctf_encoding(x, function="sRGB"), atol=1e-14, rtol=0)
        np.testing.assert_allclose(srgb_decode(f64), colour.cctf_decoding(x, function="sRGB"), atol=1e-14, rtol=0)


def test_it_is_not_a_power_of_2_2():
    # The usual shortcut misses by 8.5 codes when encoding and 0.0085 when decoding: nothing here would mistake it.
    x = jnp.linspace(0.0, 1.0, 4097)
    assert 8.4 < 255 * jnp.max(jnp.abs(encode(x) - x ** (1 / 2.2))) < 8.6
    assert 0.0084 < jnp.max(jnp.abs(decode(x) - x**2.2)) < 0.0086


@pytest.mark.parametrize("top", [255, 65_535])
def test_every_code_survives_decode_encode_round(top):
    codes = np.arange(top + 1)
    back = np.rint(np.asarray(encode(decode(jnp.asarray(codes / top, jnp.float32)))) * top)
    np.testing.assert_array_equal(back, codes)


def test_black_and_white_are_exact():
    for function in (srgb_encode, encode, srgb_decode, decode):
        np.testing.assert_array_equal(function(jnp.array([0.0, 1.0])), [0.0, 1.0])


def test_eager_jit_and_vmap_agree_and_decoding_undoes_encoding():
    x = jnp.asarray(UGLY, jnp.float32)
    for function, compiled, inverse in ((srgb_encode, encode, decode), (srgb_decode, decode, encode)):
        np.testing.assert_allclose(function(x), compiled(x), rtol=8e-7)
        np.testing.assert_array_equal(jax.vmap(compiled)(x), compiled(x))
        np.testing.assert_allclose(inverse(compiled(x)), x, rtol=2e-6, atol=1e-12)


def test_pieces_meet_to_3e_8():
    with jax.enable_x64(True):
        for function, threshold in ((srgb_encode, 0.0031308), (srgb_decode, 0.04045)):
            below, above = function(jnp.array([threshold, np.nextafter(threshold, 1.0)]))
            assert 1e-9 < abs(float(above - below)) < 3e-8


def test_slope_is_12_92_at_and_below_zero():
    for x in (0.0, -0.0, -1e-3, -1.0, 2e-38):
        assert jax.grad(srgb_encode)(x) == np.float32(12.92)
        np.testing.assert_allclose(jax.grad(srgb_decode)(x), 1 / 12.92, rtol=1e-7)
        np.testing.assert_allclose(encode(x), 12.92 * x, rtol=2e-7)


@pytest.mark.parametrize("function", [srgb_encode, srgb_decode])
def test_reverse_forward_and_finite_differences_agree(function):
    # In float64 finite differences of 1e-6 leave eight digits; thresholds themselves are kinks and left out.
    with jax.enable_x64(True):
        x = jnp.asarray([v for v in UGLY if v not in (0.0031308, 0.04045)])
        reverse = jax.grad(lambda x: jnp.sum(function(x)))(x)
        _, forward = jax.jvp(function, (x,), (jnp.ones_like(x),))
        h = 1e-6 * jnp.maximum(jnp.abs(x), 1e-3)
        numeric = (function(x + h) - function(x - h)) / (2 * h)
        np.testing.assert_allclose(reverse, forward, rtol=1e-14)
        np.testing.assert_allclose(reverse, numeric, rtol=1e-6)


def test_gradients_are_finite_at_the_ugly_points():
    x = jnp.asarray(UGLY, jnp.float32)
    for function in (encode, decode):
        assert jnp.isfinite(jax.grad(lambda x, f=function: jnp.sum(f(x)))(x)).all()
        assert jnp.isfinite(jax.jvp(function, (x,), (jnp.ones_like(x),))[1]).all()


def test_nan_and_infinity_pass():
    x = jnp.array([jnp.nan, jnp.inf, -jnp.inf])
    for function in (encode, decode):
        np.testing.assert_array_equal(function(x), x)


def test_luminance_weighs_as_colour_science_does(colour):
    weights = colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ[1]
    np.testing.assert_allclose(luminance(jnp.eye(3)), weights, rtol=1e-7)
    rgb = np.random.default_rng(0).lognormal(size=(7, 5, 3)).astype(np.float32)
    np.testing.assert_allclose(luminance(jnp.asarray(rgb)), rgb.astype(np.float64) @ weights, rtol=3e-7)
    np.testing.assert_allclose(jax.grad(luminance)(jnp.zeros(3)), weights, rtol=1e-7)
    np.testing.assert_allclose(luminance(jnp.ones(3)), 1.0, rtol=1e-7)
