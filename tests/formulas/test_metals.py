"""The table of metals, derived again from n and k, and held against what others have published."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.brdf.fresnel import F82, conductor, schlick_f82
from jaxraster.brdf.metals import METALS

# Wavelength in micrometres, n, k; from refractiveindex.info (public domain): Johnson and Christy 1972 for gold, silver
# and copper, Rakić 1995 for aluminium, Johnson and Christy 1974 for iron and chromium.
NOBLE = (0.3679, 0.3815, 0.3974, 0.4133, 0.4305, 0.4509, 0.4714, 0.4959, 0.5209, 0.5486, 0.5821, 0.6168, 0.6595, 0.7045,
         0.756, 0.8211)  # fmt: skip
TRANSITION = (0.368, 0.381, 0.397, 0.413, 0.431, 0.451, 0.471, 0.496, 0.521, 0.549, 0.582, 0.617, 0.659, 0.704, 0.756,
              0.821)  # fmt: skip
SAMPLES = {
    "gold": (
        NOBLE,
        (1.48, 1.46, 1.47, 1.46, 1.45, 1.38, 1.31, 1.04, 0.62, 0.43, 0.29, 0.21, 0.14, 0.13, 0.14, 0.16),
        (
            1.895,
            1.933,
            1.952,
            1.958,
            1.948,
            1.914,
            1.849,
            1.833,
            2.081,
            2.455,
            2.863,
            3.272,
            3.697,
            4.103,
            4.542,
            5.083,
        ),
    ),
    "silver": (
        NOBLE,
        (0.07, 0.05, 0.05, 0.05, 0.04, 0.04, 0.05, 0.05, 0.05, 0.06, 0.05, 0.06, 0.05, 0.04, 0.03, 0.04),
        (1.657, 1.864, 2.07, 2.275, 2.462, 2.657, 2.869, 3.093, 3.324, 3.586, 3.858, 4.152, 4.483, 4.838, 5.242, 5.727),
    ),
    "copper": (
        NOBLE,
        (1.36, 1.33, 1.32, 1.28, 1.25, 1.24, 1.25, 1.22, 1.18, 1.02, 0.7, 0.3, 0.22, 0.21, 0.24, 0.26),
        (1.975, 2.045, 2.116, 2.207, 2.305, 2.397, 2.483, 2.564, 2.608, 2.577, 2.704, 3.205, 3.747, 4.205, 4.665, 5.18),
    ),
    "aluminium": (
        (0.36466, 0.41328, 0.4428, 0.47687, 0.5166, 0.56357, 0.61993, 0.65225, 0.68881, 0.72932, 0.77491, 0.79478),
        (0.39877, 0.52135, 0.6079, 0.7278, 0.8734, 1.0728, 1.366, 1.5724, 1.8301, 2.1606, 2.6154, 2.7675),
        (4.3957, 5.0008, 5.3676, 5.7781, 6.2418, 6.7839, 7.4052, 7.7354, 8.0601, 8.3565, 8.4914, 8.3866),
    ),
    "iron": (
        TRANSITION,
        (2.02, 2.12, 2.24, 2.35, 2.48, 2.59, 2.67, 2.74, 2.86, 2.95, 2.94, 2.88, 2.92, 2.86, 2.87, 2.94),
        (2.43, 2.5, 2.58, 2.65, 2.71, 2.77, 2.82, 2.88, 2.91, 2.93, 2.99, 3.05, 3.1, 3.19, 3.28, 3.39),
    ),
    "chromium": (
        TRANSITION,
        (1.87, 1.92, 2, 2.08, 2.19, 2.33, 2.51, 2.75, 2.94, 3.18, 3.22, 3.17, 3.09, 3.05, 3.08, 3.2),
        (2.69, 2.74, 2.83, 2.93, 3.04, 3.14, 3.24, 3.3, 3.33, 3.33, 3.3, 3.3, 3.34, 3.39, 3.42, 3.48),
    ),
}
WAVELENGTHS = np.arange(380, 781, 5)
NAMES = pytest.mark.parametrize("name", METALS)


@pytest.fixture(scope="module")
def rgb_of_spectrum() -> np.ndarray:
    """`[3 wavelength]`: linear Rec.709 of a reflectance under D65, by the CIE 1931 2° observer, white being 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it misses plotting libraries
        import colour
    observer, light = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"], colour.SDS_ILLUMINANTS["D65"]
    xyz = np.array([observer[float(w)] * light[float(w)] for w in WAVELENGTHS]).T
    rgb = colour.RGB_COLOURSPACES["ITU-R BT.709"].matrix_XYZ_to_RGB @ xyz
    return rgb / rgb.sum(axis=1, keepdims=True)


def exact(name: str, cosine, rgb_of_spectrum) -> np.ndarray:
    """`[cosine 3]`: the exact F of every wavelength, as a colour; not clipped."""
    n, k = (np.interp(WAVELENGTHS / 1000, SAMPLES[name][0], values) for values in SAMPLES[name][1:])
    index, cosine = n + 1j * k, np.asarray(cosine, float)[:, None]
    g = np.sqrt(index**2 - 1 + cosine**2)
    across, along = (cosine - g) / (cosine + g), (index**2 * cosine - g) / (index**2 * cosine + g)
    return 0.5 * (np.abs(across) ** 2 + np.abs(along) ** 2) @ rgb_of_spectrum.T


@NAMES
def test_the_numbers_are_those_of_n_and_k(name, rgb_of_spectrum):
    """To half of their last digit."""
    f0, at_82 = np.clip(exact(name, (1.0, 1 / 7), rgb_of_spectrum), 0, 1)
    np.testing.assert_allclose(METALS[name].f0, f0, atol=5.1e-5)
    schlick = np.array(METALS[name].f0) + (1 - np.array(METALS[name].f0)) * (6 / 7) ** 5
    np.testing.assert_allclose(METALS[name].tint, at_82 / schlick, atol=1e-4)


def test_gold_alone_is_clipped(rgb_of_spectrum):
    raw = {name: exact(name, (1.0,), rgb_of_spectrum)[0] for name in METALS}
    np.testing.assert_allclose(raw["gold"][0], 1.038, atol=5e-4)
    assert [name for name in METALS if raw[name].max() > 1 or raw[name].min() < 0] == ["gold"]


@NAMES
def test_the_package_computes_the_same_spectra(name, rgb_of_spectrum):
    """`conductor` in single precision, three wavelengths at a time, against complex numbers in double."""
    n, k = (np.interp(WAVELENGTHS / 1000, SAMPLES[name][0], x).reshape(-1, 3) for x in SAMPLES[name][1:])
    for cosine in (1.0, 1 / 7):
        f = jax.jit(conductor)(jnp.full(len(n), cosine), jnp.asarray(n, jnp.float32), jnp.asarray(k, jnp.float32))
        color = rgb_of_spectrum @ np.asarray(f, np.float64).ravel()
        np.testing.assert_allclose(color, exact(name, (cosine,), rgb_of_spectrum)[0], atol=2e-6)


def test_two_colours_are_as_good_as_a_spectrum(rgb_of_spectrum):
    """The number of the docstrings: at most 0.025 off at any angle, where one colour would be 0.2."""
    cosine = np.linspace(0, 1, 181)
    off = {}
    for name in METALS:
        f0, tint = (jnp.asarray(np.tile(x, (181, 1)), jnp.float32) for x in METALS[name])
        truth = np.clip(exact(name, cosine, rgb_of_spectrum), 0, 1)
        pair = (schlick_f82(f0, t, jnp.asarray(cosine, jnp.float32)) for t in (tint, jnp.ones_like(tint)))
        off[name] = tuple(np.abs(np.asarray(f) - truth).max() for f in pair)
    print(off)
    assert 0.024 < max(tinted for tinted, _ in off.values()) < 0.0255
    assert 0.195 < max(plain for _, plain in off.values()) < 0.205
    np.testing.assert_allclose(F82, 1 / 7)


# f0 of Unity's "Metal Reflectance" node (those of Lagarde 2011), and f0 and tint of Adobe's "Metal material references"
# for its Standard Material, both linear Rec.709, with the largest distance of ours. They are of other films: silver's
# and gold's blue, copper's red and all of iron differ between the two by up to 0.33.
PUBLISHED = {
    "gold": ((1.000, 0.766, 0.336), 0.04, (1.0000, 0.7099, 0.3148), 0.05, (0.9408, 0.9636, 0.9099), 0.075),
    "silver": ((0.972, 0.960, 0.915), 0.065, (0.9868, 0.9830, 0.9667), 0.012, (0.9929, 0.9961, 1.0000), 0.002),
    "copper": ((0.955, 0.637, 0.538), 0.025, (1.0000, 0.6504, 0.5274), 0.07, (0.9755, 0.9349, 0.9301), 0.016),
    "aluminium": ((0.913, 0.921, 0.925), 0.006, (0.9157, 0.9226, 0.9236), 0.009, (0.9090, 0.9365, 0.9596), 0.036),
    "iron": ((0.560, 0.570, 0.580), 0.09, None, None, None, None),
    "chromium": ((0.550, 0.556, 0.554), 0.001, (0.5496, 0.5561, 0.5531), 0.0012, (0.7372, 0.7511, 0.8170), 0.004),
}


@NAMES
def test_others_have_published_nearly_the_same(name):
    unity, near_unity, adobe, near_adobe, tint, near_tint = PUBLISHED[name]
    np.testing.assert_allclose(METALS[name].f0, unity, atol=near_unity)
    if adobe is not None:
        np.testing.assert_allclose(METALS[name].f0, adobe, atol=near_adobe)
        np.testing.assert_allclose(METALS[name].tint, tint, atol=near_tint)
