"""The clear sky and its sun: against the formulas in double precision, another model, and what is known of daylight."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.environment.equirect import directions, solid_angles
from jaxraster.environment.sky import LEAST, MOST, sky
from jaxraster.environment.sunlight import LIGHT, OZONE, WAVELENGTH, matching, sunlight
from jaxraster.math.rec709 import LINEAR_FROM_XYZ, XYZ_FROM_LINEAR

LUMINANCE = XYZ_FROM_LINEAR[1]
HEIGHT, WIDTH = 16, 32
D, BANDS = (np.asarray(f(HEIGHT, WIDTH), np.float64) for f in (directions, solid_angles))
HAZES = (LEAST, 3.0, 6.0, MOST)


def at(elevation: float, azimuth: float = 0.0) -> np.ndarray:
    """Towards a sun, from degrees; azimuth 0 is +X, and 90 is +Z."""
    elevation, azimuth = np.radians([elevation, azimuth])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.sin(elevation), np.cos(elevation) * np.sin(azimuth)])


def seen(sun, turbidity=3.0, **options) -> tuple[np.ndarray, np.ndarray]:
    texels, light = sky(sun, turbidity, height=HEIGHT, width=WIDTH, **options)
    np.testing.assert_allclose(light.direction[0], -np.asarray(sun) / np.linalg.norm(sun), atol=1e-6)
    return np.asarray(texels, np.float64), np.asarray(light.irradiance[0], np.float64)


def twin(elevation: float, turbidity: float) -> np.ndarray:
    """The upper half of the sky's luminance and chromaticity, from the paper's formulas one by one."""
    t, theta_s = turbidity, np.radians(90 - elevation)
    theta, gamma = np.arccos(D[..., 1]), np.arccos(np.clip(D @ at(elevation), -1, 1))
    coefficients = {
        "Y": (
            0.1787 * t - 1.4630,
            -0.3554 * t + 0.4275,
            -0.0227 * t + 5.3251,
            0.1206 * t - 2.5771,
            0.3703 - 0.0670 * t,
        ),
        "x": (
            -0.0193 * t - 0.2592,
            0.0008 - 0.0665 * t,
            0.2125 - 0.0004 * t,
            -0.0641 * t - 0.8989,
            0.0452 - 0.0033 * t,
        ),
        "y": (
            -0.0167 * t - 0.2608,
            0.0092 - 0.0950 * t,
            0.2102 - 0.0079 * t,
            -0.0441 * t - 1.6537,
            0.0529 - 0.0109 * t,
        ),
    }

    def f(name, theta, gamma):
        a, b, c, d, e = coefficients[name]
        return (1 + a * np.exp(b / np.cos(theta))) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)

    s, s2, s3 = theta_s, theta_s**2, theta_s**3
    zenith = {
        "Y": 1000 * ((4.0453 * t - 4.9710) * np.tan((4 / 9 - t / 120) * (np.pi - 2 * s)) - 0.2155 * t + 2.4192),
        "x": t * t * (0.00166 * s3 - 0.00375 * s2 + 0.00209 * s)
        + t * (-0.02903 * s3 + 0.06377 * s2 - 0.03202 * s + 0.00394)
        + (0.11693 * s3 - 0.21196 * s2 + 0.06052 * s + 0.25886),
        "y": t * t * (0.00275 * s3 - 0.00610 * s2 + 0.00317 * s)
        + t * (-0.04214 * s3 + 0.08970 * s2 - 0.04153 * s + 0.00516)
        + (0.15346 * s3 - 0.26756 * s2 + 0.06670 * s + 0.26688),
    }
    upper = slice(0, HEIGHT // 2)
    return np.stack([zenith[n] * f(n, theta[upper], gamma[upper]) / f(n, 0.0, theta_s) for n in "Yxy"], axis=-1)


@pytest.mark.parametrize("turbidity", HAZES)
@pytest.mark.parametrize("elevation", [90.0, 47.0, 5.0, 0.0])
def test_the_sky_is_the_papers(elevation, turbidity):
    expected = twin(elevation, turbidity)
    xyz = seen(at(elevation), turbidity)[0][: HEIGHT // 2] @ XYZ_FROM_LINEAR.T
    mixed = np.stack([expected[..., 1], expected[..., 2], 1 - expected[..., 1] - expected[..., 2]], axis=-1)
    linear = mixed * (expected[..., :1] / expected[..., 2:]) @ LINEAR_FROM_XYZ.T
    inside = (linear > 0).all(axis=-1)
    assert inside.mean() > 0.9
    np.testing.assert_allclose(xyz[inside][:, 1], expected[inside][:, 0], rtol=1e-4)
    np.testing.assert_allclose(xyz[inside][:, :2] / xyz[inside].sum(-1)[:, None], expected[inside][:, 1:], atol=1e-5)


@pytest.mark.parametrize("length", [1e-29, 1e-3, 1e37])
def test_how_long_the_direction_is_says_nothing(length):
    sun = np.array([0.4, 0.6, -0.7])
    for of, unit in zip(seen(length * sun), seen(sun)):
        np.testing.assert_allclose(of, unit, rtol=1e-5)


def total(sun, haze):
    """Some sum of all light, for its slopes."""
    texels, directional = sky(sun, haze, height=4, width=8)
    return jnp.sum(texels * jnp.cos(jnp.arange(96.0, dtype=texels.dtype)).reshape(4, 8, 3)) + jnp.sum(
        directional.irradiance
    )


def test_light_is_finite_and_positive_wherever_the_sun_is():
    """From straight below to straight above, in value and in slope; dark nowhere while the sun is up."""
    slope = jax.jit(jax.grad(total, (0, 1)))
    for haze in HAZES:
        for sun in (at(e, a) for e in (90, 89.9999, 45, 3, 0, -0.2, -0.3, -3, -90) for a in (0, 77)):
            texels, directional = seen(sun, haze)
            assert np.isfinite(texels).all() and (texels >= 0).all() and (directional >= 0).all()
            # Low in haze, the sun lacks blue altogether.
            assert sun[1] < 0.1 or ((texels > 0).all() and (directional > 0).all())
            slopes = slope(jnp.asarray(sun, jnp.float32), jnp.float32(haze))
            assert all(jnp.isfinite(s).all() for s in slopes)


def test_slopes_are_those_of_differences():
    with jax.enable_x64(True):
        value, slope, step = jax.jit(total), jax.jit(jax.grad(total, (0, 1))), 1e-6
        for elevation in (60.0, 10.0, -4.0):
            at_sun = np.append(at(elevation, 33.0), 3.3)
            slopes = np.append(*slope(jnp.asarray(at_sun[:3]), jnp.asarray(at_sun[3])))
            for i, move in enumerate(step * np.eye(4)):
                ends = [float(value(jnp.asarray(p[:3]), jnp.asarray(p[3]))) for p in (at_sun + move, at_sun - move)]
                np.testing.assert_allclose(slopes[i], (ends[0] - ends[1]) / (2 * step), rtol=1e-4, atol=1e-3)


def test_the_sky_is_symmetric_about_the_sun_and_turns_with_it():
    along_x = seen(at(30))[0]
    np.testing.assert_allclose(along_x, along_x[:, ::-1], rtol=2e-4)
    # One column is 11.25°.
    np.testing.assert_allclose(seen(at(30, 5 * 11.25))[0], np.roll(along_x, 5, axis=1), rtol=2e-4)
    overhead = seen(at(90))[0]
    np.testing.assert_allclose(overhead, np.broadcast_to(overhead[:, :1], overhead.shape), rtol=2e-4)
    brightest = np.unravel_index(np.argmax(along_x @ LUMINANCE), (HEIGHT, WIDTH))
    assert D[brightest] @ at(30) > 0.95


def test_the_ground_is_a_matt_floor_in_the_light_of_sky_and_sun():
    albedo = np.array([0.5, 0.3, 0.0])
    texels, sun = seen(at(40), ground=albedo)
    upper = slice(0, HEIGHT // 2)
    irradiance = np.einsum("h,hw,hwc->c", BANDS[upper], D[upper, :, 1], texels[upper]) + np.sin(np.radians(40)) * sun
    floor = np.broadcast_to(albedo * irradiance / np.pi, texels[HEIGHT // 2 :].shape)
    np.testing.assert_allclose(texels[HEIGHT // 2 :], floor, rtol=1e-5)
    scaled, sun_scaled = seen(at(40), ground=albedo, gain=1e-4)
    np.testing.assert_allclose(scaled, 1e-4 * texels, rtol=1e-6)
    np.testing.assert_allclose(sun_scaled, 1e-4 * sun, rtol=1e-6)
    # A row on the horizon is half of each.
    odd = np.asarray(sky(at(40), height=5, width=8)[0])
    assert ((odd[2] > odd[3]) & (odd[2] < 40000)).all()


def test_twilight_has_no_step_and_loses_a_tenth_in_so_many_degrees():
    (above, sun_above), (below, sun_below) = seen(at(1e-4)), seen(at(-1e-4))
    np.testing.assert_allclose(below, above, rtol=1e-3, atol=1)
    np.testing.assert_allclose(sun_below, sun_above, rtol=1e-2)
    three, six = (seen(at(e))[0][: HEIGHT // 2, WIDTH // 4] @ LUMINANCE for e in (-3.0, -5.5))
    np.testing.assert_allclose(six[0], three[0] / 10, rtol=0.05)
    assert (seen(at(-0.3))[1] == 0).all() and (seen(at(-90))[0] < 1e-20).all()


def test_sunlight_is_what_is_measured():
    """Above the air 128 klx of nearly white; at noon 80 to 100 klx; ever less and ever redder as it sinks."""
    np.testing.assert_allclose(LUMINANCE @ LIGHT.sum(axis=1), 128e3, rtol=0.01)
    assert 80e3 < LUMINANCE @ np.asarray(sunlight(jnp.array(0.4), jnp.array(3.0))) < 100e3
    zenith = jnp.linspace(0.0, 0.5 * jnp.pi, 40)
    for haze in HAZES:
        light = np.asarray(jax.vmap(sunlight, (0, None))(zenith, jnp.array(haze)))
        assert (np.diff(light @ LUMINANCE) < 0).all() and (np.diff(light[:, 2] / light[:, 0])[:30] < 0).all()
    hazier = [np.asarray(sunlight(jnp.array(0.8), jnp.array(haze))) for haze in HAZES]
    assert all((a > b).all() for a, b in itertools.pairwise(hazier))


@pytest.mark.parametrize("degrees", [0.0, 60.0, 80.0, 85.0])
def test_sunlight_passes_as_much_air_as_another_formula_says(degrees):
    """The relative air mass of Kasten & Young 1989, and the paper's transmittances of that much air."""
    mass = 1 / (np.cos(np.radians(degrees)) + 0.50572 * (96.07995 - degrees) ** -1.6364)
    um, ozone = WAVELENGTH / 1000, OZONE
    depth = 0.008735 * um**-4.08 + (0.04608 * 2.5 - 0.04586) * um**-1.3 + 0.35 * ozone
    expected = np.maximum(LIGHT @ np.exp(-mass * depth), 0)
    light = np.asarray(sunlight(jnp.radians(degrees), jnp.array(2.5)))
    # The two differ by 0.2 %, which the exponent multiplies.
    np.testing.assert_allclose(light @ LUMINANCE, expected @ LUMINANCE, rtol=0.002 * mass)


def test_the_eyes_curves_are_the_observers():
    """CIE 1931, to the fit's error of some hundredths."""
    known = {
        450: (0.3362, 0.0380, 1.7721),
        500: (0.0049, 0.3230, 0.2720),
        550: (0.4334, 0.9950, 0.0087),
        600: (1.0622, 0.6310, 0.0008),
    }
    np.testing.assert_allclose(matching(np.array([*known], float)).T, list(known.values()), atol=0.011)
    assert len(WAVELENGTH) == 35 and WAVELENGTH[-1] == 720


@pytest.mark.parametrize(("haze", "elevation"), [(2.0, 15.0), (3.0, 40.0), (3.0, 70.0), (5.0, 40.0)])
def test_another_model_agrees_roughly(haze, elevation):
    """Mitsuba has that of Hosek and Wilkie, 2012 and 2013, in other units: hues are compared, and how sky and sun
    share the light of a floor, which this older model is known to give too much to the sky."""
    mi = pytest.importorskip("mitsuba", reason="the other model is Mitsuba's")
    mi.set_variant("scalar_rgb")
    sun, (texels, ours) = at(elevation), seen(at(elevation), haze)

    def emitter(**scales):
        towards = [float(sun[0]), float(-sun[2]), float(sun[1])]  # +Z is up there
        common = {"type": "sunsky", "sun_direction": towards, "turbidity": haze, "albedo": 0.2}
        return mi.load_dict(common | scales)

    def radiance(emitter, d):
        at = mi.SurfaceInteraction3f()
        at.wi = -mi.Vector3f(float(d[0]), float(-d[2]), float(d[1]))
        return np.array(emitter.eval(at, True), np.float64)

    upper, only_sky, only_sun = HEIGHT // 2, emitter(sun_scale=0.0), emitter(sky_scale=0.0)
    theirs = np.array([[radiance(only_sky, d) for d in row] for row in D[:upper]])
    floor = [np.einsum("h,hw,hwc->c", BANDS[:upper], D[:upper, :, 1], t[:upper]) for t in (texels, theirs)]
    suns = [ours, radiance(only_sun, sun) * 2 * np.pi * (1 - np.cos(np.radians(0.5358 / 2)))]
    for mine, other in (floor, suns):
        np.testing.assert_allclose(mine / (LUMINANCE @ mine), other / (LUMINANCE @ other), atol=0.16)
    share = [LUMINANCE @ f / (LUMINANCE @ s) for f, s in zip(floor, suns)]
    assert 1.2 < share[0] / share[1] < 3.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0.0, 0.0, 0.0),), "towards_sun must be three numbers, not all zero, got [0.0, 0.0, 0.0]"),
        (((0.0, np.nan, 1.0),), "towards_sun must be three numbers"),
        (((0.0, 1.0),), "towards_sun must be three numbers"),
        (((0.0, 1e39, 1.0),), "towards_sun must be three numbers"),
        (((0.0, 1e-39, 0.0),), "towards_sun must be three numbers"),
        (((0.0, 1.0, 0.0), 1.0), "turbidity must be 2 to 10, got 1.0"),
        (((0.0, 1.0, 0.0), 10.5), "turbidity must be 2 to 10, got 10.5"),
        (((0.0, 1.0, 0.0), np.nan), "turbidity must be 2 to 10, got nan"),
        (((0.0, 1.0, 0.0), 3.0, {"ground": (0.5, 1.5, 0.5)}), "ground must be an albedo"),
        (((0.0, 1.0, 0.0), 3.0, {"gain": np.inf}), "gain must be one number"),
        (((0.0, 1.0, 0.0), 3.0, {"gain": 1e39}), "gain must be one number"),
    ],
)
def test_what_is_no_sky_is_refused(arguments, message):
    *arguments, options = arguments if isinstance(arguments[-1], dict) else (*arguments, {})
    with pytest.raises(ValueError) as caught:
        sky(*arguments, **options)
    assert message in str(caught.value)
