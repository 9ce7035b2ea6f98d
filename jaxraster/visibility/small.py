"""The path of small triangles: visit the few pixels of each one's box, thousands of triangles side by side.

Depths are scattered first. Ids follow in a second pass, when all depths are known, to the pixels that have the
triangle's own depth; the lowest one stays. Gradient: none.
"""

import jax.numpy as jnp
from jax import lax

from ..math.table import apart, fetch
from .tiles import NOBODY, in_front
from .triangle import edges_at, nearness, set_up


def draw_small(drawn, near, seen, finding_ids, corners, order, last, *, chunk: int):
    """Depth bits, or, given all depths `near`, ids `[h, w]` after the faces `order[:last]`.

    Only what lies behind the pictures `seen` (depth bits, ids) is drawn, unless there are none. `corners(ids)` gives
    snapped x, y and depth of faces. The visits follow the largest box of a chunk, so that faces should come ordered by
    size.
    """
    height, width = near.shape
    near = near.reshape(-1)
    lane = jnp.arange(chunk, dtype=jnp.int32)
    seen = [picture.reshape(-1) for picture in seen]

    def draw_chunk(state):
        start, drawn = state
        used = start + lane < last
        ids = fetch(order, jnp.minimum(start + lane, last - 1))
        # Fetch apart from what is made of it: accesses fused with arithmetic keep that from vectors.
        some = start < last
        x, y, depth = apart(some, corners, ids)
        triangle = apart(some, lambda x, y, depth: set_up(some, x, y, depth, height, width), x, y, depth)
        edges = edges_at(triangle, triangle.left, triangle.top, height, width)
        columns = jnp.where(used, triangle.right - triangle.left + 1, 0)
        lines = jnp.where(used, triangle.bottom - triangle.top + 1, 0)
        most_columns = jnp.max(columns)
        steps = most_columns * jnp.max(lines)
        offset_x, offset_y = (start - middle for start, middle in zip((triangle.left, triangle.top), triangle.middle))
        plane = (triangle.depth, triangle.slope_x, triangle.slope_y, triangle.least, triangle.most)
        # Spread the lanes without a triangle, or each write would wait for the one before.
        corner = jnp.where(used, triangle.top * width + triangle.left, lane)

        def place_at(step):
            """Where each box's pixel number `step` lies, or some other pixel where the box has none."""
            return jnp.minimum(corner + (step // most_columns * width + step % most_columns), height * width - 1)

        def value_at(step):
            """Its depth, 0 where it is not covered: whatever is written there loses."""
            i, j = step % most_columns, step // most_columns
            inside = (i < columns) & (j < lines)
            for value, right, down in edges:
                inside = inside & (value + right * i + down * j >= 0)
            value = nearness(*plane, (offset_x + i).astype(jnp.float32), (offset_y + j).astype(jnp.float32))
            if seen:
                near_ahead, id_ahead = (fetch(picture, place_at(step)) for picture in seen)
                inside = inside & in_front(near_ahead, id_ahead, value, ids)
            return jnp.where(inside, value, 0)

        # Visit the boxes' pixels one after the other, in one of two loops: a branch would copy the picture each time.
        def visit_depths(step, drawn):
            return drawn.at[place_at(step)].max(value_at(step), mode="promise_in_bounds")

        # Carry what is found to the next step: the access to `near` fused with it would keep it from vectors.
        def visit_ids(step, state):
            drawn, value = state
            place = place_at(step)
            found = jnp.where(value == fetch(near, place), ids, NOBODY)
            return drawn.at[place].min(found, mode="promise_in_bounds"), value_at(step + 1)

        drawn = lax.fori_loop(0, jnp.where(finding_ids, 0, steps), visit_depths, drawn)
        state = (drawn, value_at(start * 0))
        return start + chunk, lax.fori_loop(0, jnp.where(finding_ids, steps, 0), visit_ids, state)[0]

    state = (last * 0, drawn.reshape(-1))
    return lax.while_loop(lambda state: state[0] < last, draw_chunk, state)[1].reshape(height, width)
