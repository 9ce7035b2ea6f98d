"""Fetching from tables, and keeping what many read: the same numbers and gradients, whatever the program around."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.math.table import fetch_run, kept

TABLE = np.arange(10.0, dtype=np.float32) ** 2


@pytest.mark.parametrize("shape", [(), (1,), (0,), (2, 3)])
@pytest.mark.parametrize("count", [1, 4, 10])
def test_a_run_is_so_many_neighbours(shape, count):
    first = np.random.default_rng(0).integers(0, 11 - count, shape, dtype=np.int32)
    runs = jax.jit(lambda table, first: fetch_run(table, first, count))(TABLE, first)
    assert runs.tolist() == TABLE[first[..., None] + np.arange(count)].tolist()


def test_a_run_gives_its_gradient_to_what_was_fetched():
    gradient = jax.grad(lambda table: jnp.sum(fetch_run(table, jnp.array([2, 3]), 3) * jnp.array([[1.0, 2.0, 4.0]])))
    assert gradient(jnp.asarray(TABLE)).tolist() == [0, 0, 1, 3, 6, 4, 0, 0, 0, 0]


@pytest.mark.parametrize("data", [jnp.zeros((2, 2), bool), jnp.ones(1, bool), jnp.array(0), jnp.array([7, 0])])
def test_what_is_kept_is_what_was_given(data):
    values = (jnp.array([1.0, jnp.nan, -jnp.inf]), jnp.array(3))
    for keep in (kept, jax.jit(kept)):
        for one, same in zip(keep(values, data), values):
            np.testing.assert_array_equal(one, same)


def test_nothing_is_kept_of_nothing():
    assert kept(jnp.zeros((0, 3)), jnp.zeros(0, bool)).shape == (0, 3)


def test_keeping_passes_gradients_both_ways_and_batches_through():
    def f(x, mask):
        return jnp.sin(kept(x * x, mask)) * x

    x, mask = jnp.linspace(-2.0, 2.0, 5), jnp.zeros((5, 1), bool)
    exact = np.sin(x**2) + 2 * x**2 * np.cos(x**2)
    np.testing.assert_allclose(jax.vmap(jax.grad(f))(x, mask), exact, rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(jax.jacfwd(f))(x, mask), exact, rtol=1e-6)


def test_what_is_kept_is_computed_once_however_many_read_it():
    def readers(keep):
        def f(x):
            scalar = jnp.tanh(x)
            scalar = kept(scalar, x > 0) if keep else scalar
            return scalar[..., None] * jnp.arange(1.0, 4.0)[None, None], scalar + 1.0

        compiled = jax.jit(f).lower(jnp.ones((64, 64))).compile()
        return compiled.as_text().count("conditional(")

    assert (readers(True), readers(False)) == (1, 0)
