"""Safe functions and table rows at 0, tiny, huge, infinite and missing numbers: values, both gradients, accuracy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.math import safe
from jaxraster.math.table import fetch

INF, NAN = np.inf, np.nan


def f(*values):
    return tuple(jnp.float32(v) for v in values)


def check(actual, expected, rtol=0.0):
    """Equal as float32 numbers, NaN to NaN and infinity to infinity."""
    np.testing.assert_allclose(np.asarray(actual), np.float32(expected), rtol=rtol, atol=0)


def both_gradients(function, count):
    """A compiled function to reverse- and forward-mode derivatives, one number per argument in each."""
    every = tuple(range(count))
    return jax.jit(lambda *arguments: [mode(function, every)(*arguments) for mode in (jax.jacrev, jax.jacfwd)])


def divide(a, b):
    return safe.divide(a, b, 7.0)


SQRT, DIVIDE = both_gradients(safe.sqrt, 1), both_gradients(divide, 2)
NORMALIZE, LENGTH = both_gradients(safe.normalize, 1), both_gradients(safe.length, 1)
UNIT = both_gradients(safe.unit, 1)


@pytest.mark.parametrize(
    ("x", "value", "slope"),
    [
        (0.0, 0.0, 0.0),
        (-0.0, 0.0, 0.0),
        (-1.0, 0.0, 0.0),
        (1e-31, 0.0, 0.0),
        (1e-20, 1e-10, 5e9),
        (4.0, 2.0, 0.25),
        (1e20, 1e10, 5e-11),
        (INF, INF, 0.0),
        (-INF, 0.0, 0.0),
        (NAN, 0.0, 0.0),
    ],
)
def test_sqrt(x, value, slope):
    check(safe.sqrt(*f(x)), value, rtol=2e-7)
    for mode in SQRT(*f(x)):
        check(mode[0], slope, rtol=3e-7)


@pytest.mark.parametrize(
    ("a", "b", "value", "slope_a", "slope_b"),
    [
        (0.0, 0.0, 7.0, 0.0, 0.0),
        (1.0, -0.0, 7.0, 0.0, 0.0),
        (INF, 1e-31, 7.0, 0.0, 0.0),
        (NAN, 0.0, 7.0, 0.0, 0.0),
        (1.0, NAN, 7.0, 0.0, 0.0),
        (3.0, -2.0, -1.5, -0.5, -0.75),
        # The plain rule's 1/b² is infinite in the next four, and 0 · inf is NaN.
        (0.0, 1e-20, 0.0, 1e20, 0.0),
        (1e-20, 1e-20, 1.0, 1e20, -1e20),
        (0.0, 2e-30, 0.0, 5e29, 0.0),
        (1e-30, -2e-30, -0.5, -5e29, -2.5e29),
        (1e20, 1e20, 1.0, 1e-20, -1e-20),
        (0.0, 1e20, 0.0, 1e-20, 0.0),
        (1.0, INF, 0.0, 0.0, 0.0),
        (1.0, -INF, 0.0, 0.0, 0.0),
    ],
)
def test_divide(a, b, value, slope_a, slope_b):
    check(divide(*f(a, b)), value, rtol=2e-7)
    for mode in DIVIDE(*f(a, b)):
        check(mode, [slope_a, slope_b], rtol=4e-7)


def test_divide_takes_arrays_batches_and_second_derivatives():
    a, b = jnp.array([1.0, 2.0, 3.0]), jnp.array([2.0, 0.0, -4.0])
    check(jax.jit(safe.divide)(a, b), [0.5, 0.0, -0.75])
    check(jax.vmap(safe.divide)(a, b), [0.5, 0.0, -0.75])
    # ∂²(a/b)/∂b² = 2a/b³ and ∂²(a/b)/∂a∂b = -1/b².
    second = jax.vmap(jax.grad(jax.grad(safe.divide, 1), (0, 1)))(a, b)
    check(second, [[-0.25, 0.0, -0.0625], [0.25, 0.0, -0.09375]], rtol=1e-6)


VECTORS = {
    "zero": ([0, 0, 0], [0, 0, 0], 0),
    "minus zero": ([-0.0, 0, -0.0], [0, 0, 0], 0),
    "too small": ([1e-31, -1e-31, 0], [0, 0, 0], 0),
    "denormal": ([1e-40, 1e-40, 1e-40], [0, 0, 0], 0),
    "1e-29": ([3e-29, 0, -4e-29], [0.6, 0, -0.8], 5e-29),
    "1e-20": ([0, 3e-20, 4e-20], [0, 0.6, 0.8], 5e-20),
    "1": ([2, 3, 6], [2 / 7, 3 / 7, 6 / 7], 7),
    "1e20": ([0, 3e20, -4e20], [0, 0.6, -0.8], 5e20),
    "1e38": ([0.6e38, 0, 0.8e38], [0.6, 0, 0.8], 1e38),
    "near the largest": ([0, 3e38, 0], [0, 1, 0], 3e38),
    "far apart": ([1e-30, 1, 1e-20], [1e-30, 1, 1e-20], 1),
    "infinite": ([INF, 0, 0], [0, 0, 0], NAN),
    "minus infinite": ([1, 2, -INF], [0, 0, 0], NAN),
    "not a number": ([1, NAN, 0], [0, 0, 0], NAN),
    "both": ([INF, NAN, 0], [0, 0, 0], NAN),
}


@pytest.mark.parametrize("name", VECTORS)
def test_normalize_and_length(name):
    v, unit, length = VECTORS[name]
    v, unit = jnp.array(v, jnp.float32), np.array(unit)
    check(safe.normalize(v), unit, rtol=3e-7)
    check(safe.length(v), length, rtol=4e-7)
    # ∂(v/|v|)/∂v = (1 - u uᵀ)/|v| and ∂|v|/∂v = u; both 0 where there is no direction. Denormals count as 0.
    project = (np.eye(3) - np.outer(unit, unit)) / length if unit.any() else np.zeros((3, 3))
    noise = 3e-7 * np.abs(project).max() + np.finfo(np.float32).tiny
    for (turned,), (stretched,) in zip(NORMALIZE(v), LENGTH(v)):
        np.testing.assert_allclose(turned, project, rtol=1e-6, atol=noise)
        if np.isfinite(length):
            np.testing.assert_allclose(stretched, unit, rtol=1e-6, atol=3e-7)


@pytest.mark.parametrize("name", VECTORS)
def test_unit_is_normalize_of_ordinary_lengths_and_zero_of_others(name):
    v, expected, length = VECTORS[name]
    ordinary = 1e-15 < length < 1e18
    v, expected = jnp.array(v, jnp.float32), np.array(expected if ordinary else [0.0, 0.0, 0.0])
    check(safe.unit(v), expected, rtol=3e-7)
    project = (np.eye(3) - np.outer(expected, expected)) / length if ordinary else np.zeros((3, 3))
    for (turned,) in UNIT(v):
        np.testing.assert_allclose(turned, project, rtol=1e-6, atol=3e-7 * np.abs(project).max())


@pytest.mark.parametrize("unit", [safe.unit, safe.normalize])
def test_a_lane_that_is_not_a_number_leaves_the_others_alone(unit):
    v = jnp.array([[NAN, 0.0, 0.0], [0.0, 0.0, 0.0], [INF, 1.0, 0.0], [3.0, 0.0, 4.0]])
    check(unit(v), np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0.6, 0, 0.8]]), rtol=3e-7)
    slope = jax.grad(lambda v: unit(v)[3, 0])(v)
    check(slope, np.array([[0, 0, 0]] * 3 + [[0.128, 0, -0.096]]), rtol=1e-6)


@pytest.mark.parametrize(("normalize", "least", "most"), [(safe.normalize, -28, 37), (safe.unit, -13, 17)])
def test_unit_vectors_are_right_to_two_ulp_at_any_length(normalize, least, most):
    rng = np.random.default_rng(0)
    v = (rng.normal(size=(100_000, 3)) * 10.0 ** rng.uniform(least, most, (100_000, 1))).astype(np.float32)
    exact = v.astype(np.float64)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    for made in (normalize, jax.jit(normalize)):
        unit = np.asarray(made(jnp.asarray(v)), np.float64)
        # 2^-22 is two ulp of a number just above a power of two.
        assert np.abs(unit / exact - 1).max() <= 2.0**-22
        assert np.abs(np.linalg.norm(unit, axis=1) - 1).max() <= 2.0**-22


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_dot_sums_all_components(n):
    a, b = np.arange(1.0, n + 1), 10.0 ** np.arange(n)
    check(safe.dot(jnp.array(a, jnp.float32), jnp.array(b, jnp.float32)), (a * b).sum())


def test_dot_keeps_float32_factors():
    """Rounded to the 10 bits of a matrix unit, 1 + 2^-12 would be 1 and the answer 0."""
    a = jnp.array([1.0 + 2.0**-12, 1.0, 0.0])
    check(safe.dot(a, jnp.array([1.0, -1.0, 5.0])), 2.0**-12)


def test_dot_has_no_answer_for_infinity_times_zero():
    check(safe.dot(jnp.array([INF, 1.0]), jnp.array([0.0, 1.0])), NAN)
    check(safe.dot(jnp.array([INF, 1.0]), jnp.array([2.0, 1.0])), INF)
    check(safe.dot(jnp.array([1e20, 1e20]), jnp.array([1e20, 0.0])), INF)


def test_fetch_returns_rows_and_leaves_the_others_alone():
    table = jnp.array([[0.0, -0.0], [1e-20, 1e20], [INF, -INF], [NAN, 1.0]])
    index = jnp.array([[0, 1, 2], [3, 1, 0]])
    np.testing.assert_array_equal(fetch(table, index), np.asarray(table)[np.asarray(index)])
    np.testing.assert_array_equal(fetch(jnp.array([7, 8, 9]), jnp.array([2, 2, 0])), [9, 9, 7])
    np.testing.assert_array_equal(fetch(jnp.zeros((4, 2, 3)), index).shape, (2, 3, 2, 3))
    assert fetch(table, jnp.zeros(0, jnp.int32)).shape == (0, 2)


def test_the_gradient_of_fetch_counts_how_often_a_row_is_read():
    table, index = jnp.array([[1.0], [2.0], [NAN], [INF]]), jnp.array([0, 1, 1, 1])
    reads = jax.jit(jax.grad(lambda t: fetch(t, index).sum()))(table)
    # Rows that were not read have a gradient of 0, whatever they hold.
    np.testing.assert_array_equal(reads[:, 0], [1, 3, 0, 0])
    value, tangent = jax.jvp(lambda t: fetch(t, index), (table,), (jnp.arange(4.0)[:, None],))
    np.testing.assert_array_equal(value[:, 0], [1, 2, 2, 2])
    np.testing.assert_array_equal(tangent[:, 0], [0, 1, 1, 1])
