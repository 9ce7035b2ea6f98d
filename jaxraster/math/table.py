"""Fetching rows of a table: the memory access everything per pixel is built on."""

from jax import lax
from jaxtyping import Array, Int, Num


def fetch(table: Num[Array, "n *k"], index: Int[Array, "*b"]) -> Num[Array, "..."]:
    """`table[index]` for indices known to lie in [0, n).

    The barrier keeps XLA from fusing the access into its readers, which would repeat it for each of them; one row of
    k numbers costs a fraction of k accesses of one. Gradient: adds into the fetched rows.
    """
    return lax.optimization_barrier(table.at[index].get(mode="promise_in_bounds"))
