"""Running sums and a stable counting sort, in linear time at about a nanosecond an element on a processor.

The array is cut into short runs, which are laid side by side and summed together, one element of each at a time: a
general scan moves the whole array once for each power of two. Gradient: none, these are for whole numbers.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from .table import fetch

RUN = 32  # elements of a run: as many steps side by side as leave few sums of runs, which are added one by one
COUNTED = 16  # of a run that BITS can count
BITS = 5
KINDS = 6  # counters of that many bits share an integer


def _within_runs(values: Int[Array, " n"], run: int) -> tuple[Int[Array, "k r"], Int[Array, " r"]]:
    """Of each element, laid down the columns, the sum of those before it in its run, and each run's sum."""
    num = values.shape[0]
    runs = max(1, -(-num // run))
    columns = jnp.pad(values, (0, runs * run - num)).reshape(runs, run).T

    def add(row, state):
        before, total = state
        return lax.dynamic_update_index_in_dim(before, total, row, 0), total + columns[row]

    return lax.fori_loop(0, run, add, (columns * 0, columns[0] * 0))


def running_sum(values: Int[Array, " n"]) -> Int[Array, " n"]:
    """The sum of each element and all before it.

    Example:
        >>> running_sum(jnp.array([3, 0, 2])).tolist()
        [3, 3, 5]
    """
    before, total = _within_runs(values, RUN)

    def add(run, state):
        start, sum = state
        return lax.dynamic_update_index_in_dim(start, sum, run, 0), sum + total[run]

    start, _ = lax.fori_loop(0, total.shape[0], add, (total * 0, total[0] * 0))
    return (before + start[None, :]).T.reshape(-1)[: values.shape[0]] + values


def partition(kind: Int[Array, " n"]) -> tuple[Int[Array, " n"], Int[Array, " k"]]:
    """`(order, starts)`: indices ordered by kind, those of a kind ascending, and where each kind starts in them.

    Kinds are 0 to KINDS - 1; others are left out. `starts` has one entry more, the end of the last one; what follows in
    `order` is 0.

    Example:
        >>> order, starts = partition(jnp.array([1, -1, 0, 5, 0]))
        >>> order.tolist(), starts.tolist()
        ([2, 4, 0, 3, 0], [0, 2, 3, 3, 3, 3, 4])
    """
    num = kind.shape[0]
    counted = (kind >= 0) & (kind < KINDS)
    shift = BITS * jnp.where(counted, kind, 0)
    before, total = _within_runs(jnp.where(counted, 1 << shift, 0), COUNTED)
    before = before.T.reshape(-1)[:num]
    shifts = BITS * jnp.arange(KINDS, dtype=jnp.int32)
    totals = ((total[None, :] >> shifts[:, None]) & (2**BITS - 1)).reshape(-1)
    ends = running_sum(totals)
    runs, index = total.shape[0], jnp.arange(num, dtype=jnp.int32)
    base = fetch(ends - totals, jnp.where(counted, kind, 0) * runs + index // COUNTED)
    place = jnp.where(counted, base + ((before >> shift) & (2**BITS - 1)), num)
    order = jnp.zeros(num + 1, jnp.int32).at[place].set(index, mode="promise_in_bounds")[:num]
    return order, jnp.concatenate([(ends - totals)[::runs], ends[-1:]])
