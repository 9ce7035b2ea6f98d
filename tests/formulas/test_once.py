"""A formula evaluated apart is that formula: for any numbers, shapes and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.math.table import once


def formula(x, y):
    return jnp.sin(x) * y, (x > y).astype(jnp.int32)


def apart(x, y):
    return once(formula, x, y)


@pytest.mark.parametrize("first", [0.0, -1e38, -np.inf, np.inf, np.nan])
def test_it_is_evaluated_whatever_the_first_number_is(first):
    x, y = jnp.array([[first, 2.0], [3.0, 4.0]]), jnp.arange(4.0).reshape(2, 2)
    for got, expected in zip(jax.jit(apart)(x, y), formula(x, y)):
        np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_nothing_is_evaluated_for_nothing():
    assert [part.shape for part in apart(jnp.zeros((0, 3)), jnp.zeros((0, 3)))] == [(0, 3), (0, 3)]


def test_it_has_the_formulas_derivatives():
    x, y = jnp.array([0.3, 2.0]), jnp.array([1.5, -0.5])
    for mode in (jax.jacrev, jax.jacfwd):
        got = jax.jit(mode(lambda x, y: apart(x, y)[0], (0, 1)))(x, y)
        expected = mode(lambda x, y: formula(x, y)[0], (0, 1))(x, y)
        for one, other in zip(got, expected):
            np.testing.assert_allclose(one, other, rtol=1e-6)


def test_it_may_be_mapped():
    x = jnp.arange(6.0).reshape(3, 2)
    np.testing.assert_allclose(jax.vmap(apart)(x, x)[0], formula(x, x)[0], rtol=1e-6)


def test_it_is_kept_apart_from_its_readers():
    """The compiled program holds a branch, in which the formula stands once."""
    program = jax.jit(lambda x: once(jnp.sin, x)[:, None] * jnp.ones((1, 3))).lower(jnp.ones(8)).compile().as_text()
    assert "conditional" in program
