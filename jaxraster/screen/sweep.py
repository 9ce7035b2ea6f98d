"""Where the height field is looked at from every pixel: straight lines on the screen, in steps that grow.

Pixels of the same place in a 4 × 4 tile take the same steps. Their 16 pictures, each every fourth pixel of every fourth
row, then look at a neighbour by a shift of one of these pictures, which costs a tenth of an access at each pixel's own
place. All 16 together look in 16 times as many directions, which `denoise` brings together again.

Space: pixels, to the right and down. Gradient: none, places are whole numbers.
Source: interleaved sampling as in Bavoil & Jansen 2013, "Particle shadows and cache-efficient post-processing"; that
neighbours may then be shifted instead of fetched is ours.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

TILE = 4
PHASES = TILE * TILE
# The order in which directions go around a tile: neighbours differ much. Source: Bayer 1973.
ORDER = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])
# How far into its step each of them starts, so that near ones differ: the bits of its number in reverse.
START = (np.array([int(f"{k:04b}"[::-1], 2) for k in ORDER]) + 0.5) / PHASES


class Sweep(NamedTuple):
    """One row per phase of the tile, then one per direction; the second half of these are opposite to the first.

    `first` and `second` are the two pixels beside each step, as picture, line and column of the padded tiles, and
    `share` that of the second, and `offset` their place, right and down. `length` is |o| and `along` is ô of the height
    field.
    """

    first: Int[Array, "16 d k 3"]
    second: Int[Array, "16 d k 3"]
    share: Float[Array, "16 d k"]
    offset: Float[Array, "16 d k 2"]
    length: Float[Array, "16 d k"]
    along: Float[Array, "16 d 2"]


def margin(height: int, width: int) -> int:
    """Pixels around a picture in which lines may end: half of its longer side, in whole tiles, and one tile more."""
    return (max(height, width) // (2 * TILE) + 2) * TILE


def tiles(plane: Float[Array, "h w"], fill: float, around: int = 0) -> Float[Array, "16 H W"]:
    """The 16 pictures of a plane that has been filled up to whole tiles, and by so many pixels all around."""
    height, width = plane.shape
    more = [(around, around + -size % TILE) for size in (height, width)]
    plane = jnp.pad(plane, more, constant_values=fill)
    lines, columns = (size // TILE for size in plane.shape)
    split = plane.reshape(lines, TILE, columns, TILE)
    return split.transpose(1, 3, 0, 2).reshape(PHASES, lines, columns)


def untiled(pictures: Float[Array, "16 H W"], height: int, width: int) -> Float[Array, "h w"]:
    """The plane whose tiles they are, without what it was filled up with."""
    _, lines, columns = pictures.shape
    split = pictures.reshape(TILE, TILE, lines, columns).transpose(2, 0, 3, 1)
    return split.reshape(lines * TILE, columns * TILE)[:height, :width]


def sweep(slices: int, steps: int, reach: Float[Array, ""], around: int, across, down) -> Sweep:
    """Lines of so many steps in twice as many directions as slices, from 1 to `reach` pixels long, or as far as the
    margin `around` the picture allows.

    Steps grow by equal ratios. Each is a whole number of pixels along the longer axis; along the other it falls
    between two, so that lines are exactly straight.
    """
    turn = np.pi * (np.arange(slices) + (ORDER[:, None] + 0.5) / PHASES) / slices
    turn = np.concatenate([turn, turn + np.pi], axis=1)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    longer = np.abs(direction).max(axis=-1)
    along_x = (np.abs(direction[..., 0]) >= np.abs(direction[..., 1]))[..., None]

    # Make steps of at least one pixel, no two of them the same unless the line is too short.
    dtype, farthest = across.dtype, float(around - TILE)
    exponent = jnp.asarray((np.arange(steps) + START[:, None]) / steps, dtype)
    reach = jnp.clip(reach, 1.0, farthest)
    count = jnp.round(reach ** exponent[:, None, :] * jnp.asarray(longer[..., None], dtype))
    order = jnp.broadcast_to(jnp.arange(steps, dtype=dtype), count.shape)
    count = jnp.clip(lax.cummax(jnp.maximum(count, 1.0) - order, axis=2) + order, 1.0, farthest)

    x, y = (count * jnp.asarray(part / longer, dtype)[..., None] for part in np.moveaxis(direction, -1, 0))
    left = jnp.where(along_x, jnp.round(x), jnp.floor(x))
    top = jnp.where(along_x, jnp.floor(y), jnp.round(y))
    phase = np.arange(PHASES, dtype=np.int32)[:, None, None]

    def place(left, top):
        line, column = (phase // TILE + top.astype(jnp.int32) + around, phase % TILE + left.astype(jnp.int32) + around)
        picture = line % TILE * TILE + column % TILE
        return jnp.stack([picture, line // TILE, column // TILE], axis=-1)

    beside = jnp.asarray(along_x, dtype)
    right, below = (jnp.asarray(part, dtype)[..., None] for part in np.moveaxis(direction, -1, 0))
    along = jnp.concatenate([right * across[k] + below * down[k] for k in (0, 1)], axis=-1)
    pixel = jnp.sqrt(along[..., 0] ** 2 + along[..., 1] ** 2)
    return Sweep(
        first=place(left, top),
        second=place(left + 1.0 - beside, top + beside),
        share=jnp.where(along_x, y - top, x - left),
        offset=jnp.stack([x, y], axis=-1),
        length=count / jnp.asarray(longer, dtype)[..., None] * pixel[..., None],
        along=along / pixel[..., None],
    )
