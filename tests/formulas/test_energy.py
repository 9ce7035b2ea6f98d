"""The energy of the GGX lobe: its quadrature and table against another quadrature and published values, what
compensation returns, and ugly points."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import albedo

from jaxraster.brdf import compensation as compensation_file
from jaxraster.brdf import energy, energy_table
from jaxraster.brdf.kulla_conty import kulla_conty

SMOOTHEST = 0.045
split_sum, mean_split_sum = jax.jit(energy.split_sum), jax.jit(energy.mean_split_sum)
compensation = jax.jit(compensation_file.compensation)
compensated_albedo = jax.jit(compensation_file.compensated_albedo)
mean_compensated_albedo = jax.jit(compensation_file.mean_compensated_albedo)
multiple = jax.jit(kulla_conty)
COUNT = 4096  # elements of every array given to these, so that each is compiled once


def single(x) -> jax.Array:
    return jnp.asarray(np.asarray(x, np.float32))


def padded(x) -> jax.Array:
    """Fewer than COUNT rows, and what is in the last of them once more."""
    x = np.asarray(x, np.float32)
    return jnp.asarray(np.concatenate([x, np.broadcast_to(x[-1], (COUNT - len(x), *x.shape[1:]))]))


@functools.cache
def places() -> tuple[np.ndarray, np.ndarray]:
    """n·v down to 0.001, half of them crowded there, and roughness from the floor to 1."""
    rng = np.random.default_rng(0)
    n_dot_v = np.concatenate([10 ** rng.uniform(-3, 0, COUNT // 2), rng.uniform(1e-3, 1, COUNT // 2)])
    return n_dot_v, rng.uniform(SMOOTHEST, 1, COUNT)


@functools.cache
def exact() -> tuple[np.ndarray, np.ndarray]:
    """(A, B) at these places."""
    n_dot_v, roughness = (x.reshape(8, -1) for x in places())
    return tuple(np.concatenate(parts) for parts in zip(*map(energy_table.integrate, n_dot_v, roughness**2)))


# -- Quadrature and table ----------------------------------------------------------------------------------------------


def test_the_quadrature_agrees_with_another():
    """Half vectors below an exact limit against visible normals; the second is the coarser of the two."""
    n_dot_v, roughness = (x[:: COUNT // 64] for x in places())
    other = np.array([albedo.split_sum(c, r * r) for c, r in zip(n_dot_v, roughness)]).T
    np.testing.assert_allclose(energy_table.integrate(n_dot_v, roughness**2), other, atol=6e-5)


def test_head_on_the_quadrature_is_an_integral_over_one_angle():
    """E(1, α) = ∫ G₁(l) du over cos² θ = (1 - u) / (1 + (α² - 1) u), as long as l is above; 1 - ln 2 for α = 1."""
    alpha = np.array([0.1, 0.3, 0.5, 0.7, 1.0])[:, None] ** 2
    x, weight = np.polynomial.legendre.leggauss(200)
    end = 1 / (1 + alpha**2)
    u, weight = end * (0.5 + 0.5 * x), end * 0.5 * weight
    cosine = 2 * (1 - u) / (1 + (alpha**2 - 1) * u) - 1
    masking = 2 * cosine / (cosine + np.sqrt(alpha**2 + (1 - alpha**2) * cosine**2))
    whole = sum(energy_table.integrate(np.ones(5), alpha[:, 0]))
    np.testing.assert_allclose(whole, (weight * masking).sum(axis=1), atol=5e-6)
    np.testing.assert_allclose(whole[-1], 1 - np.log(2), atol=1e-12)


def test_at_grazing_angles_and_when_polished_all_is_mirrored():
    edge = np.array([0.0, 1e-9, 0.5, 1.0])
    for one in (energy_table.integrate(0 * edge, edge), energy_table.integrate(edge, 0 * edge)):
        np.testing.assert_allclose(sum(one), 1, atol=1e-4)
    np.testing.assert_allclose(energy_table.integrate(edge, 0 * edge)[1], (1 - edge) ** 5, atol=1e-4)


# (roughness, n·v): E = A + B, the albedo for f0 = 1, and B, that for f0 = 0, by a third quadrature of the same lobe.
PUBLISHED = {
    (0.1, 0.05): (0.97621, 0.73366), (0.1, 0.1): (0.99412, 0.57835), (0.1, 1.0): (0.99990, 0.00000),
    (0.2, 0.05): (0.89097, 0.53326), (0.2, 0.25): (0.98359, 0.22186), (0.3, 0.05): (0.90744, 0.36836),
    (0.3, 0.1): (0.88432, 0.32136), (0.3, 0.5): (0.97509, 0.03241), (0.4, 0.1): (0.88832, 0.21268),
    (0.5, 0.05): (0.93313, 0.16431), (0.5, 0.25): (0.84008, 0.08083), (0.5, 0.75): (0.89153, 0.00272),
    (0.6, 0.25): (0.80837, 0.05238), (0.8, 0.1): (0.83306, 0.04420), (0.8, 0.5): (0.62122, 0.00687),
    (0.8, 1.0): (0.55517, 0.00005), (1.0, 0.05): (0.84777, 0.03209), (1.0, 0.25): (0.59764, 0.01088),
    (1.0, 0.5): (0.45069, 0.00299), (1.0, 1.0): (1 - np.log(2), 0.00003),
}  # fmt: skip


def test_the_table_has_the_published_values():
    roughness, n_dot_v = np.array(list(PUBLISHED)).T
    a, b = split_sum(padded(n_dot_v), padded(roughness**2))
    whole, grazing = np.array(list(PUBLISHED.values())).T
    np.testing.assert_allclose((a + b)[: len(PUBLISHED)], whole, atol=0.001)
    np.testing.assert_allclose(b[: len(PUBLISHED)], grazing, atol=0.001)
    np.testing.assert_allclose(split_sum(padded([1.0]), padded([1.0]))[0][0], 1 - np.log(2) - 0.00003, atol=1e-5)
    # What three.js prints of its white furnace, to two digits.
    printed = {(0.5, 0.5): 0.86, (1.0, 0.5): 0.45, (1.0, 1.0): 0.31}
    roughness, n_dot_v = np.array(list(printed)).T
    shown = sum(split_sum(padded(n_dot_v), padded(roughness**2)))[:3]
    np.testing.assert_allclose(shown, list(printed.values()), atol=0.006)


def test_the_table_is_as_far_off_as_it_says():
    n_dot_v, roughness = places()
    a, b = split_sum(single(n_dot_v), single(roughness**2))
    error = {"A": a - exact()[0], "B": b - exact()[1], "A + B": a + b - sum(exact())}
    worst = max(np.abs(e).max() for e in error.values())
    away = max(np.abs(e[n_dot_v > 0.08]).max() for e in error.values())
    print({name: np.abs(e).max() for name, e in error.items()}, away)
    assert 0.0015 < worst < 0.0022 and 0.0006 < away < 0.0008


def test_the_means_are_those_of_the_hemisphere():
    """2 ∫ … μ dμ of the quadrature, and of E as published."""
    roughness = np.linspace(SMOOTHEST, 1, 64)
    x, weight = np.polynomial.legendre.leggauss(32)
    cosine, weight = (0.5 + 0.5 * x) ** 2, weight * (0.5 + 0.5 * x)
    a, b = energy_table.integrate(*np.broadcast_arrays(cosine[:, None], roughness**2))
    lost = 1 / (a + b) - 1
    means = mean_split_sum(padded(roughness**2))
    for mean, column in zip(means, (a, b, a * lost, b * lost)):
        np.testing.assert_allclose(mean[:64], 2 * (cosine * weight) @ column, atol=1e-4)
    published = [0.99949, 0.99407, 0.97651, 0.94042, 0.88232, 0.80293, 0.70743, 0.60421, 0.50236, 0.40914]
    a, b, *_ = mean_split_sum(padded(np.linspace(0.1, 1, 10) ** 2))
    np.testing.assert_allclose((a + b)[:10], published, atol=1e-4)


def test_the_tables_are_made_once():
    assert energy_table.tables() is energy_table.tables()
    assert energy_table.tables().cells.shape == ((energy_table.SIDE - 1) ** 2, 8)


def test_mapped_and_not_it_is_the_same():
    n_dot_v, roughness = (single(x) for x in places())
    mapped = jax.jit(jax.vmap(energy.split_sum))(n_dot_v, roughness**2)
    for one, other in zip(split_sum(n_dot_v, roughness**2), mapped):
        np.testing.assert_allclose(one, other, atol=2e-7)


# -- Compensation ------------------------------------------------------------------------------------------------------


def test_a_perfect_mirror_returns_everything():
    """With f0 = 1 at every angle and roughness, and 0.2 % off at most once the table's error is counted."""
    n_dot_v, roughness = places()
    one = jnp.ones((COUNT, 3))
    gain = compensation(one, single(n_dot_v), single(roughness**2))
    np.testing.assert_allclose(gain[:, 0] * sum(exact()), 1, atol=0.0025)
    np.testing.assert_allclose(compensated_albedo(one, single(n_dot_v), single(roughness**2)), 1, atol=5e-7)
    np.testing.assert_allclose(mean_compensated_albedo(one, single(roughness**2)), 1, atol=2e-6)
    assert gain.min() > 0.999 and 3.1 < gain.max() < 1 / (1 - np.log(2))


def test_no_surface_returns_more_than_everything():
    n_dot_v, roughness = (single(x) for x in places())
    rng = np.random.default_rng(1)
    f0, f90 = single(rng.uniform(0, 1, (COUNT, 3))), single(rng.uniform(0, 1, COUNT))
    for edge in (f90, jnp.ones(COUNT)):
        albedo = compensated_albedo(f0, n_dot_v, roughness**2, edge)
        assert albedo.min() >= 0 and albedo.max() < 1
        once = jax.jit(energy.directional_albedo)(f0, n_dot_v, roughness**2, edge)
        assert (albedo >= once * (1 - 1e-6)).all()


def test_colours_grow_more_saturated_with_roughness():
    gold = np.tile([1.0, 0.77, 0.34], (10, 1))
    albedo = compensated_albedo(padded(gold), padded(np.full(10, 0.7)), padded(np.linspace(0.1, 1, 10) ** 2))[:10]
    assert (np.diff(albedo[:, 2] / albedo[:, 0]) < 0).all() and albedo[-1, 2] < 0.6 * albedo[0, 2]


def test_the_mean_is_that_of_the_albedo():
    """2 ∫ albedo(μ) μ dμ, by Gauss's points over the table."""
    x, weight = np.polynomial.legendre.leggauss(64)
    cosine, weight = (0.5 + 0.5 * x) ** 2, weight * (0.5 + 0.5 * x)
    rng = np.random.default_rng(2)
    roughness, f0, f90 = rng.uniform(SMOOTHEST, 1, 64), rng.uniform(0, 1, (64, 3)), rng.uniform(0, 1, 64)
    grid = np.broadcast_to(cosine[:, None], (64, 64)).ravel()
    rows = [np.broadcast_to(x, (64, *x.shape)).reshape(COUNT, *x.shape[1:]) for x in (f0, roughness**2, f90)]
    albedo = compensated_albedo(single(rows[0]), single(grid), single(rows[1]), single(rows[2])).reshape(64, 64, 3)
    mean = mean_compensated_albedo(padded(f0), padded(roughness**2), padded(f90))[:64]
    np.testing.assert_allclose(mean, np.einsum("c,crk->rk", 2 * cosine * weight, albedo), atol=3e-4)


def test_kulla_conty_is_reciprocal():
    rng = np.random.default_rng(3)
    a, b, alpha = rng.uniform(0, 1, (3, COUNT))
    color = single(rng.uniform(0, 1, (COUNT, 3)))
    there = multiple(single(a), single(b), single(alpha), color)
    np.testing.assert_array_equal(there, multiple(single(b), single(a), single(alpha), color))


def returned(n_dot_v: np.ndarray, roughness: np.ndarray, mean_fresnel: float) -> np.ndarray:
    """∫ f (n·l) dl of Kulla and Conty's lobe for 64 surfaces, by Gauss's points."""
    x, weight = np.polynomial.legendre.leggauss(64)
    cosine, weight = (0.5 + 0.5 * x) ** 2, weight * (0.5 + 0.5 * x)
    n_dot_l, n_dot_v, alpha = (x.ravel() for x in np.broadcast_arrays(cosine[:, None], n_dot_v, roughness**2))
    f = multiple(single(n_dot_v), single(n_dot_l), single(alpha), jnp.full((COUNT, 3), mean_fresnel))
    return 2 * np.pi * (cosine * weight) @ np.asarray(f, np.float64)[:, 0].reshape(64, 64)


def test_kulla_conty_returns_what_one_bounce_loses():
    n_dot_v, roughness = (x[:: COUNT // 64] for x in places())
    # Where next to nothing is lost its mean is a difference of ones.
    rough = np.maximum(roughness, 0.2)
    lost = 1 - sum(energy_table.integrate(n_dot_v, rough**2))
    np.testing.assert_allclose(returned(n_dot_v, rough, 1.0), lost, atol=0.003)


def test_the_two_compensations_differ_by_as_much_as_they_say():
    """Roughness 0.8, n·v 0.3, f0 0.5: published are 0.4196 for the reciprocal lobe, 0.4342 for the factor."""
    n_dot_v, roughness = np.full(64, 0.3), np.full(64, 0.8)
    again = returned(n_dot_v, roughness, (1 + 20 * 0.5) / 21)[0]
    a, b = (float(x[0]) for x in energy_table.integrate(n_dot_v[:1], roughness[:1] ** 2))
    np.testing.assert_allclose([again, 0.5 * a + b], [0.06438, 0.3552], atol=3e-4)
    factor = compensated_albedo(jnp.full((COUNT, 3), 0.5), padded([0.3]), padded([0.64]))[0, 0]
    np.testing.assert_allclose(factor, 0.43422, atol=5e-4)
    assert 0.03 < factor / (0.5 * a + b + again) - 1 < 0.04


# -- Precision and ugly points -----------------------------------------------------------------------------------------


def everything(n_dot_v, n_dot_l, alpha, f0, f90):
    """All that this file is about, `[*b, n]`."""
    parts = [*energy.split_sum(n_dot_v, alpha), *energy.mean_split_sum(alpha)]
    colors = [
        compensation_file.compensation(f0, n_dot_v, alpha),
        compensation_file.compensated_albedo(f0, n_dot_v, alpha, f90),
        compensation_file.mean_compensated_albedo(f0, alpha, f90),
        kulla_conty(n_dot_v, n_dot_l, alpha, f0),
    ]
    return jnp.concatenate([jnp.stack(parts, axis=-1), *colors], axis=-1)


def test_single_precision_is_enough():
    """Within 1e-5 of double precision on the same numbers, down to the floor of roughness."""
    rng = np.random.default_rng(4)
    n_dot_v, roughness = places()
    inputs = [n_dot_v, rng.permutation(n_dot_v), roughness**2, rng.uniform(0, 1, (COUNT, 3)), rng.uniform(0, 1, COUNT)]
    inputs = [x.astype(np.float32) for x in inputs]
    result = jax.jit(everything)(*inputs)
    with jax.enable_x64(True):
        double = jax.jit(everything)(*(x.astype(np.float64) for x in inputs))
    assert double.dtype == np.float64 and result.dtype == np.float32
    # Kulla and Conty's lobe divides by what is lost, which is a difference of ones for polished surfaces.
    np.testing.assert_allclose(result[:, :-3], double[:, :-3], atol=1e-5)
    rough = roughness > 0.2
    np.testing.assert_allclose(result[rough, -3:], double[rough, -3:], atol=1e-5)


@jax.jit
def at_edges(*inputs) -> tuple:
    """Values, reverse-mode and forward-mode Jacobians."""
    modes = (jax.jacrev, jax.jacfwd)
    return everything(*inputs), *(jax.vmap(mode(everything, (0, 1, 2, 3, 4)))(*inputs) for mode in modes)


UGLY = np.array(np.meshgrid([0.0, 1e-38, 1e-12, 1e-4, 0.5, 1.0], [0.0, 1e-12, 1.0], [0.0, 0.045**2, 0.3, 1.0]))


@pytest.mark.parametrize("f0", [0.0, 0.04, 1.0])
def test_values_and_gradients_are_finite_at_the_edges(f0):
    n_dot_v, n_dot_l, alpha = (single(x.ravel()) for x in UGLY)
    inputs = (n_dot_v, n_dot_l, alpha, jnp.full((len(alpha), 3), f0), jnp.ones(len(alpha)))
    value, reverse, forward = at_edges(*inputs)
    for leaf in jax.tree.leaves((value, reverse, forward)):
        assert np.isfinite(leaf).all()
    # A mean that is 0 may be as far below as its polynomial is off.
    assert value.min() > -1e-4
    for name, r, f in zip(("n·v", "n·l", "alpha", "f0", "f90"), reverse, forward):
        largest = 1 + np.abs(f).max(axis=tuple(range(1, f.ndim)), keepdims=True)
        assert (np.abs(r - f) / largest).max() < 1e-4, name


def test_slopes_are_those_of_the_integrals():
    """Between nodes, where the table's slope is that of a cell: within a tenth of the steepest."""
    n_dot_v, roughness = (x[: COUNT // 16] for x in places())
    keep = n_dot_v > 0.05
    n_dot_v, alpha = n_dot_v[keep], roughness[keep] ** 2
    for argument in (0, 1):
        slope = jax.jit(jax.vmap(jax.grad(lambda c, a: sum(energy.split_sum(c, a)), argument)))
        slope = np.asarray(slope(single(n_dot_v), single(alpha)))
        step = 1e-3 * (n_dot_v, alpha)[argument]
        ends = [
            sum(energy_table.integrate(n_dot_v + s * step * (argument == 0), alpha + s * step * (argument == 1)))
            for s in (1, -1)
        ]
        scale = (n_dot_v, alpha)[argument]
        difference = scale * (slope - (ends[0] - ends[1]) / (2 * step))
        assert np.abs(difference).max() < 0.02, argument


def test_nan_stays_in_its_lane():
    n_dot_v = padded([0.5, np.nan, 0.5])
    for x in split_sum(n_dot_v, jnp.full(COUNT, 0.25)):
        assert np.isnan(x[:3]).tolist() == [False, True, False] and x[0] == x[2]


@pytest.mark.parametrize("shape", [(), (0,), (2, 1)])
def test_any_shape(shape):
    half = jnp.full(shape, 0.5)
    assert jax.jit(everything)(half, half, half, jnp.full((*shape, 3), 0.5), half).shape == (*shape, 18)
