"""The clearcoat: its Fresnel share, its lobe, and that it takes from below what it returns."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from facets import facets
from pointwise import check_calls, check_finite, check_precision, check_slopes, in_double, product, single, towards

from jaxraster.brdf.clearcoat import clearcoat_lobe, clearcoat_share
from jaxraster.surface.material import MIN_ROUGHNESS

SMOOTHEST = MIN_ROUGHNESS**2
LOBE, SHARE = jax.jit(clearcoat_lobe), jax.jit(clearcoat_share)
Z = np.array([0.0, 0.0, 1.0])


def lobe(v, l, alpha):
    return clearcoat_lobe(jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0], v.dtype), v.shape), v, l, alpha)


def test_the_share_is_schlicks_with_0_04():
    cosine = single([1.0, 0.5, 0.0, -0.3, 1.5])
    full = 0.04 + 0.96 * np.array([0.0, 1 / 32, 1.0, 1.0, 0.0])
    for weight in (0.0, 0.25, 1.0):
        np.testing.assert_allclose(SHARE(cosine, jnp.full(5, weight)), weight * full, rtol=1e-6)


def test_the_lobe_is_ggx_without_fresnel():
    """Worked out in double precision for v 40° and l 25° from the normal, 120° apart; head on it is 1/(4π α²)."""
    v, l = towards(np.radians(40)), towards(np.radians(25), np.radians(120))
    values = LOBE(single([Z, Z]), single([v, Z]), single([l, Z]), single([0.25, 0.1]))
    np.testing.assert_allclose(values, [0.78902858 * 0.35502356 * l[2], 1 / (0.04 * np.pi)], rtol=1e-6)


def albedo(n_dot_v: float, alpha: float) -> float:
    """∫ D V (n·l) dl, dl = 4 (v·h) dh."""
    v = towards(np.arccos(n_dot_v))
    h, area = facets(lambda h, _: np.ones(len(h)), (alpha, alpha), v)
    l = 2 * (h @ v)[:, None] * h - v
    return (4 * area * in_double(lobe, np.broadcast_to(v, l.shape), l, np.full(len(l), alpha))).sum()


@pytest.mark.parametrize("alpha", [0.01, 0.25, 1.0])
def test_a_coated_white_surface_never_returns_more_than_it_gets(alpha):
    """(1 - share) + share · albedo: all at small alpha, less on rough coats by what is mirrored more than once."""
    for n_dot_v in (0.05, 0.3, 1.0):
        share = float(SHARE(single([n_dot_v]), jnp.ones(1))[0])
        returned = (1 - share) + share * albedo(n_dot_v, alpha)
        assert 0.85 < returned < 1 + 2e-4
        if alpha == 0.01:
            np.testing.assert_allclose(returned, 1, atol=3e-3 if n_dot_v > 0.1 else 0.03)
    # Smith's single reflection under n at alpha 1 is 1 - ln 2.
    np.testing.assert_allclose(albedo(1.0, 1.0), 1 - np.log(2), atol=3e-4)


def test_light_and_viewer_may_change_places_in_the_lobe():
    rng = np.random.default_rng(0)
    v, l = (towards(np.arccos(rng.uniform(0.01, 1, 512)), rng.uniform(0, 7, 512)) for _ in "vl")
    n, alpha = np.broadcast_to(Z, v.shape), rng.uniform(SMOOTHEST, 1, 512)
    there, back = (np.asarray(LOBE(*map(single, (n, a, b, alpha)))) for a, b in ((v, l), (l, v)))
    np.testing.assert_allclose(there / l[:, 2].astype(np.float32), back / v[:, 2].astype(np.float32), rtol=2e-6)


def test_the_coat_has_a_normal_of_its_own():
    """Turned with everything else it is the same, turned alone it is not."""
    rng = np.random.default_rng(1)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    v, l = towards(0.5), towards(0.7, 2.0)
    arguments = (single([Z, q @ Z, towards(0.1)]), single([v, q @ v, v]), single([l, q @ l, l]), jnp.full(3, 0.3))
    first, turned, bumped = LOBE(*arguments)
    np.testing.assert_allclose(turned, first, rtol=1e-5)
    assert abs(bumped - first) > 0.01 * first


def test_gradients_are_exact_and_every_call_the_same():
    rng = np.random.default_rng(2)
    n, v, l = (towards(rng.uniform(0.05, high, 16), rng.uniform(0, 7, 16)) for high in (0.2, 1.2, 1.2))
    alpha = rng.uniform(0.2, 1, 16)
    check_slopes(clearcoat_lobe, n, v, l, alpha)
    check_calls(clearcoat_lobe, n, v, l, alpha, rtol=1e-5)
    check_slopes(clearcoat_share, v[:, 2], alpha)
    check_calls(clearcoat_share, v[:, 2], alpha)


def test_single_precision_keeps():
    v, h, alpha = product([towards(0.0), towards(0.6, 1.0)], [towards(x, 0.3) for x in (0.3, 0.8)], [0.3, 1.0])
    l = 2 * (v * h).sum(axis=-1, keepdims=True) * h - v
    check_precision(lobe, v[l[:, 2] > 0], l[l[:, 2] > 0], alpha[l[:, 2] > 0])
    check_precision(clearcoat_share, *product([0.0, 1e-3, 0.5, 1.0], [0.3, 1.0]))


def test_finite_at_every_edge():
    """n·l = 0, n·v = 0, h = n, l = v, l = -v, both grazing and below; roughness 0, a mirror, and the least to 1."""
    directions = [Z, towards(0.7), towards(0.7, np.pi), -towards(0.7), -Z, towards(2.0, 1.0), towards(1.5708)]
    directions += [np.array([1.0, 0, 0]), np.array([-1.0, 0, 0]), np.array([0, 1.0, 1e-40]), np.zeros(3)]
    v, l, alpha = product(directions, directions, [0.0, SMOOTHEST, 1.0])
    n = np.broadcast_to(Z, v.shape)
    value = check_finite(clearcoat_lobe, n[alpha > 0], v[alpha > 0], l[alpha > 0], alpha[alpha > 0])
    lit = l[alpha > 0][:, 2].astype(np.float32) > 1e-38
    assert (value >= 0).all() and (value[~lit] == 0).all() and (value[lit] > 0).any()
    check_finite(clearcoat_share, *product([-1.0, 0.0, 1e-30, 0.5, 1.0, 1 + 1.2e-7], [0.0, 1.0]))
