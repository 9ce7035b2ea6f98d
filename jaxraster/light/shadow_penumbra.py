"""Penumbras as wide as the light is large: look for what stands in the way, then filter as far as it makes it blurred.

A blocker at depth d_b lets a receiver at d_r see the light through a disc of the map of radius

    s (d_b - d_r),   s = tan α · range / texel in parallel light, and R / (near · texel) for a lamp of radius R,

which is exact: depths of a lamp's map are linear in 1 / w. `taps` over the widest disc that any caster could make find
the blockers' mean depth, and as many over the disc that this gives find the share. One edge's penumbra is that of the
light's disc, ½ + (t √(1 - t²) + asin t) / π across it; of several casters at different heights it is a guess.

Gradient: none, on purpose.
Source: Fernando 2005, "Percentage-Closer Soft Shadows"; there the light is at the map's plane and depths are linear.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from .shadow_filter import disc, over_disc
from .shadow_frame import LightView, Receiver

LEAST = 1.0  # texels of a radius: a smaller disc would show the texels' own edges
MOST = 0.25  # of the map: so far blockers are looked for
Depth = Callable[[Array, Array], Float[Array, "*b"]]


def penumbra(
    place: Receiver, view: LightView, nearest: Array, depth: Depth, threshold: Depth, size: Any, taps: int
) -> Float[Array, "*b"]:
    """The share of a light of that size, in units of map over depth, that each place sees.

    `depth` and `threshold` are those of the texel at (column, line), `nearest` the depth of all that is nearest.
    """
    scale_x, scale_y = size / view.texel[0], size / view.texel[1]

    def radii(gap):
        """Of the disc through which a light is seen past what is nearer by so much."""
        return (jnp.clip(gap * scale, LEAST, MOST * view.size) for scale in (scale_x, scale_y))

    radius_x, radius_y = radii(nearest - place.depth)

    def search(found, tap):
        count, gaps = found
        column, line = jnp.floor(place.x + radius_x * tap[0]), jnp.floor(place.y + radius_y * tap[1])
        blocker = depth(column, line)
        blocks = blocker > threshold(column, line)
        return count + blocks.astype(gaps.dtype), gaps + jnp.where(blocks, blocker - place.depth, 0.0)

    nothing = jnp.zeros_like(place.x)
    count, gaps = over_disc(search, (nothing, nothing), place.x, taps)
    wide_x, wide_y = radii(gaps / jnp.maximum(count, 1.0))

    def test(column, line):
        return jnp.where(depth(column, line) > threshold(column, line), 0.0, 1.0)

    lit = disc(place.x, place.y, test, wide_x, wide_y, taps)
    return jnp.where(count > 0, lit, 1.0)
