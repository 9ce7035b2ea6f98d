"""A tree of boxes split by the surface-area heuristic, level by level, in NumPy on the host.

The cost of a split is area · number of triangles, added up over both sides, as the chance that a ray which meets a box
also meets one inside is the ratio of their areas. All nodes of a level are split together, at the best of 15 planes
along each axis; no function calls itself, and no loop runs over nodes or triangles. Gradient: none.
Source: Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies" (bins).
"""

import numpy as np

LEAF = 4  # triangles of a leaf
BINS = 16  # as is usual: planes to choose from, for the price of that many boxes a node and axis
STEEP = 40  # levels after which nodes are halved: then no tree is deeper than 40 and the halvings of 2³¹ triangles


def _area(boxes):
    """Half the surface of boxes `[..., 6]`."""
    x, y, z = np.moveaxis(boxes[..., 3:] - boxes[..., :3], -1, 0)
    return x * y + y * z + z * x


def _union(boxes, starts):
    """The box of each run of boxes, given where the runs start."""
    low, high = np.minimum.reduceat(boxes[:, :3], starts), np.maximum.reduceat(boxes[:, 3:], starts)
    return np.concatenate([low, high], axis=1)


def _grown(boxes):
    """Boxes `[k, b, 6]` of the first, the first two, ... along the second axis."""
    low, high = np.minimum.accumulate(boxes[..., :3], axis=1), np.maximum.accumulate(boxes[..., 3:], axis=1)
    return np.concatenate([low, high], axis=-1)


def _split(boxes, node, starts, counts):
    """Which triangles go to the right of their node's best plane, and which nodes have no plane that parts them."""
    num, middle = len(starts), boxes[:, :3] + boxes[:, 3:]
    low, high = np.minimum.reduceat(middle, starts), np.maximum.reduceat(middle, starts)
    scale = BINS / np.where(high > low, high - low, np.inf)
    bins = np.minimum(((middle - low[node]) * scale[node]).astype(np.int64), BINS - 1)
    best, axis, plane = np.full(num, np.inf), np.zeros(num, np.int64), np.zeros(num, np.int64)
    for k in range(3):
        key = node * BINS + bins[:, k]
        in_bin = np.bincount(key, minlength=num * BINS)
        full = np.flatnonzero(in_bin)
        bounds = np.tile(np.array([np.inf] * 3 + [-np.inf] * 3, boxes.dtype), (num * BINS, 1))
        bounds[full] = _union(boxes[np.argsort(key, kind="stable")], (np.cumsum(in_bin) - in_bin)[full])
        bounds = bounds.reshape(num, BINS, 6)
        left = np.cumsum(in_bin.reshape(num, BINS), axis=1)[:, :-1]
        right = counts[:, None] - left
        # An empty side has an infinite or undefined area, and is no split.
        with np.errstate(invalid="ignore"):
            cost = _area(_grown(bounds))[:, :-1] * left + _area(_grown(bounds[:, ::-1]))[:, -2::-1] * right
        cost = np.where((left > 0) & (right > 0), cost, np.inf)
        here, place = cost.min(axis=1), cost.argmin(axis=1)
        axis, plane, best = (np.where(here < best, *pair) for pair in ((k, axis), (place, plane), (here, best)))
    return bins[np.arange(len(bins)), axis[node]] > plane[node], np.isinf(best)


def _binary(boxes):
    """`(bounds, child, count, order)` of a binary tree, the root being number 0, siblings next to each other.

    `child` is an inner node's left child, and where a leaf's `count` triangles start in `order`.
    """
    triangle, counts = np.arange(len(boxes)), np.array([len(boxes)])
    levels, order, num, placed = [], [], 1, 0
    while len(counts):
        starts = np.cumsum(counts) - counts
        bounds, node = _union(boxes[triangle], starts), np.repeat(np.arange(len(counts)), counts)

        # Take out the leaves.
        leaf = counts <= LEAF
        order.append(triangle[leaf[node]])
        triangle = triangle[~leaf[node]]
        in_leaf, inner = np.where(leaf, counts, 0), counts[~leaf]
        child = np.where(leaf, placed + np.cumsum(in_leaf) - in_leaf, num + 2 * (np.cumsum(~leaf) - 1))
        levels.append((bounds, child, in_leaf))
        placed, num = placed + in_leaf.sum(), num + 2 * len(inner)
        if len(inner) == 0:
            break

        # Split the others; by number where nothing parts them.
        starts, node = np.cumsum(inner) - inner, np.repeat(np.arange(len(inner)), inner)
        right, apart = _split(boxes[triangle], node, starts, inner)
        half = 2 * (np.arange(len(triangle)) - starts[node]) >= inner[node]
        right = np.where(apart[node] | (len(levels) > STEEP), half, right)
        triangle = triangle[np.argsort(2 * node + right, kind="stable")]
        to_right = np.bincount(node, weights=right).astype(np.int64)
        counts = np.stack([inner - to_right, to_right], axis=1).reshape(-1)
    bounds, child, count = (np.concatenate(part) for part in zip(*levels))
    return bounds, child, count, np.concatenate(order)


def wide_tree(boxes: np.ndarray, none: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes' boxes `[n, 4, 6]` and children `[n, 4]`, and leaves' triangles `[l, 4]`, of boxes `[f, 6]`.

    Each node takes the children of both of its binary one's. A child is a node, the root being 0; a leaf, from -1
    down; or `none`. Free places of leaves hold -1. Boxes that are empty (low above high) are in no leaf.
    """
    used = np.flatnonzero(boxes[:, 0] <= boxes[:, 3])
    if len(used) == 0:
        return np.zeros((1, 4, 6), np.float32), np.full((1, 4), none), np.full((1, 4), -1)
    bounds, child, count, order = _binary(boxes[used])
    leaf = np.flatnonzero(count)
    place = np.arange(LEAF)
    slots = used[order[np.minimum(child[leaf][:, None] + place, len(order) - 1)]]
    slots = np.where(place < count[leaf][:, None], slots, -1)

    # Number what a wide node refers to; a level at a time, from the root.
    name = np.zeros(len(count), np.int64)
    name[leaf] = -1 - np.arange(len(leaf))
    rows, level, num = [], np.array([0]), 1
    if count[0]:
        rows, level = [np.array([[0, -1, -1, -1]])], np.array([], np.int64)
    while len(level):
        pair = child[level][:, None] + np.arange(2)
        whole = count[pair] > 0
        row = np.stack([np.where(whole, pair, child[pair]), np.where(whole, -1, child[pair] + 1)], axis=-1)
        row = row.reshape(-1, 4)
        level = row[(row >= 0) & (count[row] == 0)]
        name[level] = num + np.arange(len(level))
        num += len(level)
        rows.append(row)
    rows = np.concatenate(rows)
    return bounds[rows], np.where(rows < 0, none, name[rows]), slots
