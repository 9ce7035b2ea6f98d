"""Pixels as samples in a light's view: sorted by the tile in which they lie, and cut into blocks of one tile each.

A tile has as many blocks as its samples fill, and only the last of them is not full, so that what a block asks costs
about the same anywhere, however unevenly pixels lie in the view.
Gradient: none.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..math.scan import running_sum
from ..math.table import fetch

# Samples that ask together: in larger blocks more places stay empty, in smaller ones rows are fetched oftener.
BLOCK = 128


class Samples(NamedTuple):
    """Blocks of samples, their places in tiles from the middle of their own, and depths, inf where there is none.

    `tile` is that of a block, `lowest` the least depth in a tile, and `slot` the place of each pixel among the samples.
    """

    x: Float[Array, "k n"]
    y: Float[Array, "k n"]
    depth: Float[Array, "k n"]
    tile: Int[Array, " k"]
    lowest: Float[Array, " t"]
    slot: Int[Array, " p"]


def binned(
    x: Float[Array, " p"], y: Float[Array, " p"], depth: Float[Array, " p"], used: Bool[Array, " p"], side: int
) -> Samples:
    """Samples of places in a view of `side` tiles on a side; those not `used` have the slot after the last."""
    num, tiles = x.shape[0], side * side
    column, line = (jnp.clip(jnp.floor(place), 0, side - 1).astype(jnp.int32) for place in (x, y))
    tile = jnp.where(used, line * side + column, tiles)
    bits = max(1, (num - 1).bit_length())
    assert (tiles << bits) < 2**31, "keys need 31 bits"
    keys = lax.sort((tile << bits) | jnp.arange(num, dtype=jnp.int32))
    order, tile_of = keys & (2**bits - 1), keys >> bits

    # Begin a block with every tile.
    count = jnp.zeros(tiles + 1, jnp.int32).at[tile].add(1, mode="promise_in_bounds").at[tiles].set(0)
    blocks, most = -(-count // BLOCK), num // BLOCK + min(num, tiles)
    ends = running_sum(blocks)
    place = fetch(BLOCK * (ends - blocks) - (running_sum(count) - count), tile_of) + jnp.arange(num, dtype=jnp.int32)
    place = jnp.where(tile_of < tiles, place, most * BLOCK)

    middle_x, middle_y = (whole.astype(x.dtype) + 0.5 for whole in (column, line))
    rows = fetch(jnp.stack([x - middle_x, y - middle_y, depth], axis=-1), order)
    empty = jnp.broadcast_to(jnp.array([0.0, 0.0, jnp.inf], x.dtype), (most * BLOCK + 1, 3))
    placed = empty.at[place].set(rows, mode="promise_in_bounds")[:-1].reshape(most, BLOCK, 3)
    owner = jnp.searchsorted(ends, jnp.arange(most, dtype=jnp.int32), side="right").astype(jnp.int32)
    return Samples(
        *(placed[..., k] for k in range(3)),
        tile=jnp.minimum(owner, tiles),
        lowest=jnp.full(tiles + 1, jnp.inf, x.dtype).at[tile].min(depth, mode="promise_in_bounds"),
        slot=jnp.zeros(num, jnp.int32).at[order].set(place, mode="promise_in_bounds", unique_indices=True),
    )
