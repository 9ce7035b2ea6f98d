"""Nine spherical harmonics: orthonormal, and the irradiance of what they hold exactly, or leave out as far as known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pointwise import check_calls, check_finite, check_precision, check_slopes
from scipy.special import sph_harm_y

from jaxraster.math.harmonics import COSINE, harmonics, irradiance

evaluate = jax.jit(irradiance)


def sphere(count: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Directions and weights by which polynomials of a degree below 2 · count are integrated exactly."""
    z, weight = np.polynomial.legendre.leggauss(count)
    phi = 2 * np.pi * (np.arange(2 * count) + 0.5) / (2 * count)
    z, phi = np.meshgrid(z, phi, indexing="ij")
    radius = np.sqrt(1 - z * z)
    points = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1)
    return points.reshape(-1, 3), np.repeat(weight * np.pi / count, 2 * count)


def unit(count: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def projected(radiance) -> np.ndarray:
    """Coefficients of a function of directions, in double precision."""
    points, weight = sphere()
    with jax.enable_x64(True):
        basis = np.asarray(harmonics(jnp.asarray(points)))
    return np.einsum("p,pk,pc->kc", weight, basis, radiance(points))


def test_harmonics_are_orthonormal():
    points, weight = sphere()
    with jax.enable_x64(True):
        basis = np.asarray(harmonics(jnp.asarray(points)))
    np.testing.assert_allclose(np.einsum("p,pj,pk->jk", weight, basis, basis), np.eye(9), atol=1e-14)


def test_harmonics_are_those_of_the_books():
    """Real parts and imaginary parts of the complex ones, √2 times, without their alternating sign."""
    points = unit(50)
    theta, phi = np.arccos(points[:, 2]), np.arctan2(points[:, 1], points[:, 0])
    expected = []
    for l in range(3):
        for m in range(-l, l + 1):
            value = sph_harm_y(l, abs(m), theta, phi) * (-1.0) ** m * (np.sqrt(2) if m else 1)
            expected.append(value.imag if m < 0 else value.real)
    check_precision(harmonics, points, rtol=1e-5, atol=2e-6)
    np.testing.assert_allclose(harmonics(jnp.asarray(points, jnp.float32)), np.stack(expected, axis=1), atol=1e-6)


@pytest.mark.parametrize("radiance", [1.0, 0.0, 5e4])
def test_constant_radiance_gives_pi_times_itself(radiance):
    """E/π is the radiance; the first coefficient is √(4π) of it."""
    coefficients = projected(lambda points: np.full((len(points), 3), radiance))
    np.testing.assert_allclose(coefficients[0], 3.5449077 * radiance, rtol=1e-7)
    got = evaluate(jnp.asarray(coefficients, jnp.float32), jnp.asarray(unit(64), jnp.float32))
    np.testing.assert_allclose(got, radiance, rtol=1e-6)


def test_linear_radiance_loses_a_third_of_its_slope():
    """Of a + b·d, E/π = a + ⅔ b·n."""
    a, b, n = np.array([1.0, 2.0, 3.0]), unit(3, 1), unit(64)
    coefficients = projected(lambda points: a + points @ b.T)
    got = evaluate(jnp.asarray(coefficients, jnp.float32), jnp.asarray(n, jnp.float32))
    np.testing.assert_allclose(got, a + 2 / 3 * n @ b.T, rtol=2e-6)


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.36, -0.48, 0.8)])
def test_half_a_sky_is_exact(up):
    """E/π = (1 + n·up)/2: odd bands above the first have no part in the cosine, and half a sky has no other."""
    # Its coefficients: ½ of √(4π) in band 0, and ∫ d over the half sphere = π up in band 1.
    coefficients = np.zeros((9, 3))
    coefficients[0] = np.sqrt(np.pi)
    coefficients[1:4] = (np.sqrt(3 / (4 * np.pi)) * np.pi * np.array(up)[[1, 2, 0]])[:, None]
    n = unit(256)
    got = evaluate(jnp.asarray(coefficients, jnp.float32), jnp.asarray(n, jnp.float32))
    np.testing.assert_allclose(got, np.repeat(0.5 + 0.5 * n @ np.array(up)[:, None], 3, axis=1), atol=1e-6)


def one_light(cosine: np.ndarray) -> np.ndarray:
    """Irradiance of light from one direction, of irradiance 1, at normals of those cosines to it."""
    with jax.enable_x64(True):
        coefficients = jnp.repeat(harmonics(jnp.array([0.0, 0.0, 1.0], jnp.float64))[:, None], 3, axis=1)
        normals = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], axis=-1)
        return np.pi * np.asarray(irradiance(coefficients, jnp.asarray(normals)))[:, 0]


def test_what_is_left_out_of_light_from_one_direction():
    """¼ + ½ c + 5/32 (3 c² - 1) for max(c, 0), cut off at 0: published values at both ends, the largest error and the
    place of the least value."""
    c = np.linspace(-1, 1, 3001)
    sum_of_bands = 0.25 + 0.5 * c + 5 / 32 * (3 * c * c - 1)
    np.testing.assert_allclose(one_light(c), np.maximum(sum_of_bands, 0), atol=1e-12)
    np.testing.assert_allclose(one_light(np.array([1.0, 0.0, -1.0])), [1.0625, 0.09375, 0.0625], atol=1e-12)
    assert abs(np.abs(one_light(c) - np.maximum(c, 0)).max() - 3 / 32) < 1e-6
    assert abs(c[np.argmin(sum_of_bands)] + 8 / 15) < 1e-3 and abs(sum_of_bands.min() + 0.03958) < 1e-5


def test_turning_the_light_turns_the_irradiance():
    points, n = unit(6, 3), unit(40, 4)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]

    def lit(points, normals):
        coefficients = jnp.sum(harmonics(jnp.asarray(points, jnp.float32)), axis=0)[:, None] * jnp.ones((1, 3))
        return evaluate(coefficients, jnp.asarray(normals, jnp.float32))

    np.testing.assert_allclose(lit(points @ turn.T, n @ turn.T), lit(points, n), atol=3e-6)


def test_the_cosines_share_of_each_band():
    """A_l = 2π ∫ c P_l(c) dc over cosines from 0 to 1."""
    x, weight = np.polynomial.legendre.leggauss(8)
    c, weight = 0.5 + 0.5 * x, 0.5 * weight
    bands = [2 * np.sum(weight * c * np.polynomial.legendre.Legendre.basis(l)(c)) for l in range(3)]
    np.testing.assert_allclose(COSINE, np.repeat(bands, (1, 3, 5)), atol=1e-15)


def test_each_normal_is_for_itself_with_exact_slopes():
    coefficients = jnp.asarray(np.random.default_rng(6).normal(size=(9, 3)) + np.eye(9)[:, :1] * 9, jnp.float32)
    normals = np.concatenate([unit(5), np.eye(3)])
    check_calls(harmonics, normals)
    check_finite(harmonics, normals)
    check_calls(lambda n: irradiance(coefficients, n), normals)
    check_slopes(lambda n: irradiance(jnp.asarray(coefficients, n.dtype), n), normals)


def test_darkness_has_a_whole_gradient():
    """The cut at 0 takes nothing of it: each coefficient counts as much as in the light."""
    normal = jnp.asarray(unit(1), jnp.float32)
    slopes = [jax.grad(lambda c: irradiance(c, normal)[0, 0])(jnp.full((9, 3), level)) for level in (0.0, 1e-6)]
    np.testing.assert_array_equal(slopes[0][:, 0] != 0, True)
    assert float(slopes[0][0, 0]) == pytest.approx(1 / np.sqrt(4 * np.pi), rel=1e-6)
