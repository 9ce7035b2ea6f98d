"""Sheen: Charlie's distribution and masking as printed, their albedo and its fit, energy, and ugly points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from facets import SIDE, gauss
from pointwise import check_calls, check_finite, check_precision, check_slopes, in_double, product, single, towards

from jaxraster.brdf.sheen import (
    SMOOTHEST,
    charlie,
    charlie_visibility,
    sheen,
    sheen_albedo,
    sheen_scaling,
)

D, V = jax.jit(charlie), jax.jit(charlie_visibility)
ALBEDO, SCALING = jax.jit(sheen_albedo), jax.jit(sheen_scaling)
Z = np.array([0.0, 0.0, 1.0])
ROUGHNESSES = (0.1, 0.15, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)


def shadow(x: float, alpha: float) -> float:
    """Λ as the extension prints it."""
    t = (1 - alpha) ** 2
    a, b, c, d, e = (
        rough * (1 - t) + smooth * t
        for rough, smooth in (
            (21.5473, 25.3245), (3.82987, 3.32435), (0.19823, 0.16801), (-1.97760, -1.27393), (-4.32054, -4.85967)
        )
    )  # fmt: skip

    def exponent(x):
        return a / (1 + b * x**c) + d * x + e

    return np.exp(exponent(x)) if x < 0.5 else np.exp(2 * exponent(0.5) - exponent(1 - x))


def up(h):
    return jnp.broadcast_to(jnp.asarray(Z, h.dtype), h.shape)


def standing(h, alpha):
    """D around +Z."""
    return charlie(up(h), h, alpha)


def white(v, l, alpha):
    """White sheen around +Z, one channel."""
    return sheen(up(v), v, l, jnp.ones_like(v), alpha)[..., 0]


def test_the_distribution_and_masking_are_those_of_the_extension():
    for roughness in (0.2, 0.5, 1.0):
        alpha = roughness**2
        for theta in (0.05, 0.5, 1.0, 1.5):
            expected = (2 + 1 / alpha) * np.sin(theta) ** (1 / alpha) / (2 * np.pi)
            value = in_double(standing, towards(theta)[None], [alpha])
            # The sine is that of float32 vectors.
            np.testing.assert_allclose(value, [expected], rtol=2e-5, atol=1e-30)
        for x, y in ((0.05, 0.3), (0.4, 0.6), (0.9, 0.499), (0.5, 0.002)):
            expected = 1 / ((1 + shadow(x, alpha) + shadow(y, alpha)) * 4 * x * y)
            np.testing.assert_allclose(V(single([x]), single([y]), single([alpha])), [expected], rtol=2e-5)


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_the_distribution_covers_the_surface_once(roughness):
    """∫ D (n·h) dh = 1, with x = sin^(1/α) of the angle: all of it lies near the horizon at small alpha."""
    x, weight = gauss()
    alpha = roughness**2
    sine = x**alpha
    h = towards(np.arcsin(sine))
    # cos sin dθ = sin dsin, and dsin = α x^(α-1) dx.
    d = in_double(standing, h, np.full(SIDE, alpha))
    area = (d * sine * alpha * x ** (alpha - 1) * 2 * np.pi * weight).sum()
    np.testing.assert_allclose(area, 1, atol=1e-4)


def test_masking_is_nearly_that_of_the_distribution():
    """∫ G₁(v) D (v·h)₊ dh = n·v, exact for Smith's Λ, holds for the published fit of it to 12 percent."""
    x, weight = gauss()
    off = {}
    for roughness in (0.3, 0.5, 0.8, 1.0):
        alpha = roughness**2
        sine = x**alpha
        theta = np.arcsin(sine)
        d = (2 + 1 / alpha) * x / (2 * np.pi)
        solid = sine / np.cos(theta) * alpha * x ** (alpha - 1) * weight
        for n_dot_v in (0.1, 0.3, 0.6, 0.9):
            v = np.array([np.sqrt(1 - n_dot_v**2), 0, n_dot_v])
            limit = np.arccos(np.clip(-n_dot_v * np.cos(theta) / (v[0] * sine), -1, 1))
            h = towards(theta[:, None], limit[:, None] * x)
            area = ((d * solid * limit)[:, None] * weight * 2 * np.maximum(h @ v, 0)).sum()
            g1 = 1 / (1 + shadow(n_dot_v, alpha))
            off[roughness, n_dot_v] = g1 * area / n_dot_v - 1
    print(off)
    assert 0.1 < max(map(abs, off.values())) < 0.125


def lit_from_everywhere(n_dot_v: float, alpha: float) -> float:
    """∫ D V (n·l) dl, in double precision; points crowd towards n·l = 0, where V changes fastest."""
    x, weight = gauss()
    z, dz = x * x, 2 * x * weight
    l = towards(np.arccos(z)[:, None], np.pi * x).reshape(-1, 3)
    v = np.broadcast_to(towards(np.arccos(n_dot_v)), l.shape)
    value = in_double(white, v, l, np.full(len(l), alpha))
    return (value.reshape(SIDE, SIDE) * dz[:, None] * weight * 2 * np.pi).sum()


@pytest.fixture(scope="module")
def integrals() -> dict[tuple[float, float], float]:
    return {(r, c): lit_from_everywhere(c, r * r) for r in ROUGHNESSES for c in (0.001, 0.02, 0.05, 0.1, 0.3, 0.6, 1.0)}


def test_the_albedo_is_as_far_off_as_it_says(integrals):
    """Of what is at most 1: 0.008; where the integral is more, the fit is 1."""
    fit = {(r, c): float(ALBEDO(single([c]), single([r * r]))[0]) for r, c in integrals}
    off = {key: abs(fit[key] - min(integrals[key], 1)) for key in fit}
    print(max(off.values()), max(off, key=off.get))
    assert 0.006 < max(off.values()) < 0.0085


def test_white_sheen_gains_only_where_it_says(integrals):
    """Twice at most, at the smallest of both; nothing from a roughness of 0.3 on."""
    assert max(integrals, key=integrals.get) == (0.1, 0.001)
    np.testing.assert_allclose(integrals[0.1, 0.001], 2.1, atol=0.05)
    assert max(value for (r, _), value in integrals.items() if r >= 0.3) < 1


def test_a_white_base_under_white_sheen_returns_no_more_than_it_gets(integrals):
    """E(n·v) + ∫ scaling (n·l)/π dl, up to the error of the fit; scaling is the same from both sides."""
    x, weight = gauss()
    for (r, c), own in integrals.items():
        if own <= 1:
            cosine = jnp.full(SIDE, c)
            scaling = SCALING(jnp.ones((SIDE, 3)), cosine, single(x), jnp.full(SIDE, r * r))
            assert own + (np.asarray(scaling) * 2 * x * weight).sum() < 1.0085
            back = SCALING(jnp.ones((SIDE, 3)), single(x), cosine, jnp.full(SIDE, r * r))
            np.testing.assert_array_equal(scaling, back)


def test_scaling_follows_the_largest_channel():
    c, alpha = single([0.2, 0.2, 0.2]), jnp.full(3, 0.25)
    scaling = SCALING(single([(0, 0, 0), (0.5, 0.1, 0), (0.2, 0.3, 0.5)]), c, jnp.ones(3), alpha)
    assert scaling[0] == 1
    np.testing.assert_allclose(scaling[1:], 1 - 0.5 * ALBEDO(c, alpha)[1:], rtol=1e-6)


def test_light_and_viewer_may_change_places():
    rng = np.random.default_rng(0)
    v, l = (towards(np.arccos(rng.uniform(0.002, 1, 512)), rng.uniform(0, 7, 512)) for _ in "vl")
    alpha = rng.uniform(SMOOTHEST, 1, 512)
    there, back = (in_double(white, *pair, alpha) / np.float64(np.float32(pair[1][:, 2])) for pair in ((v, l), (l, v)))
    np.testing.assert_allclose(there, back, rtol=1e-9)


def test_the_least_alpha_counts_for_all_below():
    h, x = single([towards(1.5)] * 3), jnp.full(3, 0.2)
    alpha = single([0.0, 1e-30, SMOOTHEST])
    for value in (D(up(h), h, alpha), V(x, x, alpha), ALBEDO(x, alpha)):
        assert value[0] == value[1] == value[2] > 0


# -- Numbers -----------------------------------------------------------------------------------------------------------

ALONE = {
    "charlie": lambda rng: (
        towards(rng.uniform(0, 0.2, 16), 1.0),
        towards(rng.uniform(0.3, 1.3, 16), rng.uniform(0, 7, 16)),
    ),
    "charlie_visibility": lambda rng: tuple(rng.uniform(0.05, 0.95, (2, 16))),
    "sheen_albedo": lambda rng: (rng.uniform(0.1, 0.95, 16),),
    "sheen_scaling": lambda rng: (rng.uniform(0, 1, (16, 3)), *rng.uniform(0.1, 0.95, (2, 16))),
    "sheen": lambda rng: (
        towards(rng.uniform(0, 0.2, 16), 1.0),
        *(towards(rng.uniform(0, 1.2, 16), rng.uniform(0, 7, 16)) for _ in "vl"),
        rng.uniform(0, 1, (16, 3)),
    ),
}
FORMULAS = {
    "charlie": charlie,
    "charlie_visibility": charlie_visibility,
    "sheen_albedo": sheen_albedo,
    "sheen_scaling": sheen_scaling,
    "sheen": sheen,
}


@pytest.mark.parametrize("name", FORMULAS)
def test_gradients_are_exact_and_every_call_the_same(name):
    rng = np.random.default_rng(1)
    arguments = (*ALONE[name](rng), rng.uniform(0.1, 0.9, 16))
    check_slopes(FORMULAS[name], *arguments, rtol=1e-5)
    check_calls(FORMULAS[name], *arguments, rtol=2e-5)


def test_single_precision_keeps():
    """Of D, where it is above a millionth of its largest: below, a rounding counts as often as its logarithm says."""
    theta, alpha = product([1e-3, 0.1, 0.5, 0.78, 0.8, 1.0, 1.3, 1.5, 1.57], [SMOOTHEST, 0.1, 0.5, 1.0])
    h = towards(theta, 0.7)
    bright = np.sin(theta) ** (1 / alpha) > 1e-6
    assert bright.sum() > 20
    check_precision(standing, h[bright], alpha[bright])
    # Around normals of every direction too, near which sin² is that of a difference.
    rng = np.random.default_rng(2)
    n = towards(np.arccos(rng.uniform(-1, 1, 512)), rng.uniform(0, 7, 512))
    h = n + rng.normal(size=n.shape) * rng.choice([1e-3, 0.1, 1.0], (512, 1))
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    near = (n * h).sum(axis=1) > 0.05
    check_precision(charlie, n[near], h[near], rng.choice([0.5, 1.0], 512)[near])
    cosines = [0.0, 1e-3, 0.01, 0.3, 0.499, 0.5, 0.7, 0.99, 1.0]
    check_precision(charlie_visibility, *product(cosines, cosines, [SMOOTHEST, 0.1, 1.0]))
    check_precision(sheen_albedo, *product(cosines, [SMOOTHEST, 0.05, 0.3, 1.0]), rtol=2e-5)


def test_finite_at_every_edge():
    """n·l = 0, n·v = 0, h = n, l = v, l = -v, both grazing and below; roughness 0 and 1."""
    directions = [Z, towards(0.7), towards(0.7, np.pi), -towards(0.7), -Z, towards(2.0, 1.0), towards(1.5708)]
    directions += [np.array([1.0, 0, 0]), np.array([-1.0, 0, 0]), np.array([0, 1.0, 1e-40]), np.zeros(3)]
    v, l, alpha = product(directions, directions, [0.0, SMOOTHEST, 1.0])
    value = check_finite(white, v, l, alpha)
    lit = l[:, 2].astype(np.float32) > 1e-38
    assert (value >= 0).all() and (value[~lit] == 0).all() and (value[lit] > 0).any()
    cosines = [-1.0, 0.0, 1e-30, 1e-3, 0.5, 1 - 6e-8, 1.0, 1 + 1.2e-7]
    assert (check_finite(charlie_visibility, *product(cosines, cosines, [0.0, 1.0])) > 0).all()
    color, x, y, alpha = product([(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)], cosines, cosines, [0.0, 1.0])
    scaling = check_finite(sheen_scaling, color, x, y, alpha)
    assert (scaling >= 0).all() and (scaling <= 1).all()
    h = [Z, np.zeros(3), towards(1e-7), towards(np.pi / 4), np.array([1.0, 0, 0]), -Z]
    h, alpha = product(h, [0.0, 0.1, 1.0])
    assert (check_finite(standing, h, alpha) >= 0).all()
