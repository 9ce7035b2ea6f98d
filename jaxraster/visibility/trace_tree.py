"""Rays against a tree, as a stream: a stack of pairs of a ray and a node, thousands of which are taken at a time.

A pair is a ray that meets a node's box. Those taken are tested against the node's four boxes; what they meet goes back
onto the stack, the nearer boxes on top, or, for leaves, into a queue at its other end. No ray waits for another that
has farther to go, and what is behind a hit is dropped when its turn comes.
Gradient: none.
Source: the conservative box test is Ize 2013, "Robust BVH Ray Traversal".
"""

import functools

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex64, Int, Int32

from ..geometry.bvh import NONE, WIDE
from ..geometry.intersect import main_axis, strike, turned
from ..math.pair import pair, unpair
from ..math.scan import running_sum
from ..math.table import apart, fetch
from .trace_dense import Columns

RAYS = 8192  # traced together: their rows and their stack stay near the processor
PAIRS = 2048  # taken at a time
FEW = 16  # times as many pairs as there are rays: of few rays, more than one pair each, for a step costs much
SPARE = 6  # times PAIRS that the stack may grow before fewer are taken
DEEPEST = 36  # levels of nodes in any tree: 40 + 31 splits in two, two a level
SLACK = 1.0 + 2.0**-20  # of distances to boxes: 16 roundings, of which the test makes eight
MISSED = 2**31 - 1  # the key of a box that is not met, and the face of no triangle: others are lower
LEAST = 2.0**-100  # a direction's component in units of its largest; none is 0, and 0 · inf does not occur


def _rows(rays):
    """Rows of what rays (origin, direction, t_min, t_max) are tested with, against boxes and triangles."""
    origin, direction, t_min = rays[:3], rays[3:6], rays[6]
    axis, length = main_axis(direction), functools.reduce(jnp.maximum, map(jnp.abs, direction))
    # Divide by the length before comparing: LEAST of a short direction would be 0.
    units = [v / length for v in direction]
    inverse = [1.0 / jnp.where(jnp.abs(v) < LEAST, jnp.copysign(LEAST, v), v) for v in units]
    x, y, z = turned(direction, axis)
    bits = lax.bitcast_convert_type(axis, jnp.float32)
    boxes = [*origin, *inverse, length, t_min * length / SLACK]
    triangles = [*turned(origin, axis), x / z, y / z, 1.0 / z, t_min, bits]
    return jnp.stack(boxes, axis=-1), jnp.stack(triangles, axis=-1)


def _nearest_boxes(ray, node, best_t, live):
    """Which of the node's boxes each ray meets, the nearest first: three bits a box, 4 and its number, 0 for none."""
    far_limit, keys = best_t * ray[6], []
    for child in range(WIDE):
        near, far = ray[7], far_limit
        for k in range(3):
            low = (node[6 * child + k] - ray[k]) * ray[3 + k]
            high = (node[6 * child + 3 + k] - ray[k]) * ray[3 + k]
            # No minimum or maximum: those carry NaN, at a price.
            first, last = jnp.where(low < high, low, high), jnp.where(low < high, high, low)
            near, far = jnp.where(first > near, first, near), jnp.where(last < far, last, far)
        # Distances are positive, and ordered like their bits; two of these are the box's number.
        key = (lax.bitcast_convert_type(near, jnp.int32) & ~3) | child
        keys.append(jnp.where(live & (near <= far * SLACK), key, MISSED))
    for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)):
        keys[i], keys[j] = jnp.minimum(keys[i], keys[j]), jnp.maximum(keys[i], keys[j])
    return sum(jnp.where(key == MISSED, 0, (4 | (key & 3)) << (3 * rank)) for rank, key in enumerate(keys))


def _nearest_triangle(ray, leaf, live):
    """The nearest of its leaf's triangles that each ray meets."""
    axis = lax.bitcast_convert_type(ray[7], jnp.int32)
    best = pair(jnp.full_like(ray[0], jnp.inf), jnp.int32(MISSED))
    for slot in range(WIDE):
        points = [[leaf[9 * slot + 3 * k + i] for i in range(3)] for k in range(3)]
        corners = [value for point in points for value in turned(point, axis)]
        met, t = strike(corners, ray[:3], ray[3:5], ray[5])
        found = pair(t, lax.bitcast_convert_type(leaf[9 * WIDE + slot], jnp.int32))
        best = jnp.where(met & live & (t > ray[6]) & _before(found, best), found, best)
    return best


def _before(a, b):
    """Whether a hit is nearer than another, or as near and on the lower face."""
    return (lax.real(a) < lax.real(b)) | ((lax.real(a) == lax.real(b)) & (unpair(a)[1] < unpair(b)[1]))


def _children(code, refs):
    """The children that were met, `[4 n]`: first all rays' farthest, last their nearest; NONE for no more."""
    ranks = []
    for rank in reversed(range(WIDE)):
        child = (code >> (3 * rank)) & 7
        ref = jnp.where(child == 4, refs[0], jnp.where(child == 5, refs[1], jnp.where(child == 6, refs[2], refs[3])))
        ranks.append(jnp.where(child == 0, NONE, ref))
    return jnp.concatenate(ranks)


def _trace(nodes, leaves, rays, first, count, any_hit):
    """Hits of the rays from `first` to `count`, and the number of steps."""
    num, always = len(rays[0]), count >= 0
    taken = min(PAIRS, FEW * num)
    reserve = (WIDE - 1) * DEEPEST  # what a single pair and all that comes of it can add
    highest = num + SPARE * taken  # from here on pairs are taken one by one, so that no tree overflows the stack
    end = highest + reserve + (WIDE + 1) * taken  # the queue grows down from here; what is not put lies beyond
    lane = jnp.arange(taken, dtype=jnp.int32)
    nowhere = end + jnp.arange(WIDE * taken, dtype=jnp.int32)
    box_rows, triangle_rows = apart(always, _rows, rays)

    def live_pairs(stack, start, live):
        # What was not put yet stands for ray 0 and node 0.
        return (jnp.where(live, part, 0) for part in unpair(lax.dynamic_slice_in_dim(stack, start, taken)))

    def places(child, start, queued):
        kind = jnp.where(child == NONE, 0, jnp.where(child >= 0, 1, 1 << 16))
        total = running_sum(kind)
        before = total - kind
        place = jnp.where(child >= 0, start + (before & 0xFFFF), end - 1 - queued - (before >> 16))
        return jnp.where(child == NONE, nowhere, place), start + (total[-1] & 0xFFFF), queued + (total[-1] >> 16)

    def visit(state):
        stack, top, queued, best, steps = state
        start = jnp.maximum(top - jnp.clip((highest - top) // (WIDE - 1), 1, taken), 0)
        live = start + lane < top
        ray, node = live_pairs(stack, start, live)
        # Fetch, test, order and put apart from each other: fused, each would be done for every reader.
        rows = apart(
            always, lambda r, n: (fetch(box_rows, r).T, fetch(nodes, n).T, lax.real(fetch(best, r))), ray, node
        )
        code = apart(always, _nearest_boxes, *rows, live)
        refs = lax.bitcast_convert_type(rows[1][6 * WIDE : 7 * WIDE], jnp.int32)
        child = apart(always, _children, code, refs)
        place, top, queued = apart(always, places, child, start, queued)
        pairs = pair(jnp.tile(ray, WIDE), jnp.where(child < 0, -1 - child, child))
        stack = stack.at[place].set(pairs, mode="promise_in_bounds", unique_indices=True)
        return stack, top, queued, best, steps + 1

    def strike_leaves(state):
        stack, top, queued, best, steps = state
        live = lane < queued
        ray, leaf = live_pairs(stack, end - queued, live)
        rows = apart(always, lambda ray, leaf: (fetch(triangle_rows, ray).T, fetch(leaves, leaf).T), ray, leaf)
        found = apart(always, _nearest_triangle, *rows, live)
        if any_hit:
            # Nothing is nearer: all else that the ray has on the stack will be dropped.
            nearest = pair(jnp.full_like(lax.real(found), -jnp.inf), unpair(found)[1])
            found = jnp.where(lax.real(found) < lax.real(fetch(best, ray)), nearest, found)

        # A ray may be here several times, of which one is written: until none is left that is nearer.
        def put(state):
            best, better = state
            best = best.at[jnp.where(better, ray, num)].set(found, mode="drop")
            return best, _before(found, fetch(best, ray))

        best, _ = lax.while_loop(lambda state: jnp.any(state[1]), put, (best, _before(found, fetch(best, ray))))
        return stack, top, queued - jnp.minimum(queued, taken), best, steps + 1

    def turn(state):
        state = lax.while_loop(lambda s: (s[1] > 0) & (s[2] < taken), visit, state)
        return lax.while_loop(lambda s: (s[2] >= taken) | ((s[1] == 0) & (s[2] > 0)), strike_leaves, state)

    zero = count * 0
    ray = first + jnp.pad(jnp.arange(num, dtype=jnp.int32), (0, end + WIDE * taken - num))
    state = pair(ray, ray * 0), jnp.minimum(count, num) - first, zero, pair(rays[7], zero - 1), zero
    *_, best, steps = lax.while_loop(lambda s: (s[1] > 0) | (s[2] > 0), turn, state)
    return best, steps


def trace_tree(
    nodes: Int32[Array, "m 32"],
    leaves: Int32[Array, "l 40"],
    rays: Columns,
    count: Int[Array, ""],
    any_hit: bool,
) -> tuple[Complex64[Array, " n"], Int[Array, ""]]:
    """The nearest hits of the first `count` rays (origin, direction, t_min, t_max), or any; and steps taken.

    Of hits of equal t, the one on the lowest face. With `any_hit`, t is -inf where there is one.
    """
    num = len(rays[0])
    chunk = min(RAYS, num)
    # Most of a row are coordinates: as bits they would be converted at each reader.
    nodes, leaves = (lax.bitcast_convert_type(rows, jnp.float32) for rows in (nodes, leaves))
    lane = jnp.arange(chunk, dtype=jnp.int32)

    def trace_chunk(state):
        start, hits, steps = state
        # The last chunk begins earlier, so that it ends with the rays.
        place = jnp.minimum(start, num - chunk)
        block = tuple(lax.dynamic_slice_in_dim(column, place, chunk) for column in rays)
        best, more = _trace(nodes, leaves, block, start - place, count - place, any_hit)
        best = jnp.where(lane < start - place, lax.dynamic_slice_in_dim(hits, place, chunk), best)
        return start + chunk, lax.dynamic_update_slice_in_dim(hits, best, place, 0), steps + more

    zero = count * 0
    state = zero, pair(rays[7], zero - 1), zero
    _, hits, steps = lax.while_loop(lambda state: state[0] < count, trace_chunk, state)
    return hits, steps
