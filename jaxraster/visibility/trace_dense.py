"""Rays against few triangles: every one against every one, thousands of rays side by side.

Rays come ordered by the axis that they mostly follow, so that those taken together have their coordinates in one
order. Gradient: none.
"""

import functools

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex64, Float32, Int

from ..geometry.intersect import AXES, strike, turned
from ..math.pair import pair
from ..math.table import fetch

CHUNK = 4096  # rays side by side: at 1,024 the loop over triangles costs as much as their tests
ROUNDING = 2.0**-20  # of the sum of a difference's terms: 16 roundings, of which it makes five
UNROLL = 8  # triangles a step: what was found is read and written once


Columns = tuple[Float32[Array, " n"], ...]  # origin, direction, t_min and t_max of rays, eight arrays


def _range(own, values):
    """The least and the greatest, of this chunk's own rays."""
    return jnp.min(jnp.where(own, values, jnp.inf)), jnp.max(jnp.where(own, values, -jnp.inf))


def _missed(corners, origin, shear, up, down):
    """Which triangles lie beside the lines of all rays, or behind all of them.

    `corners` `[9, f]`; ranges of origin and shear; whether any ray looks up the main axis, and whether any looks down.
    Where each ray is the z axis, c_x - o_x - s_x (c_z - o_z) of all three corners then has one sign, whatever the ray.
    """
    heights = [[corners[3 * k + 2] - end for end in reversed(origin[2])] for k in range(3)]
    sides = [[(high < 0) & ~down for _, high in heights], [(low > 0) & ~up for low, _ in heights]]
    for axis in range(2):
        above, below = [], []
        for k in range(3):
            value, (low, high) = corners[3 * k + axis], origin[axis]
            leans = [slope * height for slope in shear[axis] for height in heights[k]]
            least, most = functools.reduce(jnp.minimum, leans), functools.reduce(jnp.maximum, leans)
            slack = ROUNDING * sum(map(jnp.abs, (value, low, high, least, most)))
            above.append(value - high - most > slack)
            below.append(value - low - least < -slack)
        sides += [above, below]
    return functools.reduce(jnp.logical_or, (a & b & c for a, b, c in sides))


def trace_dense(
    corners: Float32[Array, "f 3 3"], rays: Columns, starts: Int[Array, "4"], any_hit: bool
) -> tuple[Complex64[Array, " n"], Int[Array, ""]]:
    """The nearest hits of rays (origin, direction, t_min, t_max), those of equal t on the lowest face; steps taken.

    Rays from `starts[k]` on mostly follow axis k; those from `starts[3]` on are none, and what is returned for them
    is not defined. With `any_hit`, the face is 0 and t -inf where there is one.
    """
    num = len(rays[0])
    chunk = min(CHUNK, num)
    corners = jnp.pad(corners, ((0, -corners.shape[0] % UNROLL), (0, 0), (0, 0)))
    tables = jnp.stack([corners[:, :, jnp.array(axes)].reshape(-1, 9) for axes in AXES])
    count = corners.shape[0]
    number, lane = jnp.arange(count, dtype=jnp.int32), jnp.arange(chunk, dtype=jnp.int32)

    def trace_chunk(state):
        start, hits, steps = state
        axis = (start >= starts[1]).astype(jnp.int32) + (start >= starts[2]).astype(jnp.int32)
        # The last chunk begins earlier, so that it ends with the rays.
        place = jnp.minimum(start, num - chunk)
        own = (lane >= start - place) & (lane < starts[axis + 1] - place)
        block, table = [lax.dynamic_slice_in_dim(column, place, chunk) for column in rays], tables[axis]
        origin, direction = turned(block[:3], axis), turned(block[3:6], axis)
        shear, per_z = (direction[0] / direction[2], direction[1] / direction[2]), 1.0 / direction[2]

        # Bring the triangles to the front that any of these rays may meet, in their order.
        origins, shears = ([_range(own, v) for v in part] for part in (origin, shear))
        up, down = jnp.any(own & (per_z > 0)), jnp.any(own & (per_z < 0))
        missed = _missed(table.T, origins, shears, up, down)
        order = jnp.sort(jnp.where(missed, count, 0) + number) % count
        near, table = count - jnp.sum(missed, dtype=jnp.int32), fetch(table, order)

        def test_any(step, found):
            for face in range(UNROLL):
                met, t = strike(table[step * UNROLL + face], origin, shear, per_z)
                found |= met & (t > block[6]) & (t < block[7])
            return found

        def test(step, best):
            for face in range(UNROLL):
                met, t = strike(table[step * UNROLL + face], origin, shear, per_z)
                found = pair(t, order[step * UNROLL + face])
                best = jnp.where(met & (t > block[6]) & (t < lax.real(best)), found, best)
            return best

        none = jnp.zeros(chunk, bool) | (axis < 0) if any_hit else pair(block[7], 0 * axis - 1)
        best = lax.fori_loop(0, (near + UNROLL - 1) // UNROLL, test_any if any_hit else test, none)
        best = jnp.where(own, best, lax.dynamic_slice_in_dim(hits, place, chunk))
        return (
            jnp.minimum(start + chunk, starts[axis + 1]),
            lax.dynamic_update_slice_in_dim(hits, best, place, 0),
            steps + 1,
        )

    zero = starts[0] * 0
    none = jnp.zeros(num, bool) | (zero < 0) if any_hit else pair(rays[7], zero - 1)
    _, hits, steps = lax.while_loop(lambda state: state[0] < starts[3], trace_chunk, (zero, none, zero))
    return pair(jnp.full(num, -jnp.inf), hits.astype(jnp.int32) - 1) if any_hit else hits, steps
