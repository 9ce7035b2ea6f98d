"""Work for some of many elements: those are brought together, and runs without any of them are skipped.

Gradient: that of the function, where it was computed.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from .scan import partition, running_sum
from .table import fetch, zeros_as

CHUNK = 2**14  # elements worked on together: enough for the threads of a processor, few enough to skip most of the rest


def where_present(function: Callable[[Any], Any], present: Bool[Array, "*b"], values: Any) -> Any:
    """`function(values)`, of arrays with leading shape `*b`, where `present`; elsewhere its result for some element.

    The function must treat each element by itself, with any leading shape. It is always asked for one run, so that what
    stands in elsewhere is a result too, also where nothing is present. Mapped by `vmap` no run is skipped.

    Example:
        >>> x = jnp.array([1.0, -4.0, 9.0])
        >>> jnp.where(x > 0, where_present(jnp.sqrt, x > 0, x), 0.0).tolist()
        [1.0, 0.0, 3.0]
    """
    if present.size == 0:
        return function(values)
    shape, num = present.shape, present.size
    chunk = min(CHUNK, num)
    here = present.reshape(-1).astype(jnp.int32)
    order, starts = partition(here - 1)
    order = jnp.pad(order, (0, -num % chunk))
    flat = jax.tree.map(lambda value: value.reshape(num, *value.shape[len(shape) :]), values)

    def work(start):
        index = lax.dynamic_slice_in_dim(order, start, chunk)
        return function(jax.tree.map(lambda value: fetch(value, index), flat))

    made = jax.eval_shape(work, jax.ShapeDtypeStruct((), jnp.int32))

    firsts = [leaf.reshape(-1)[:1].astype(jnp.int32) for leaf in jax.tree.leaves((here, flat)) if leaf.size]

    def skip(start):
        return zeros_as(made, sum(firsts))

    def run(start):
        return lax.cond((start == 0) | (start < starts[1]), work, skip, start)

    results = lax.map(run, jnp.arange(0, order.shape[0], chunk, dtype=jnp.int32))
    place = jnp.maximum(running_sum(here) - 1, 0)
    return jax.tree.map(lambda r: fetch(r.reshape(-1, *r.shape[2:]), place).reshape(*shape, *r.shape[2:]), results)
