"""Fetching rows of a table: the memory access everything per pixel is built on."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped

Data = Float[Array, "*b"] | Bool[Array, "*b"] | Int[Array, "*b"]


def fetch(table: Shaped[Array, "n *k"], index: Int[Array, "*b"]) -> Shaped[Array, "..."]:
    """`table[index]` for indices known to lie in [0, n), without the checks that unknown ones would need.

    One row of k numbers costs a fraction of k accesses of one. Gradient: adds into the fetched rows.
    """
    return table.at[index].get(mode="promise_in_bounds")


def fetch_run(table: Shaped[Array, " n"], first: Int[Array, "*b"], count: int) -> Shaped[Array, "*b k"]:
    """`count` neighbours from each of `first` on, all known to lie in the table: a row of it that starts anywhere.

    A third of the time that as many single accesses take. Gradient: adds into what is fetched.

    Example:
        >>> fetch_run(jnp.array([2.0, 3.0, 5.0, 7.0]), jnp.array([1, 0]), 2).tolist()
        [[3.0, 5.0], [2.0, 3.0]]
    """
    run = lax.GatherDimensionNumbers(offset_dims=(1,), collapsed_slice_dims=(), start_index_map=(0,))

    def runs(first, table):
        return lax.gather(table, first.reshape(-1, 1), run, (count,), mode="promise_in_bounds")

    # Once, or each of the neighbours would be fetched by itself, where it is read.
    return once(runs, first, table).reshape(*first.shape, count)


def apart(always: Bool[Array, ""], function: Callable, *arguments):
    """`function(*arguments)` computed once and written to memory, where XLA would repeat it for each of its readers.

    What enters or leaves a branch is not fused; `always` is a condition that holds whatever the data are, but that the
    compiler cannot see through. Gradient: exact, of the branch.
    """
    shapes = jax.eval_shape(function, *arguments)
    return lax.cond(always, function, lambda *_: zeros_as(shapes, always), *arguments)


def once(function: Callable, data: Data, *arguments) -> Any:
    """`function(data, *arguments)`, evaluated apart from its readers, by `apart`.

    XLA on a processor fuses formulas into what reads them, and there repeats them for each number that is read: the
    place of a texel for each of the twelve numbers fetched from it, a share for each of three channels. `data` are
    numbers of any value, truth values, or whole numbers that are not negative. Unlike `kept`, which takes values, it
    leaves the function free of what surrounds it: in shading by an environment map that saves another third of the
    time. Mapped by `vmap` it keeps nothing apart. Gradient: that of the function.

    Example:
        >>> once(jnp.add, jnp.array([1.0, jnp.nan]), jnp.array([2.0, 2.0])).tolist()
        [3.0, nan]
    """
    if data.size == 0:
        return function(data, *arguments)
    first = data.reshape(-1)[0]
    # Nothing is below minus infinity, a NaN included, which the compiler does not conclude.
    number = jnp.issubdtype(data.dtype, jnp.floating)
    always = ~(first < -jnp.inf) if number else first.astype(jnp.int32) >= 0
    return apart(always, function, data, *arguments)


@jax.custom_jvp
def kept(values, data: Data):
    """`values`, an array or several, written to memory where XLA would compute them again for each of their readers.

    For what many read: numbers per pixel by which three channels are weighed. `data` are as in `once`. Mapped by `vmap`
    it does nothing. Gradient: exact.
    """
    return once(lambda _, values: values, data, values)


@kept.defjvp
def _kept_tangents(primals, tangents):
    return kept(*primals), tangents[0]


def zeros_as(shapes, data):
    """Zeros of these shapes and dtypes, derived from some array of data: under `shard_map` the other branch of a
    condition must vary over devices as the one that computes from them."""
    zero = data.reshape(-1)[0].astype(jnp.int32) * 0
    return jax.tree.map(lambda value: jnp.zeros(value.shape, value.dtype) + zero.astype(value.dtype), shapes)
