"""Fetching rows of a table: the memory access everything per pixel is built on."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int, Shaped


def fetch(table: Shaped[Array, "n *k"], index: Int[Array, "*b"]) -> Shaped[Array, "..."]:
    """`table[index]` for indices known to lie in [0, n), without the checks that unknown ones would need.

    One row of k numbers costs a fraction of k accesses of one. Gradient: adds into the fetched rows.
    """
    return table.at[index].get(mode="promise_in_bounds")


def apart(always: Bool[Array, ""], function: Callable, *arguments):
    """`function(*arguments)` computed once and written to memory, where XLA would repeat it for each of its readers.

    What enters or leaves a branch is not fused; `always` is a condition that holds whatever the data are, but that the
    compiler cannot see through. Not for what is differentiated.
    """
    shapes = jax.eval_shape(function, *arguments)
    return lax.cond(always, function, lambda *_: zeros_as(shapes, always), *arguments)


def zeros_as(shapes, data):
    """Zeros of these shapes and dtypes, derived from some array of data: under `shard_map` the other branch of a
    condition must vary over devices as the one that computes from them."""
    zero = data.reshape(-1)[0].astype(jnp.int32) * 0
    return jax.tree.map(lambda value: jnp.zeros(value.shape, value.dtype) + zero.astype(value.dtype), shapes)
