"""Visible normals of GGX: drawn with their density, which is that of the BRDF's own formulas, at every edge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.brdf.distribution import ggx
from jaxraster.brdf.masking import smith_correlated
from jaxraster.brdf.sampling import reflection_weight, visible_density, visible_normal
from jaxraster.math.hash import keyed, uniform
from jaxraster.math.sobol import sobol

N = 2**17
STEP = 2.0**-24
DRAW, DENSITY, WEIGHT = jax.jit(visible_normal), jax.jit(visible_density), jax.jit(reflection_weight)
VIEWS = {"above": (0.0, 0.0), "30°": (30.0, 45.0), "60°": (60.0, 200.0), "85°": (85.0, 10.0), "89.99°": (89.99, 300.0)}
ALPHAS = {"smooth": (0.1, 0.1), "rough": (0.7, 0.7), "brushed": (0.15, 0.6), "unit": (1.0, 1.0)}


def towards(theta: float, phi: float) -> np.ndarray:
    """A unit vector, from degrees."""
    theta, phi = np.radians([theta, phi])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def rows(vector, count: int) -> jax.Array:
    return jnp.broadcast_to(jnp.asarray(vector, jnp.float32), (count, len(vector)))


def mirrored(v, h):
    return 2 * np.sum(v * h, axis=-1, keepdims=True) * h - v


def twin(v: np.ndarray, h: np.ndarray, alpha) -> np.ndarray:
    """The density in double precision, by Heitz' own formulas: Λ, G₁ and D."""
    a, b = alpha
    d = 1 / (np.pi * a * b * ((h[..., 0] / a) ** 2 + (h[..., 1] / b) ** 2 + h[..., 2] ** 2) ** 2)
    slope = ((a * v[0]) ** 2 + (b * v[1]) ** 2) / v[2] ** 2
    g1 = 1 / (1 + (np.sqrt(1 + slope) - 1) / 2)
    return g1 * np.maximum(h @ v, 0) * d / v[2] * (h[..., 2] > 0)


def cells(v, alpha, bins: int, fine: int) -> np.ndarray:
    """∫ density over boxes of z' and φ' of h', h where the ellipsoid is a sphere, by the middles of finer boxes."""
    z = (np.arange(bins * fine) + 0.5) / (bins * fine)
    z, phi = np.meshgrid(z, 2 * np.pi * z, indexing="ij")
    radius = np.sqrt(1 - z**2)
    stretched = np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1)
    h = stretched * np.array([*alpha, 1.0])
    length = np.linalg.norm(h, axis=-1)
    # dω = α_x α_y / |αh'|³ dω', and dω' = dz' dφ'.
    shares = twin(v, h / length[..., None], alpha) * np.prod(alpha) / length**3
    shares *= 2 * np.pi / (bins * fine) ** 2
    return shares.reshape(bins, fine, bins, fine).sum(axis=(1, 3))


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_normals_have_the_density_that_they_say(view, alpha):
    """χ² of 12 x 12 boxes, cells of few expected counts taken together; the density integrates to 1."""
    v, a = towards(*VIEWS[view]), np.array(ALPHAS[alpha])
    index = jnp.arange(N, dtype=jnp.uint32)
    u = jnp.stack([uniform(keyed(3, index, dimension)) for dimension in (0, 1)], axis=-1)
    h, density = (np.asarray(x, np.float64) for x in DRAW(u, rows(v, N), rows(a, N)))
    np.testing.assert_allclose(np.linalg.norm(h, axis=-1), 1, atol=5e-7)
    assert (h[:, 2] > 0).all() and np.isfinite(density).all()
    np.testing.assert_allclose(density, twin(v, h, a), rtol=2e-4, atol=1e-6 * density.max())

    expected = cells(v, a, 12, 40).ravel() * N
    np.testing.assert_allclose(expected.sum(), N, rtol=2e-3)
    stretched = h / np.array([*a, 1.0])
    stretched /= np.linalg.norm(stretched, axis=-1, keepdims=True)
    turn = np.arctan2(stretched[:, 1], stretched[:, 0]) / (2 * np.pi) % 1
    counts = np.histogram2d(stretched[:, 2], turn, 12, ((0, 1), (0, 1)))[0].ravel()
    few = expected < 20
    counts, expected = np.append(counts[~few], counts[few].sum()), np.append(expected[~few], expected[few].sum())
    statistic = ((counts - expected) ** 2 / np.maximum(expected, 1)).sum()
    freedom = len(counts) - 1
    assert (statistic - freedom) / np.sqrt(2 * freedom) < 5


@pytest.mark.parametrize("alpha", [0.002, 0.05, 0.4, 1.0])
def test_density_and_weight_are_those_of_the_brdf(alpha):
    """D_v = 2 (v·h) D / (n·v + |αv|), the divisor being that of V for a light above; D V (n·l) over the density of l
    is the weight. Of the same float32 vectors, against `ggx` and `smith_correlated`."""
    v = rows(towards(50, 20), 4096)
    h, density = DRAW(sobol(jnp.arange(4096, dtype=jnp.uint32), jnp.uint32(5)), v, rows((alpha, alpha), 4096))
    n, a = rows((0.0, 0.0, 1.0), 4096), jnp.full(4096, alpha, jnp.float32)
    v_dot_h = np.sum(np.asarray(v, np.float64) * np.asarray(h, np.float64), axis=-1)
    d = np.asarray(ggx(n, h, a), np.float64)
    masking = 4.0 * np.asarray(smith_correlated(v[:, 2], jnp.ones(4096), a), np.float64)
    np.testing.assert_allclose(density, masking * v_dot_h * d, rtol=1e-5)

    l = jnp.asarray(mirrored(np.asarray(v, np.float64), np.asarray(h, np.float64)), jnp.float32)
    up = np.asarray(l[:, 2]) > 1e-3
    brdf = d * np.asarray(smith_correlated(v[:, 2], jnp.maximum(l[:, 2], 0.0), a), np.float64) * np.asarray(l[:, 2])
    weight = np.asarray(WEIGHT(v, l, rows((alpha, alpha), 4096)))
    np.testing.assert_allclose(weight[up], (brdf / (np.asarray(density) / (4 * v_dot_h)))[up], rtol=2e-5)
    assert (weight[np.asarray(l[:, 2]) <= 0] == 0).all() and weight.max() <= 1 + 1e-6 and up.mean() > 0.5


@pytest.mark.parametrize("alpha", ["rough", "brushed"])
def test_weights_add_up_to_the_reflected_light(alpha):
    """The mean weight is ∫ D V (n·l) dl, by quadrature over the hemisphere in double precision."""
    a, v = np.array(ALPHAS[alpha]), towards(55, 70)
    z, phi = np.meshgrid((np.arange(600) + 0.5) / 600, (np.arange(900) + 0.5) / 900 * 2 * np.pi, indexing="ij")
    l = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], axis=-1)
    h = (l + v) / np.linalg.norm(l + v, axis=-1, keepdims=True)
    d = 1 / (np.pi * np.prod(a) * np.sum((h / np.array([*a, 1.0])) ** 2, axis=-1) ** 2)
    stretch = np.array([*a, 1.0])
    long_v, long_l = np.linalg.norm(stretch * v), np.linalg.norm(stretch * l, axis=-1)
    expected = (d * 0.5 / (z * long_v + v[2] * long_l) * z).sum() * 2 * np.pi / z.size

    h, _ = DRAW(sobol(jnp.arange(4096, dtype=jnp.uint32), jnp.uint32(1)), rows(v, 4096), rows(a, 4096))
    l = jnp.asarray(mirrored(v[None], np.asarray(h, np.float64)), jnp.float32)
    np.testing.assert_allclose(np.mean(WEIGHT(rows(v, 4096), l, rows(a, 4096))), expected, rtol=2e-3)


def test_a_mirror_reflects_all_in_one_direction():
    v = towards(40, 10)
    h, density = DRAW(jnp.asarray([[0.3, 0.7]]), rows(v, 1), jnp.zeros((1, 2)))
    l = rows(v * np.array([-1, -1, 1]), 1)
    assert (h.tolist(), float(density[0])) == ([[0, 0, 1]], 0)
    np.testing.assert_allclose(WEIGHT(rows(v, 1), l, jnp.zeros((1, 2))), 1, rtol=1e-6)


def test_finite_at_every_edge_in_value_and_gradient():
    """u = 0 and u → 1, α from 0 to 1 on either axis, the view from above to edge-on."""
    u = [0.0, STEP, 0.5, 1 - STEP]
    alphas = [0.0, 1e-20, 1e-13, 1e-6, 2e-6, 1e-4, 0.002, 1.0]
    views = [towards(theta, phi) for theta in (0, 1e-3, 60, 89.999) for phi in (0, 90, 213)] + [np.array([1.0, 0, 0])]
    table = [[(x, y), v, (a, b)] for x in u for y in u for v in views for a in alphas for b in (a, 0.3)]
    square, v, alpha = (jnp.asarray(np.array(column), jnp.float32) for column in zip(*table))

    def all_of(square, v, alpha):
        h, density = visible_normal(square, v, alpha)
        l = 2.0 * jnp.sum(v * h, axis=-1, keepdims=True) * h - v
        return h, density, reflection_weight(v, l, alpha)

    h, density, weight = (np.asarray(x) for x in jax.jit(all_of)(square, v, alpha))
    np.testing.assert_allclose(np.linalg.norm(h, axis=-1), 1, atol=1e-6)
    assert (h[:, 2] >= 0).all() and (density >= 0).all() and np.isfinite(density).all()
    assert (weight >= 0).all() and (weight <= 1 + 1e-5).all()
    slopes = jax.jit(jax.vmap(jax.jacrev(all_of, (0, 1, 2))))(square, v, alpha)
    for result, names in zip(slopes, ("h", "density", "weight")):
        for slope, argument in zip(result, ("u", "v", "alpha")):
            bad = ~np.isfinite(slope.reshape(len(table), -1)).all(axis=1)
            assert not bad.any(), (names, argument, [table[i] for i in np.flatnonzero(bad)[:3]])


def test_gradients_are_exact():
    with jax.enable_x64(True):
        at = [jnp.asarray(x) for x in ([[0.3, 0.6]], towards(50, 20)[None], [[0.2, 0.5]])]

        @jax.jit
        def all_of(*arguments):
            h, density = visible_normal(*arguments)
            v, alpha = arguments[1:]
            l = 2.0 * jnp.sum(v * h, axis=-1, keepdims=True) * h - v
            return jnp.concatenate([h[0], density, reflection_weight(v, l, alpha)])

        for i, point in enumerate(at):
            reverse, forward = (jax.jit(jacobian(all_of, i))(*at) for jacobian in (jax.jacrev, jax.jacfwd))
            np.testing.assert_allclose(reverse, forward, rtol=1e-10, atol=1e-12)
            for j in range(point.shape[1]):
                step = 1e-6 * jnp.eye(point.shape[1])[j][None]
                ends = [all_of(*at[:i], point + sign * step, *at[i + 1 :]) for sign in (1, -1)]
                np.testing.assert_allclose(reverse[:, 0, j], (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-8)
