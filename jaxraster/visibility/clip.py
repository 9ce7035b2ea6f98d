"""Clipping of triangles in homogeneous space, to the near plane and to the guard band.

Only triangles that cross a plane come here. Where two of them share an edge they get the same new vertex, because it
is interpolated from the edge's endpoints in the order of their coordinates, not of their winding or index.

Gradient: none, barycentrics are recomputed from the original vertices.
Source: Sutherland & Hodgman 1974, "Reentrant Polygon Clipping".
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

NUM_PLANES = 5
CORNERS = 3 + NUM_PLANES  # a convex polygon gains at most one corner from each plane


def plane_distances(clip: Float[Array, "*n 4"], guard_x: float, guard_y: float) -> Float[Array, "*n 5"]:
    """Signed distances to near (z <= w) and |x| <= guard_x·w, |y| <= guard_y·w; inside is >= 0."""
    x, y, z, w = (clip[..., i] for i in range(4))
    return jnp.stack([w - z, guard_x * w - x, guard_x * w + x, guard_y * w - y, guard_y * w + y], axis=-1)


def _precedes(a: Float[Array, "*n 4"], b: Float[Array, "*n 4"]) -> Bool[Array, "*n"]:
    """Lexicographic order of coordinates: the same for both triangles of an edge, whatever their vertices' indices."""
    before = a[..., 3] < b[..., 3]
    for axis in (2, 1, 0):
        before = (a[..., axis] < b[..., axis]) | ((a[..., axis] == b[..., axis]) & before)
    return before


def clip_polygon(
    corners: Float[Array, "n 3 4"], guard_x: float, guard_y: float
) -> tuple[Float[Array, "n 8 4"], Int[Array, " n"]]:
    """Triangles cut to all planes: convex polygons with their number of corners, 0 where nothing is left."""
    num = corners.shape[0]
    polygon = jnp.concatenate([corners, jnp.zeros((num, NUM_PLANES, 4), corners.dtype)], axis=1)
    slot = jnp.arange(CORNERS, dtype=jnp.int32)[None, :]

    def cut(plane, state):
        polygon, count = state
        distance = jnp.take(plane_distances(polygon, guard_x, guard_y), plane, axis=-1)
        used = slot < count[:, None]
        following = jnp.where(slot + 1 < count[:, None], slot + 1, 0)
        next_corner = jnp.take_along_axis(polygon, following[..., None], axis=1)
        next_distance = jnp.take_along_axis(distance, following, axis=1)

        # Meet the plane on every edge that crosses it, from the endpoint that comes first in coordinates.
        swap = ~_precedes(polygon, next_corner)
        start = jnp.where(swap[..., None], next_corner, polygon)
        end = jnp.where(swap[..., None], polygon, next_corner)
        start_distance = jnp.where(swap, next_distance, distance)
        end_distance = jnp.where(swap, distance, next_distance)
        inside, next_inside = distance >= 0, next_distance >= 0
        crossing = used & (inside != next_inside)
        t = jnp.where(crossing, start_distance / jnp.where(crossing, start_distance - end_distance, 1.0), 0.0)
        meeting = start + t[..., None] * (end - start)

        # Keep the corners inside and the meeting points, in order, from the first slot on.
        candidates = jnp.stack([polygon, meeting], axis=2).reshape(num, 2 * CORNERS, 4)
        kept = jnp.stack([used & inside, crossing], axis=2).reshape(num, 2 * CORNERS)
        rank = jnp.where(kept, jnp.cumsum(kept, axis=1, dtype=jnp.int32), 0)
        source = jnp.argmax(rank[:, None, :] == (slot + 1)[..., None], axis=-1)
        return jnp.take_along_axis(candidates, source[..., None], axis=1), jnp.sum(kept, axis=1, dtype=jnp.int32)

    # Derive the first count from the input, so that a device-varying input makes a device-varying loop.
    three = jnp.where(corners[:, 0, 0] == 0, jnp.int32(3), jnp.int32(3))
    polygon, count = lax.fori_loop(0, NUM_PLANES, cut, (polygon, three))
    return polygon, jnp.where(count >= 3, count, 0)
