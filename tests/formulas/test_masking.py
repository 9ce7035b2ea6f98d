"""Smith's maskings: matched to their distribution, reciprocal, their fits as good as they say, precise and finite."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from facets import UP, facets
from pointwise import check_calls, check_finite, check_precision, check_slopes, product, single, towards

from jaxraster.brdf.distribution import beckmann, ggx_anisotropic
from jaxraster.brdf.masking import smith_correlated, smith_correlated_anisotropic, smith_fast, smith_separable
from jaxraster.surface.material import MIN_ROUGHNESS

SMOOTHEST = MIN_ROUGHNESS**2
# All take v, l and two alpha in the surface's own space; isotropic ones look at the first alpha.
MASKINGS = {
    "smith_correlated": lambda v, l, alpha: smith_correlated(v[..., 2], l[..., 2], alpha[..., 0]),
    "smith_correlated_anisotropic": smith_correlated_anisotropic,
    "smith_separable": lambda v, l, alpha: smith_separable(v[..., 2], l[..., 2], alpha[..., 0]),
    "smith_fast": lambda v, l, alpha: smith_fast(v[..., 2], l[..., 2], alpha[..., 0]),
}
V = {name: jax.jit(function) for name, function in MASKINGS.items()}
ALL = pytest.mark.parametrize("name", MASKINGS)
GGX = jax.jit(ggx_anisotropic)
BECKMANN = jax.jit(lambda h, alpha: beckmann(jnp.broadcast_to(jnp.asarray(UP), h.shape), h, alpha[..., 0]))


def masking(name: str, v, l, alpha) -> np.ndarray:
    rows = np.broadcast_shapes(np.shape(v), np.shape(l))
    a = single(np.broadcast_to(alpha, (*rows[:-1], 2)))
    return np.asarray(V[name](single(np.broadcast_to(v, rows)), single(np.broadcast_to(l, rows)), a), np.float64)


def lit_along_n(name: str, v, alpha) -> float:
    """G₁(v) = 4 (n·v) V(v, n): nothing is shadowed."""
    return 4 * v[2] * masking(name, v, np.array(UP), alpha)


def beckmann_g1(v, alpha: float) -> float:
    """1/(1 + Λ), Λ = (erf a - 1)/2 + e^-a²/(2a√π), a = cot θ/α. Source: Heitz 2014, section 5.2."""
    a = v[2] / max(np.hypot(v[0], v[1]), 1e-9) / alpha
    return 1 / (1 + (math.erf(a) - 1) / 2 + math.exp(-(min(a, 30) ** 2)) / (2 * a * math.sqrt(math.pi)))


EQUAL = [(a, a) for a in (SMOOTHEST, 0.01, 0.25, 1.0)]
UNEQUAL = [(SMOOTHEST, 1.0), (0.1, 0.3), (0.7, 0.05)]
MATCHED = [(name, pair) for name in ("smith_correlated", "smith_separable", "beckmann") for pair in EQUAL]
MATCHED += [("smith_correlated_anisotropic", pair) for pair in UNEQUAL]


@pytest.mark.parametrize(("name", "alpha"), MATCHED)
def test_weak_white_furnace(name, alpha):
    """∫ G₁(v) D (v·h)₊ dh = n·v: the microfacets seen from v cover v's view of the surface exactly once.

    Beckmann's distribution with its own masking, which is not in the package.
    """
    for cosine, phi in ((1.0, 0.0), (0.7, 0.4), (0.3, 2.0), (0.05, 4.0)):
        v = towards(np.arccos(cosine), phi)
        _, area = facets(BECKMANN if name == "beckmann" else GGX, alpha, v)
        g1 = beckmann_g1(v, alpha[0]) if name == "beckmann" else lit_along_n(name, v, alpha)
        np.testing.assert_allclose(g1 * area.sum() / cosine, 1, atol=2e-5, err_msg=f"n·v {cosine}")


def albedo(name: str, alpha: float, n_dot_v: float) -> float:
    """∫ D V (n·l) dl of GGX, dl = 4 (v·h) dh."""
    v = towards(np.arccos(n_dot_v), 0.3)
    h, area = facets(GGX, (alpha, alpha), v)
    l = 2 * (h @ v)[:, None] * h - v
    above = np.where(l[:, 2:] > 0, l, UP)
    return (area * 4 * masking(name, v, above, (alpha, alpha)) * np.maximum(l[:, 2], 0)).sum()


def test_what_separable_masking_loses():
    """Below the correlated one but where either direction is n; the albedos of its docstring."""
    v, l, a = map(single, product(np.linspace(0.01, 1, 40), np.linspace(0.01, 1, 40), [SMOOTHEST, 0.1, 0.5, 1.0]))
    ratio = jax.jit(smith_separable)(v, l, a) / jax.jit(smith_correlated)(v, l, a)
    np.testing.assert_allclose(ratio[(v == 1) | (l == 1)], 1, rtol=1e-6)
    assert ratio.max() < 1 + 1e-6 and ratio.min() < 0.05
    for name, expected in (("smith_separable", 0.8543), ("smith_correlated", 0.8916)):
        np.testing.assert_allclose(albedo(name, 0.25, 0.1), expected, atol=2e-4)


def test_the_fast_fit_is_as_far_off_as_it_says():
    """Exact at 0 and 1, never above, 1 - 1/√2 below at the worst, where both cosines are α and small; the albedos."""
    cosines = np.geomspace(1e-4, 1, 60)
    v, l, a = map(single, product(cosines, cosines, cosines))
    fast, exact = jax.jit(smith_fast), jax.jit(smith_correlated)
    ratio = np.asarray(fast(v, l, a) / exact(v, l, a))
    assert 1 / np.sqrt(2) - 1e-5 < ratio.min() < 0.708 and ratio.max() < 1 + 1e-5
    worst = np.array([x[np.argmin(ratio)] for x in (v, l, a)])
    assert worst.max() < 0.02 and worst.max() < 1.4 * worst.min()
    for end in (0.0, 1.0):
        a = jnp.full_like(v, end)
        np.testing.assert_allclose(fast(v, l, a), exact(v, l, a), rtol=1e-6)
    lost = {
        (alpha, c): albedo("smith_correlated", alpha, c) - albedo("smith_fast", alpha, c)
        for alpha in (0.01, 0.05, 0.1, 0.25, 0.5)
        for c in (0.05, 0.2, 1.0)
    }
    print(lost)
    assert min(lost.values()) > 0 and 0.205 < lost[0.05, 0.05] == max(lost.values()) < 0.215
    assert max(value for (_, c), value in lost.items() if c == 1) < 0.03


@ALL
def test_light_and_viewer_may_change_places(name):
    rng = np.random.default_rng(0)
    v, l = (towards(np.arccos(rng.uniform(0, 1, 512)), rng.uniform(0, 7, 512)) for _ in "vl")
    alpha = rng.uniform(SMOOTHEST, 1, (512, 2))
    np.testing.assert_allclose(masking(name, v, l, alpha), masking(name, l, v, alpha), rtol=1e-6)


def test_equal_alphas_are_isotropic_and_a_quarter_turn_exchanges_them():
    rng = np.random.default_rng(1)
    v, l = (towards(np.arccos(rng.uniform(0, 1, 512)), rng.uniform(0, 7, 512)) for _ in "vl")
    alpha, turn = rng.uniform(SMOOTHEST, 1, (512, 2)), np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    one, other = (masking(name, v, l, alpha[:, :1]) for name in ("smith_correlated", "smith_correlated_anisotropic"))
    np.testing.assert_allclose(one, other, rtol=1e-6)
    turned = masking("smith_correlated_anisotropic", v @ turn, l @ turn, alpha[:, ::-1])
    np.testing.assert_allclose(turned, masking("smith_correlated_anisotropic", v, l, alpha), rtol=1e-6)


def test_published_values():
    """G₁ of GGX at α = 0.1, from Mitsuba 3's test of its `smith_g1`."""
    for theta, g1 in ((np.radians(60), 0.99261039), (0.98 * np.pi / 2, 0.46130955)):
        for name in ("smith_correlated", "smith_correlated_anisotropic", "smith_separable"):
            np.testing.assert_allclose(lit_along_n(name, towards(theta), (0.1, 0.1)), g1, rtol=2e-6)


def test_agrees_with_mitsuba():
    mitsuba = pytest.importorskip("mitsuba", reason="an independent implementation of the same masking")
    mitsuba.set_variant("scalar_rgb")
    rng = np.random.default_rng(2)
    for _ in range(40):
        alpha = rng.uniform(0.05, 1, 2)
        v = towards(np.arccos(rng.uniform(0.2, 1)), rng.uniform(0, 7)).astype(np.float32)
        theirs = mitsuba.MicrofacetDistribution(mitsuba.MicrofacetType.GGX, *map(float, alpha))
        g1 = theirs.smith_g1(mitsuba.Vector3f(*map(float, v)), mitsuba.Vector3f(*UP))
        np.testing.assert_allclose(lit_along_n("smith_correlated_anisotropic", v, alpha), g1, rtol=1e-5)


@ALL
def test_single_precision_keeps(name):
    cosines = [0.0, 1e-4, 0.01, 0.3, 0.9, 1.0]
    c, d, phi, a = product(cosines, cosines, [0.0, 2.5], [SMOOTHEST, 0.01, 0.3, 1.0])
    few = (c > 0) | (d > 0)
    v, l = towards(np.arccos(c), 0.4)[few], towards(np.arccos(d), phi)[few]
    check_precision(MASKINGS[name], np.maximum(v, 0), np.maximum(l, 0), np.stack([a, np.sqrt(a)], axis=-1)[few])


@ALL
def test_finite_at_every_edge(name):
    """n·v = 0 or n·l = 0; roughness 0, which the material raises to the least, and 1."""
    v = [towards(theta, 1.0) for theta in (0.0, 1.0, 1.5707)] + [np.array([1.0, 0, 0]), np.array([0, 1.0, 0])]
    v, l, alpha = product(v, v, [(SMOOTHEST, SMOOTHEST), (SMOOTHEST, 1.0), (1.0, 1.0)])
    few = (v[:, 2] > 0) | (l[:, 2] > 0)
    assert (check_finite(MASKINGS[name], v[few], l[few], alpha[few]) > 0).all()


@ALL
def test_gradients_are_exact_and_every_call_the_same(name):
    rng = np.random.default_rng(3)
    v, l = (towards(rng.uniform(0.1, 1.4, 16), rng.uniform(0, 7, 16)) for _ in "vl")
    alpha = rng.uniform(0.3, 1, (16, 2))
    check_slopes(MASKINGS[name], v, l, alpha)
    check_calls(MASKINGS[name], v, l, alpha)
