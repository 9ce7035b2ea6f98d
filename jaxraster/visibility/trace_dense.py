"""Rays against few triangles: every one against every one, thousands of rays side by side.

Rays come ordered by the axis that they mostly follow, so that those taken together have their coordinates in one
order. Gradient: none.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex64, Float32, Int

from ..geometry.intersect import AXES, strike
from ..math.pair import pair

CHUNK = 4096  # rays side by side: at 1,024 the loop over triangles costs as much as their tests
UNROLL = 8  # triangles a step: what was found is read and written once


def trace_dense(
    corners: Float32[Array, "f 3 3"], rays: Float32[Array, "n 8"], starts: Int[Array, "4"], any_hit: bool
) -> tuple[Complex64[Array, " n"], Int[Array, ""]]:
    """The nearest hits of rays (origin, direction, t_min, t_max), those of equal t on the lowest face; steps taken.

    Rays from `starts[k]` on mostly follow axis k; those from `starts[3]` on are none, and what is returned for them
    is not defined. With `any_hit`, the face is 0 and t -inf where there is one.
    """
    num, count = rays.shape[0], corners.shape[0]
    chunk = min(CHUNK, num)
    corners = jnp.pad(corners, ((0, -count % UNROLL), (0, 0), (0, 0)))
    tables = jnp.stack([corners[:, :, jnp.array(axes)].reshape(-1, 9) for axes in AXES])
    columns = jnp.pad(rays, ((0, chunk), (0, 0))).T

    def trace_chunk(state):
        place, hits, steps = state
        axis = (place >= starts[1]).astype(jnp.int32) + (place >= starts[2]).astype(jnp.int32)
        block, table, axes = (
            lax.dynamic_slice_in_dim(columns, place, chunk, axis=1),
            tables[axis],
            jnp.array(AXES)[axis],
        )
        origin, direction = ([block[first + axes[k]] for k in range(3)] for first in (0, 3))
        shear, per_z = (direction[0] / direction[2], direction[1] / direction[2]), 1.0 / direction[2]

        def test_any(step, found):
            for face in range(UNROLL):
                met, t = strike(table[step * UNROLL + face], origin, shear, per_z)
                found |= met & (t > block[6]) & (t < block[7])
            return found

        def test(step, best):
            for face in range(UNROLL):
                face = step * UNROLL + face
                met, t = strike(table[face], origin, shear, per_z)
                best = jnp.where(met & (t > block[6]) & (t < lax.real(best)), pair(t, face), best)
            return best

        none = jnp.zeros(chunk, bool) | (axis < 0) if any_hit else pair(block[7], 0 * axis - 1)
        best = lax.fori_loop(0, corners.shape[0] // UNROLL, test_any if any_hit else test, none)
        # What lies beyond this axis' rays is written again, with those of the next.
        hits = lax.dynamic_update_slice_in_dim(hits, best, place, 0)
        return jnp.minimum(place + chunk, starts[axis + 1]), hits, steps + 1

    zero = starts[0] * 0
    none = jnp.zeros(num + chunk, bool) | (zero < 0) if any_hit else pair(columns[7], zero - 1)
    _, hits, steps = lax.while_loop(lambda state: state[0] < starts[3], trace_chunk, (zero, none, zero))
    if any_hit:
        hits = pair(jnp.full(num + chunk, -jnp.inf), hits.astype(jnp.int32) - 1)
    return hits[:num], steps
