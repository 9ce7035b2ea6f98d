"""Distributions of microfacet normals: normalized, at their limits, as exact as float32, and finite everywhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from facets import UP, facets
from pointwise import check_calls, check_finite, check_precision, check_slopes, in_double, product, single, towards

from jaxraster.brdf.distribution import beckmann, ggx, ggx_anisotropic
from jaxraster.surface.material import MIN_ROUGHNESS

SMOOTHEST = MIN_ROUGHNESS**2


def up(h):
    return jnp.broadcast_to(jnp.asarray(UP, h.dtype), h.shape)


# All take h and two alpha in the surface's own space; isotropic ones look at the first alpha.
DISTRIBUTIONS = {
    "ggx": lambda h, alpha: ggx(up(h), h, alpha[..., 0]),
    "ggx_anisotropic": ggx_anisotropic,
    "beckmann": lambda h, alpha: beckmann(up(h), h, alpha[..., 0]),
}
D = {name: jax.jit(function) for name, function in DISTRIBUTIONS.items()}
ALL = pytest.mark.parametrize("name", DISTRIBUTIONS)
EQUAL = [(SMOOTHEST, SMOOTHEST), (0.01, 0.01), (0.25, 0.25), (1.0, 1.0)]
LOBES = [("ggx", pair) for pair in EQUAL] + [("beckmann", pair) for pair in EQUAL]
LOBES += [("ggx_anisotropic", pair) for pair in [(SMOOTHEST, 1.0), (0.1, 0.3), (0.7, 0.05), (0.25, 0.25)]]


@pytest.mark.parametrize(("name", "alpha"), LOBES)
def test_the_distribution_covers_the_surface_once(name, alpha):
    """∫ D (n·h) dh = 1: the facets that n sees."""
    _, area = facets(D[name], alpha, np.array(UP))
    np.testing.assert_allclose(area.sum(), 1, atol=3e-6)


def test_peaks():
    """D at h = n is 1/(π αₓα_y) for all."""
    alpha = single([(0.1, 0.1), (0.1, 0.3), (1.0, 1.0)])
    for name in DISTRIBUTIONS:
        expected = 1 / (np.pi * np.array([0.01, 0.03 if name == "ggx_anisotropic" else 0.01, 1.0]))
        np.testing.assert_allclose(D[name](single([UP] * 3), alpha), expected, rtol=1e-6, err_msg=name)


def test_equal_alphas_are_isotropic():
    rng = np.random.default_rng(1)
    alpha = np.repeat(rng.uniform(SMOOTHEST, 1, (512, 1)), 2, axis=1)
    h = towards(np.arccos(rng.uniform(0.01, 1, 512)), rng.uniform(0, 7, 512))
    h[:256] = towards(rng.uniform(0, 4, 256) * alpha[:256, 0], rng.uniform(0, 7, 256))
    one, other = (D[name](single(h), single(alpha)) for name in ("ggx", "ggx_anisotropic"))
    np.testing.assert_allclose(one, other, rtol=2e-6)


def test_the_axes_are_those_of_their_alphas():
    """A quarter turn exchanges them, and a lobe is wide along its large alpha."""
    h, turn = towards(0.4, 0.3), np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    one, other = D["ggx_anisotropic"](single([h, h @ turn]), single([(0.1, 0.6), (0.6, 0.1)]))
    np.testing.assert_allclose(one, other, rtol=1e-6)
    wide, narrow = D["ggx_anisotropic"](single([towards(0.5, np.pi / 2), towards(0.5)]), single([(0.1, 0.6)] * 2))
    assert wide > 100 * narrow


def test_beckmann_has_no_tail():
    """e⁻¹ of the peak at tan θ = α but for cos⁴, and nothing far out, where GGX has a thousandth."""
    theta = np.arctan(0.1)
    h, alpha = single([towards(theta), towards(0.8)]), single([(0.1, 0.1)] * 2)
    value = D["beckmann"](h, alpha)
    np.testing.assert_allclose(value[0] * np.pi * 0.01 * np.cos(theta) ** 4, np.exp(-1), rtol=1e-6)
    assert value[1] < 1e-30 and 1e-4 < D["ggx"](h, alpha)[1] * np.pi * 0.01 < 1e-3


def test_agrees_with_mitsuba():
    """For any pair of alpha."""
    mitsuba = pytest.importorskip("mitsuba", reason="an independent implementation of the same lobes")
    mitsuba.set_variant("scalar_rgb")
    rng = np.random.default_rng(2)
    for kind, name in (("GGX", "ggx_anisotropic"), ("Beckmann", "beckmann")):
        for _ in range(40):
            a, b = rng.uniform(0.05, 1, 2)
            b = a if name == "beckmann" else b
            h = towards(np.arccos(rng.uniform(0.2, 1)), rng.uniform(0, 7)).astype(np.float32)
            theirs = mitsuba.MicrofacetDistribution(getattr(mitsuba.MicrofacetType, kind), a, b)
            ours = D[name](single([h]), single([(a, b)]))
            np.testing.assert_allclose(ours, theirs.eval(mitsuba.Normal3f(*map(float, h))), rtol=1e-4, atol=1e-6)


@ALL
def test_single_precision_keeps(name):
    theta, phi, a, b = product(
        [0.0, 1e-4, 5e-4, 2e-3, 1e-2, 0.1, 0.7, 1.5], [0.0, 0.6, 2.5], [SMOOTHEST, 0.01, 0.3, 1.0], [SMOOTHEST, 1.0]
    )
    h, alpha = towards(theta, phi), np.stack([a, b], axis=-1)
    peak = 1 / (np.pi * a * (b if name == "ggx_anisotropic" else a))
    values = in_double(DISTRIBUTIONS[name], h, alpha)
    # A Gaussian counts a rounding as many times as its logarithm says: its docstring promises a millionth of the peak.
    seen = values > 1e-6 * peak if name == "beckmann" else values > 0
    assert seen.sum() > 80
    check_precision(DISTRIBUTIONS[name], h[seen], alpha[seen])
    if name == "beckmann":
        faint = np.asarray(D[name](single(h[~seen]), single(alpha[~seen])))
        assert (np.abs(faint - values[~seen]) < 1e-11 * peak[~seen]).all()


@pytest.mark.parametrize("formula", [ggx, beckmann])
def test_no_direction_of_the_normal_costs_precision(formula):
    """From the peak to twice alpha, around normals of every direction."""
    rng = np.random.default_rng(5)
    n = towards(np.arccos(rng.uniform(-1, 1, 2048)), rng.uniform(0, 7, 2048))
    across = np.cross(n, rng.normal(size=n.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    alpha = rng.choice([SMOOTHEST, 0.01, 0.3], 2048)
    h = n + across * (alpha * rng.choice([0.0, 0.1, 1.0, 2.0], 2048))[:, None]
    check_precision(formula, n, h / np.linalg.norm(h, axis=1, keepdims=True), alpha, rtol=5e-6)


@ALL
def test_finite_at_every_edge(name):
    """No half vector (l = -v), h = n, on and below the horizon; alpha from 0, a mirror's."""
    h = [np.zeros(3), np.array(UP), towards(1e-7), towards(1e-3), towards(1.0), np.array([1.0, 0, 0])]
    h += [towards(1.5708), towards(1.5, 2.0), towards(2.0), -np.array(UP), np.array([1.0, 0, 1e-38])]
    alphas = [0.0, 1e-30, 1e-13, 1e-6, 2e-6, 1e-4, SMOOTHEST, 0.5, 1.0]
    h, alpha = product(h, [(a, b) for a in alphas for b in (a, 0.3)])
    value = check_finite(DISTRIBUTIONS[name], h, alpha)
    assert (value >= 0).all() and (value[h[:, 2] <= 0] == 0).all() and (value[alpha[:, 0] == 0] == 0).all()
    assert (value[(h[:, 2] == 1) & (alpha[:, 0] > 1e-6)] > 0.3).all()


@ALL
def test_gradients_are_exact_and_every_call_the_same(name):
    rng = np.random.default_rng(3)
    h, alpha = towards(rng.uniform(0.1, 1.4, 16), rng.uniform(0, 7, 16)), rng.uniform(0.3, 1, (16, 2))
    check_slopes(DISTRIBUTIONS[name], h, alpha)
    check_calls(DISTRIBUTIONS[name], h, alpha, rtol=1e-5)
