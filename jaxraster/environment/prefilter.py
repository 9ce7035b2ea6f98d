"""Surroundings as matter of every roughness mirrors them: a chain of octahedral images, blurred more and more.

Level 0 is the picture itself; level i of LEVELS - 1 = n is blurred by the lobe of roughness r = √α with
i/n = (1 + c) r^1.5 / (1 + c r^1.5), c = CROWDING, and the last one is irradiance over π. Between two levels radiance is
mixed linearly. Of surroundings whose power falls as l^-1.5 with the degree l of their harmonics, as natural ones' does,
that leaves out or adds 3.5 % at most, below a roughness of 0.1, and 1.2 % above 0.2 (measured by the tests).

Gradient: exact; linear in the texels. In α that of the mixture, whose slope steps at levels; 0 at α = 0.
Source: Karis 2013, "Real Shading in Unreal Engine 4"; levels and sides are ours.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..math import safe
from ..math.table import fetch, once
from . import octahedral
from .blur import blurred, resized

LEVELS = 9
CROWDING = 6.0  # how much closer levels are at low roughness: of whole numbers, that which leaves the least error
LEAST, MOST = 32, 256  # cells along a quadrant; as fine as a picture of 512 rows
FINENESS = 2.0  # cells along a quadrant, times α, are at least that: the lobe is as wide as three


def alphas() -> list[float]:
    """The lobe's α of every level."""
    x = np.arange(LEVELS) / (LEVELS - 1)
    return ((x / (1.0 + CROWDING - CROWDING * x)) ** (4.0 / 3.0)).tolist()


def cells(height: int) -> list[int]:
    """How many cells a quadrant of every level has on a side, for a picture with so many rows: powers of two."""
    most = min(max(2 ** int(np.ceil(np.log2(0.5 * height))), LEAST), MOST)
    wanted = [2 ** int(np.ceil(np.log2(FINENESS / alpha))) for alpha in alphas()[1:]]
    return [most, *(min(max(count, LEAST), most) for count in wanted)]


def level(alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Where in the chain a lobe of width α lies, from 0 to LEVELS - 1."""
    root = safe.sqrt(jnp.clip(alpha, 0.0, 1.0))
    power = root * safe.sqrt(root)
    return (LEVELS - 1) * (1.0 + CROWDING) * power / (1.0 + CROWDING * power)


def prefilter(texels: Float[Array, "h w 3"]) -> Float[Array, "s 12"]:
    """The tables of all levels, one after the other, for `mirrored`."""
    sizes = cells(texels.shape[0])
    # Pictures finer than the first level are averaged: sampled at its corners, they would lose lamps of a texel.
    rows = min(texels.shape[0], 2 * sizes[0])
    first = texels if rows == texels.shape[0] else resized(texels, rows, 2 * rows)
    tables = [octahedral.table(octahedral.sampled(first, sizes[0]))]
    for size in sorted({*sizes[1:]}, reverse=True):
        rows = min(4 * size, 2 * sizes[0])
        image = resized(texels, rows, 2 * rows)

        def one(alpha, size=size, image=image):
            return octahedral.table(octahedral.sampled(blurred(image, alpha), size))

        some = [alpha for alpha, count in zip(alphas(), sizes) if alpha > 0 and count == size]
        tables.append(lax.map(one, jnp.array(some, texels.dtype)).reshape(-1, 12))
    return jnp.concatenate(tables)


def mirrored(
    rows: Float[Array, "s 12"], height: int, direction: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b 3"]:
    """Radiance about each direction, blurred by a lobe of width α, from the chain of a picture with so many rows."""
    size = np.array(cells(height))
    start = np.cumsum(4 * size**2) - 4 * size**2
    pairs = jnp.asarray(np.stack([start[:-1], size[:-1], start[1:], size[1:]], axis=-1), jnp.int32)

    def find(at, quadrant, across, along):
        """Where between two levels a lobe lies, and its cell in either of them."""
        # Clip for NaN alone, which is no level.
        below = jnp.clip(at.astype(jnp.int32), 0, LEVELS - 2)
        pair = fetch(pairs, below)
        both = (octahedral.cell((quadrant, across, along), pair[..., i + 1], pair[..., i]) for i in (0, 2))
        return at - below.astype(at.dtype), *both

    # In two steps: rows and weights must agree on level and cell, so that both start from the same rounded numbers.
    at, place = once(lambda alpha, direction: (level(alpha), octahedral.place(direction)), alpha, direction)
    blend, *both = once(find, at, *place)
    fine, coarse = (octahedral.mixed(rows, one) for one in both)
    return fine + blend[..., None] * (coarse - fine)
