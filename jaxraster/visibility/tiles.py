"""Where pixels live while large triangles are drawn: tile after tile, `[tiles + 1, 256]`.

The last tile is for what belongs to no pixel; one that reaches beyond the picture holds pixels that nobody reads.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

TILE = 16  # pixels on a side: sorting a (tile, triangle) pair costs about as much as drawing its 256 pixels
PIXELS = TILE * TILE
FARTHEST = 0x007FFFFF  # bits just below those of the least normal float: a depth of 0 does not beat it
NOBODY = 2**31 - 1  # the face id of background while drawing: any other is lower

Ints = Int[Array, "*n"]
Each = Int[Array, "..."]  # of shapes that broadcast


def grid(height: int, width: int) -> tuple[int, int]:
    """Tiles down and across."""
    return math.ceil(height / TILE), math.ceil(width / TILE)


def span(first: Ints, last: Ints) -> Ints:
    """How many tiles hold the pixels from the first to the last of a line or column."""
    return last // TILE - first // TILE + 1


def in_front(near: Each, id: Each, other_near: Each, other_id: Each) -> Bool[Array, "..."]:
    """Whether a fragment hides another: it is nearer, or as near and of the lower face."""
    return (near > other_near) | ((near == other_near) & (id < other_id))


def picture(tiles: Int[Array, "t 256"], height: int, width: int) -> Int[Array, "h w"]:
    """Rows of pixels from tiles."""
    down, across = grid(height, width)
    lines = tiles[:-1].reshape(down, across, TILE, TILE).transpose(0, 2, 1, 3)
    return lines.reshape(down * TILE, across * TILE)[:height, :width]


def tiled(picture: Int[Array, "h w"]) -> Int[Array, "t 256"]:
    """Tiles from rows of pixels; 0 where there are none."""
    height, width = picture.shape
    down, across = grid(height, width)
    lines = jnp.pad(picture, ((0, down * TILE - height), (0, across * TILE - width)))
    tiles = lines.reshape(down, TILE, across, TILE).transpose(0, 2, 1, 3).reshape(down * across, PIXELS)
    return jnp.pad(tiles, ((0, 1), (0, 0)))
