"""The path of small triangles: visit the few pixels of each one's box, thousands of triangles side by side.

Depths are scattered first. Ids follow in a second pass, when all depths are known, to the pixels that have the
triangle's own depth; the lowest one stays. Gradient: none.
"""

import jax.numpy as jnp
from jax import lax

from ..math.table import apart, fetch
from .tiles import PIXELS, address, grid, in_front, unpair
from .triangle import edges_at, nearness, set_up


def draw_small(near, id, ahead, finding_ids, corners, order, last, *, chunk: int, height: int, width: int):
    """Depth bits and ids `[t, 256]` after the faces `order[:last]`: depths, or, given all depths, ids.

    Only what lies behind the pixels `ahead` is drawn, unless they are None. `corners(ids)` gives snapped x, y and depth
    of faces. The visits follow the largest box of a chunk, so that faces should come ordered by size.
    """
    across, shape = grid(height, width)[1], near.shape
    lane = jnp.arange(chunk, dtype=jnp.int32)
    spare = near.size - PIXELS + lane % PIXELS  # one for each lane, or every write would wait for the one before

    def draw_chunk(state):
        start, near, id = state
        ids = fetch(order, jnp.minimum(start + lane, last - 1))
        # Fetch apart from what is made of it: accesses fused with arithmetic keep that from vectors.
        points = apart(start < last, corners, ids)
        triangle = apart(start < last, lambda x, y, depth: set_up(x, y, depth, height, width), *points)
        edges = edges_at(triangle, triangle.left, triangle.top, height, width)
        columns = jnp.where(start + lane < last, triangle.right - triangle.left + 1, 0)
        lines = jnp.where(start + lane < last, triangle.bottom - triangle.top + 1, 0)
        most_columns = jnp.max(columns)
        steps = most_columns * jnp.max(lines)
        offset_x, offset_y = (start - middle for start, middle in zip((triangle.left, triangle.top), triangle.middle))
        plane = (triangle.depth, triangle.slope_x, triangle.slope_y, triangle.least, triangle.most)

        def at(step):
            # The address of each box's pixel number `step`, a spare one where it is not covered, and its depth.
            i, j = step % most_columns, step // most_columns
            inside = (i < columns) & (j < lines)
            for value, right, down in edges:
                inside = inside & (value + right * i + down * j >= 0)
            value = nearness(*plane, (offset_x + i).astype(jnp.float32), (offset_y + j).astype(jnp.float32))
            place = jnp.where(inside, address(triangle.left + i, triangle.top + j, across), spare)
            if ahead is not None:
                place = jnp.where(in_front(*unpair(fetch(ahead.reshape(-1), place)), value, ids), place, spare)
            return place, value

        # Visit the boxes' pixels one after the other; a loop of its own, or XLA repeats the above for each of them.
        def draw_depths(near, id):
            def visit(step, near):
                place, value = at(step)
                return near.at[place].max(value, mode="promise_in_bounds")

            return lax.fori_loop(0, steps, visit, near), id

        # Carry what is found to the next step: the access to `near` fused with it would keep it from vectors.
        def draw_ids(near, id):
            def visit(step, state):
                id, place, value = state
                place = jnp.where(value == fetch(near, place), place, spare)
                return id.at[place].min(ids, mode="promise_in_bounds"), *at(step + 1)

            return near, lax.fori_loop(0, steps, visit, (id, *at(start * 0)))[0]

        return start + chunk, *lax.cond(finding_ids, draw_ids, draw_depths, near, id)

    state = (last * 0, near.reshape(-1), id.reshape(-1))
    _, near, id = lax.while_loop(lambda state: state[0] < last, draw_chunk, state)
    return near.reshape(shape), id.reshape(shape)
