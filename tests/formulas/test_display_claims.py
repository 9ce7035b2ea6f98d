"""What the guide says about the display: shading in sRGB codes darkens midtones, and `clip` alone loses highlights."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.display.dither import Dither, dither
from jaxraster.display.exposure import exposure
from jaxraster.display.tonemap import TONEMAPS, tonemap
from jaxraster.display.transfer import srgb_decode, srgb_encode


def codes(light) -> np.ndarray:
    return np.rint(255 * np.asarray(srgb_encode(jnp.asarray(light, jnp.float32)))).astype(int)


def emitted(code) -> np.ndarray:
    """The light a screen gives for a code, white being 1."""
    return np.asarray(srgb_decode(jnp.asarray(np.asarray(code) / 255, jnp.float32)))


def test_half_the_light_is_code_188_and_half_the_code_a_fifth_of_the_light():
    right, wrong = int(codes(0.5)), round(0.5 * 255)
    assert (right, wrong, right - wrong) == (188, 128, 60)
    np.testing.assert_allclose(emitted(right), 0.5, atol=0.003)
    np.testing.assert_allclose(0.5 / emitted(wrong), 2.3163, atol=1e-3)


def test_shading_in_codes_darkens_every_midtone_by_up_to_73_codes():
    cosine = np.linspace(0, 1, 1001)
    gap = 255 * (np.asarray(srgb_encode(jnp.asarray(cosine, jnp.float32))) - cosine)
    assert gap[0] == gap[-1] == 0 and (gap[1:-1] > 0).all()
    # The difference is greatest where the curve's slope is 1: at (2.4 / 1.055)^(-1 / 0.58333) = 0.244.
    np.testing.assert_allclose(gap.max(), 73.22, atol=0.01)
    np.testing.assert_allclose(cosine[gap.argmax()], 0.244, atol=0.005)
    # A whole matte ball, lit from the camera, sends two thirds of white; shaded in codes it sends less than half.
    weight = 2 * cosine / np.sum(2 * cosine)
    np.testing.assert_allclose(np.sum(weight * emitted(codes(cosine))), 2 / 3, atol=2e-3)
    assert np.sum(weight * emitted(255 * cosine)) < 0.48


def test_averaging_an_edge_in_codes_darkens_it_for_every_pair_of_tones():
    tones = np.arange(0, 256, 15)
    a, b = np.meshgrid(tones, tones)
    light, mean = (emitted(a) + emitted(b)) / 2, emitted((a + b) / 2)
    assert (mean[a != b] < light[a != b]).all()
    np.testing.assert_allclose(mean[a == b], light[a == b], atol=1e-6)


def test_adding_lamps_in_codes_burns_out_what_is_half_of_white():
    assert codes(0.25 + 0.25) == 188 and 2 * codes(0.25) > 255


HIGHLIGHTS = [1.0, 2.0, 4.0, 8.0]


@pytest.mark.parametrize("name", TONEMAPS)
def test_clip_alone_shows_different_highlights_as_one(name):
    rgb = jnp.repeat(jnp.array(HIGHLIGHTS)[:, None], 3, axis=1)
    shown = codes(tonemap(rgb, name))[:, 0]
    if name == "clip":
        assert shown.tolist() == [255] * 4
    else:
        assert (np.diff(shown) > 0).all()


def test_clip_changes_the_hue_of_a_highlight_that_keeping_ratios_does_not():
    orange = jnp.array([4.0, 2.0, 0.4])
    clipped = np.asarray(tonemap(orange, "clip"))
    assert clipped[0] == clipped[1] == 1  # yellow: red and green are no longer two to one
    dimmed = np.asarray(tonemap(exposure(orange, -2.0), "reinhard_luminance"))
    np.testing.assert_allclose(dimmed[0] / dimmed[1:], [2, 10], rtol=1e-6)


def test_aces_names_at_least_three_pictures():
    grey = jnp.full(3, 0.18)
    hill, narkowicz = (float(tonemap(grey, name)[0]) for name in ("aces_hill", "aces_narkowicz"))
    brightened = float(tonemap(exposure(grey, float(-np.log2(0.6))), "aces_hill")[0])
    np.testing.assert_allclose(np.log2(narkowicz / hill), 1.34, atol=0.005)
    np.testing.assert_allclose(brightened, 0.213105, atol=2e-6)


def test_brightened_hill_fit_agrees_with_viewers_that_divide_by_0_6():
    light = np.array([0.01, 0.05, 0.18, 0.5, 1, 2, 4, 10, 16], np.float32)
    printed = [0.002431, 0.031681, 0.213105, 0.557586, 0.763397, 0.887514, 0.952237, 0.991006, 1]
    rgb = jnp.repeat(jnp.asarray(light)[:, None], 3, axis=1)
    shown = tonemap(exposure(rgb, float(-np.log2(0.6))), "aces_hill")[:, 0]
    np.testing.assert_allclose(shown, printed, atol=2e-6)


@pytest.mark.parametrize("name", TONEMAPS)
def test_nothing_leaves_the_chain_that_a_cast_to_8_bits_could_wrap(name):
    rows = [-3.0, -np.inf, -0.0, 0.0, 1e-30, 0.5, 1.0, 300.0, 3e38, np.inf, np.nan]
    hdr = jnp.repeat(jnp.array(rows)[None, :, None], 3, axis=2)
    for ev in (-200.0, 0.0, 200.0):
        image = srgb_encode(tonemap(exposure(hdr, ev), name))
        shown = np.asarray(dither(image, Dither()))[0]
        assert np.isnan(shown[-1]).all()
        assert (shown[:-1] >= 0).all() and (shown[:-1] <= 1).all()
        assert (shown[:4] == 0).all() and (np.rint(255 * np.asarray(image)[0, -2]) == 255).all()
