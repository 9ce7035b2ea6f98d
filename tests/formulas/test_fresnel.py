"""Fresnel reflectance: printed values, textbook twins, limits, and finite slopes where the true ones have no bound."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pointwise import check_calls, check_finite, check_precision, check_slopes, product, single

from jaxraster.brdf.fresnel import F82, conductor, dielectric, schlick, schlick_f82

DIELECTRIC, CONDUCTOR, TINTED = jax.jit(dielectric), jax.jit(conductor), jax.jit(schlick_f82)
# Linear RGB of n and k: gold, copper, aluminium and chromium as in Tungsten's and pbrt's tables of metals.
METALS = {
    "gold": ((0.14312, 0.37496, 1.44248), (3.98316, 2.38572, 1.60322)),
    "copper": ((0.20044, 0.92403, 1.10221), (3.91295, 2.45285, 2.14219)),
    "aluminium": ((1.65746, 0.88037, 0.52123), (9.22387, 6.26952, 4.83700)),
    "chromium": ((4.36968, 2.91670, 1.65470), (5.20643, 4.23136, 3.75495)),
}


def twin(cosine, index) -> np.ndarray:
    """Fresnel's two amplitudes with a complex cosine of the refracted ray, as in Born and Wolf."""
    index = np.asarray(index, complex)
    refracted = np.sqrt(1 - (1 - np.square(cosine)) / index**2)
    across = (cosine - index * refracted) / (cosine + index * refracted)
    along = (index * cosine - refracted) / (index * cosine + refracted)
    return 0.5 * (np.abs(across) ** 2 + np.abs(along) ** 2)


def mean(f, critical: float = 0.0) -> np.ndarray:
    """2 ∫ F cos dcos of a function of cosines `[n]` above the critical, by Gauss's points in √(cos² - critical²)."""
    x, weight = np.polynomial.legendre.leggauss(100)
    most = np.sqrt(1 - critical**2)
    g, dg = most * 0.5 * (x + 1), most * 0.5 * weight
    return (2 * np.asarray(f(jnp.asarray(np.hypot(critical, g))), np.float64).T * g * dg).sum(axis=-1)


# -- Dielectrics -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ior", "degrees", "expected"),
    [
        # Head on it is ((n - 1)/(n + 1))², and at Brewster's angle half of ((n² - 1)/(n² + 1))².
        (1.5, 0.0, 0.04),
        (1 / 1.5, 0.0, 0.04),
        (1.333, 0.0, (0.333 / 2.333) ** 2),
        (2.42, 0.0, (1.42 / 3.42) ** 2),
        (1.5, 56.309932, 0.5 * (1.25 / 3.25) ** 2),
        (1.5, 60.0, 0.0891867),
        (1.5, 75.0, 0.2530606),
        (1.5, 85.0, 0.6127996),
        (1.333, 60.0, 0.0596909),
        (2.42, 60.0, 0.2115976),
        (1.5, 90.0, 1.0),
        (1 / 1.5, 90.0, 1.0),
        (1 / 1.5, 41.9, 1.0),
        (1.0, 0.0, 0.0),
        (1.0, 90.0, 0.0),
    ],
)
def test_dielectric_values(ior, degrees, expected):
    """Those between are from a calculation in double precision; the critical angle of glass is 41.81°."""
    cosine = 0.0 if degrees == 90 else np.cos(np.radians(degrees))
    np.testing.assert_allclose(DIELECTRIC(single([cosine]), single([ior])), [expected], rtol=2e-6)


def test_the_mean_out_of_glass_is_that_into_it_less_what_cannot_leave():
    """1 - mean(1/n) = (1 - mean(n))/n², as light exchanged by both sides must balance; 0.0917780 for glass."""
    for n, expected in ((1.5, 0.0917780), (1.333, 0.0664058)):
        critical = np.sqrt(1 - 1 / n**2)
        with jax.enable_x64(True):
            into = mean(lambda c, n=n: dielectric(c, jnp.full(c.shape, n)))
            out = critical**2 + mean(lambda c, n=n: dielectric(c, jnp.full(c.shape, 1 / n)), critical)
        np.testing.assert_allclose(into, expected, atol=1e-7)
        np.testing.assert_allclose(1 - out, (1 - into) / n**2, atol=1e-12)


def test_dielectrics_are_those_of_the_textbook():
    cosine, ior = product(np.linspace(0.001, 1, 97), [1 / 2.42, 1 / 1.5, 0.9997, 1.0003, 1.333, 1.5, 2.42])
    with jax.enable_x64(True):
        np.testing.assert_allclose(dielectric(jnp.asarray(cosine), jnp.asarray(ior)), twin(cosine, ior), atol=2e-13)


def test_dielectrics_grow_towards_grazing_angles():
    cosine, ior = product(np.linspace(1, 0, 500), [1.1, 1.5, 2.42])
    f = np.asarray(DIELECTRIC(single(cosine), single(ior))).reshape(-1, 3)
    assert (np.diff(f, axis=0) > -1e-7).all() and (f[0] < 0.2).all()
    np.testing.assert_allclose(f[-1], 1, atol=3e-7)


def test_total_reflection_has_no_slope_and_the_way_to_it_a_finite_one():
    """At the critical angle itself and beside it; outside the range of cosines; where nothing is mirrored."""
    critical = np.sqrt(1 - 1 / 2.25)
    near = np.float32(critical) + np.arange(-3, 4) * np.float32(6e-8)
    cosines = [-1.0, -0.0, 0.0, 1e-38, 1e-20, 1e-3, 0.3, *near, 0.9, 1 - 6e-8, 1.0, 1 + 1.2e-7, 2.0]
    cosine, ior = product(cosines, [1e-3, 1 / 1.5, 1 - 6e-8, 1.0, 1 + 1.2e-7, 1.5, 100.0])
    value = check_finite(dielectric, cosine, ior)
    assert (value >= 0).all() and (value <= 1 + 1e-6).all()
    assert (value[ior == 1] == 0).all()
    beyond = (ior == 1 / 1.5) & (cosine > 0) & (cosine < critical - 1e-6)
    assert beyond.sum() == 4 and (value[beyond] == 1).all()
    slope = jax.vmap(jax.grad(dielectric, (0, 1)))(single(cosine[beyond]), single(ior[beyond]))
    assert all((np.asarray(s) == 0).all() for s in slope)


# -- Conductors --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("metal", "head_on", "at_82"),
    [
        ("gold", (0.96666, 0.80219, 0.32405), (0.96649, 0.89232, 0.63866)),
        ("copper", (0.95214, 0.61968, 0.51058), (0.95313, 0.77056, 0.72456)),
        ("aluminium", (0.92805, 0.91780, 0.91891), (0.84822, 0.87008, 0.90022)),
        ("chromium", (0.68755, 0.64907, 0.68701), (0.57995, 0.61400, 0.70723)),
    ],
)
def test_conductor_values(metal, head_on, at_82):
    """Head on it is ((n - 1)² + k²)/((n + 1)² + k²); the others are from a calculation in double precision."""
    n, k = (single([x] * 3) for x in METALS[metal])
    n1, k1 = (np.array(x) for x in METALS[metal])
    np.testing.assert_allclose(((n1 - 1) ** 2 + k1**2) / ((n1 + 1) ** 2 + k1**2), head_on, atol=6e-6)
    f = CONDUCTOR(single([1.0, F82, 0.0]), n, k)
    np.testing.assert_allclose(f, [head_on, at_82, [1.0] * 3], atol=6e-6)


def test_conductors_are_those_of_the_textbook():
    cosine, n, k = product(np.linspace(0.001, 1, 31), [0.05, 0.4, 1.0, 3.2], [0.0, 1e-3, 0.5, 3.0, 50.0])
    n, k = (np.repeat(x[:, None], 3, axis=1) for x in (n, k))
    with jax.enable_x64(True):
        f = conductor(jnp.asarray(cosine), jnp.asarray(n), jnp.asarray(k))
    np.testing.assert_allclose(f, twin(cosine[:, None], n + 1j * k), atol=2e-13)


def test_a_conductor_that_absorbs_nothing_is_a_dielectric():
    """Total reflection included."""
    cosine, ior = product(np.linspace(0, 1, 101), [0.4, 1 / 1.5, 1.333, 1.5, 2.42])
    triple = np.repeat(ior[:, None], 3, axis=1)
    f = CONDUCTOR(single(cosine), single(triple), jnp.zeros((len(ior), 3)))
    np.testing.assert_allclose(f[:, 1], DIELECTRIC(single(cosine), single(ior)), rtol=2e-6, atol=1e-7)


def test_agrees_with_mitsuba():
    mitsuba = pytest.importorskip("mitsuba", reason="an independent implementation of the same equations")
    mitsuba.set_variant("scalar_rgb")
    rng = np.random.default_rng(0)
    for cosine, n, k in zip(rng.uniform(0.05, 1, 50), rng.uniform(0.4, 3, 50), rng.uniform(0.1, 6, 50)):
        ours = DIELECTRIC(single([cosine]), single([n]))
        np.testing.assert_allclose(ours, mitsuba.fresnel(float(cosine), float(n))[0], rtol=2e-5, atol=1e-7)
        ours = CONDUCTOR(single([cosine]), single([[n] * 3]), single([[k] * 3]))[0, 0]
        theirs = mitsuba.fresnel_conductor(float(cosine), mitsuba.Complex2f(float(n), float(k)))
        np.testing.assert_allclose(ours, theirs, rtol=2e-5)


def test_conductors_are_finite_at_every_edge():
    """Cosines outside their range, metals that do not absorb or not refract, and nothing at all, n = 1 and k = 0."""
    cosine, n, k = product(
        [-1.0, 0.0, 1e-20, 1e-3, 1 - 6e-8, 1.0, 2.0], [1e-3, 0.5, 1.0, 3.0], [0.0, 1e-20, 1.0, 100.0]
    )
    n, k = (np.repeat(x[:, None], 3, axis=1) for x in (n, k))
    value = check_finite(conductor, cosine, n, k)
    assert (value >= 0).all() and (value <= 1 + 1e-6).all() and (value[(n == 1) & (k == 0)] < 1e-12).all()


# -- Schlick with a second colour --------------------------------------------------------------------------------------

COLORS = [(0.0, 0.04, 1.0), (0.9, 0.5, 0.2)]


def test_a_tint_is_what_is_mirrored_at_82_degrees():
    f0, tint = single([COLORS[1]] * 4), single([(0.5, 1.0, 0.0)] * 4)
    f = TINTED(f0, tint, single([1.0, F82, 0.0, 0.6]))
    np.testing.assert_allclose(f[0], f0[0], rtol=1e-6)
    np.testing.assert_allclose(f[1], schlick(f0, single([F82] * 4))[1] * tint[1], rtol=1e-6, atol=1e-7)
    assert (f[2] == 1).all()
    np.testing.assert_allclose(f[:, 1], schlick(f0, single([1.0, F82, 0.0, 0.6]))[:, 1], rtol=1e-6)
    np.testing.assert_allclose(np.degrees(np.arccos(F82)), 81.7868, atol=1e-4)


def test_the_mean_of_a_tinted_metal():
    """f0 + (1 - f0)/21 - b/126, b = S(1/7)(1 - tint)/(1/7 (6/7)⁶), as 2 ∫ c² (1 - c)⁶ dc = 1/126."""
    f0, tint = np.array([0.9, 0.5, 0.55]), np.array([0.9, 1.0, 0.74])
    with jax.enable_x64(True):
        rows = [jnp.asarray(np.tile(x, (100, 1))) for x in (f0, tint)]
        measured = mean(lambda c: schlick_f82(*rows, c))
    b = (f0 + (1 - f0) * (6 / 7) ** 5) * (1 - tint) / (1 / 7 * (6 / 7) ** 6)
    np.testing.assert_allclose(measured, f0 + (1 - f0) / 21 - b / 126, atol=1e-10)


def test_tinted_reflection_stays_between_nothing_and_schlick():
    c, f0, tint = product(np.linspace(0, 1, 200), [0.0, 0.04, 0.5, 1.0], [0.0, 0.5, 1.0])
    f0, tint = (np.repeat(x[:, None], 3, axis=1) for x in (f0, tint))
    f, s = (np.asarray(x) for x in (TINTED(single(f0), single(tint), single(c)), schlick(single(f0), single(c))))
    assert f.min() == 0 and (f <= s + 1e-7).all()
    # Nothing is cut from what a metal may be: white at worst touches 0, at 82°.
    assert (f[(f0 == 1) & (np.abs(c - F82) > 0.05)[:, None]] > 0).all()


def test_schlick_misses_metals_where_a_tint_does_not():
    """f0 and tint from the exact F at both cosines; the largest error at any angle, in any channel."""
    cosine = np.linspace(0, 1, 400)
    off = {}
    for name, (n, k) in METALS.items():
        n, k = (single([x] * 400) for x in (n, k))
        exact = np.asarray(CONDUCTOR(single(cosine), n, k))
        f0, at_82 = (CONDUCTOR(jnp.full(400, c), n, k) for c in (1.0, F82))
        tint = at_82 / schlick(f0, jnp.full(400, F82))
        pair = (schlick(f0, single(cosine)), TINTED(f0, tint, single(cosine)))
        off[name] = tuple(float(np.abs(f - exact).max()) for f in pair)
    print(off)
    assert off["chromium"][0] > 0.25 and off["aluminium"][0] > 0.12
    assert max(tinted for _, tinted in off.values()) < 0.06 and off["aluminium"][1] < 0.035


# -- Numbers -----------------------------------------------------------------------------------------------------------


def colors(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 1, (count, 3))


ARGUMENTS = {
    "dielectric": lambda rng: (rng.uniform(0.1, 0.95, 16), rng.uniform(1.2, 2.5, 16)),
    "out of glass": lambda rng: (rng.uniform(0.8, 0.95, 16), rng.uniform(0.66, 0.7, 16)),
    "conductor": lambda rng: (rng.uniform(0.1, 0.95, 16), rng.uniform(0.2, 3, (16, 3)), rng.uniform(0.5, 5, (16, 3))),
    "schlick_f82": lambda rng: (*rng.uniform(0.1, 1, (2, 16, 3)), rng.uniform(0.05, 0.95, 16)),
}
FORMULAS = {
    "dielectric": dielectric,
    "out of glass": dielectric,
    "conductor": conductor,
    "schlick_f82": schlick_f82,
}


@pytest.mark.parametrize("name", FORMULAS)
def test_gradients_are_exact_and_every_call_the_same(name):
    arguments = ARGUMENTS[name](np.random.default_rng(5))
    check_slopes(FORMULAS[name], *arguments)
    check_calls(FORMULAS[name], *arguments)


def test_single_precision_keeps():
    """Glass, and air against air, whose F is 2e-8; metals; not where a rounded cosine decides what leaves glass."""
    cosine, ior = product([0.0, 1e-6, 1e-3, 0.1, 0.5, 0.5547, 0.9, 1.0], [1.0003, 1.333, 1.5, 2.42])
    check_precision(dielectric, cosine, ior, rtol=2e-6)
    cosine, ior = product([0.8, 0.9, 1.0], [1 / 1.5, 0.9, 0.9997])
    check_precision(dielectric, cosine, ior, rtol=1e-5)
    cosine, n, k = product([0.0, 1e-6, 1e-3, 0.1, 0.5, 0.9, 1.0], [0.05, 0.5, 1.0, 3.0], [0.1, 1.0, 4.0, 100.0])
    n, k = (np.repeat(x[:, None], 3, axis=1) for x in (n, k))
    check_precision(conductor, cosine, n, k, rtol=2e-6)
    c, f0, tint = product([0.0, 1e-6, 1e-3, 0.1, 1 / 7, 0.5, 1.0], [0.02, 0.5, 1.0], [0.5, 0.9, 1.0])
    f0, tint = (np.repeat(x[:, None], 3, axis=1) for x in (f0, tint))
    check_precision(schlick_f82, f0, tint, c, rtol=1e-5)


def test_tints_are_finite_at_every_edge():
    f0, tint, c = product(COLORS, [(0.0, 1.0, 0.5), (1.0, 0.0, 1.01)], [-1.0, 0.0, 1e-20, F82, 1.0, 1 + 1.2e-7])
    assert (check_finite(schlick_f82, f0, tint, c) >= 0).all()
