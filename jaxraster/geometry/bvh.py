"""Trees of boxes over triangles: which of them a ray need not be tested against.

A node holds the boxes of four children, in one row, for a row is what is fetched at once; leaves hold four triangles.
`build` splits by surface area on the host and is for geometry that stays; `build_morton` sorts along a curve, traced,
and is for geometry that moves. Few triangles need no tree, and neither function makes one for them.

Gradient: none, on purpose: `stop_gradient` stands in both.
Source: Lauterbach et al. 2009, "Fast BVH Construction on GPUs" (Morton order; we join four neighbours at a time,
level by level, where they split by bits).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Float32, Int, Int32

from ..buffers import Stats
from ..check import below, fit
from ..record import record
from .bvh_sah import wide_tree
from .intersect import canonical

DENSE = 128  # triangles up to which testing all of them is faster than walking a tree
WIDE = 4  # children of a node and triangles of a leaf
NONE = -(2**31)  # no child; others are nodes from 0 on, and leaves from -1 down
NODE = 32  # numbers in a node's row, of which 28 are used: whole lines of the cache
# By how much of its size a triangle's box is enlarged, 16 roundings: the triangle's test may accept a ray that passes
# by within a few roundings of its size, and so must then the box's.
MARGIN = 2.0**-20
EMPTY = (jnp.inf,) * 3 + (-jnp.inf,) * 3  # the box of nothing


@record
class Tree:
    """Triangles ready to be traced: their corners, in an order of their own, and boxes around them, unless few.

    `nodes` are four boxes (low corner, high corner), as the bits of float32, and four children; `leaves` four
    triangles' corners, likewise, and their faces. Not the other way round: as float32, negative ids are NaN.
    `stats` counts the faces that were left out.
    """

    corners: Float32[Array, "*b f 3 3"]
    stats: Stats
    nodes: Int32[Array, "*b n 32"] | None = None
    leaves: Int32[Array, "*b l 40"] | None = None


def _prepare(where: str, vertices, faces):
    fit(f"{where}: vertices", vertices, Float[Array, "v 3"], batched=False)
    fit(f"{where}: faces", faces, Int[Array, "f 3"])
    below(f"{where}: faces", faces, vertices.shape[0], "vertices")
    vertices, faces = lax.stop_gradient(jnp.asarray(vertices)), jnp.asarray(faces).astype(jnp.int32)
    if vertices.shape[0] == 0:
        # A gather from an empty table is not defined.
        vertices, faces = jnp.zeros((1, 3), jnp.float32), jnp.full_like(faces, -1)
    return _canonical(vertices, faces)


# Compiled, and so rounded, in one way for both builders.
_canonical = jax.jit(canonical)


@jax.jit
def _boxes(corners: Float32[Array, "f 3 3"]) -> Float32[Array, "f 6"]:
    """Each triangle's box, a little enlarged; of one that can never be hit, an empty one, from inf to -inf."""
    low, high = jnp.min(corners, axis=1), jnp.max(corners, axis=1)
    margin = MARGIN * jnp.max(high - low, axis=1, keepdims=True)
    # By a rounding at least: far from 0 the margin is less, and a ray within a face of the box must meet it.
    low = jnp.minimum(low - margin, jnp.nextafter(low, jnp.float32(-jnp.inf)))
    high = jnp.maximum(high + margin, jnp.nextafter(high, jnp.float32(jnp.inf)))
    box = jnp.concatenate([low, high], axis=1)
    return jnp.where(margin > 0, box, jnp.array([EMPTY], jnp.float32))


def _bits(numbers: Float32[Array, "*n"]) -> Int32[Array, "*n"]:
    return lax.bitcast_convert_type(numbers, jnp.int32)


@jax.jit
def _rows(boxes: Float32[Array, "n 4 6"], child: Int32[Array, "n 4"]) -> Int32[Array, "n 32"]:
    """Rows of four boxes and their children."""
    row = jnp.concatenate([_bits(boxes.reshape(-1, 6 * WIDE)), child], axis=1)
    return jnp.pad(row, ((0, 0), (0, NODE - row.shape[1])))


@jax.jit
def _leaves(corners: Float32[Array, "f 3 3"], slots: Int32[Array, "l 4"]) -> Int32[Array, "l 40"]:
    """Rows of four triangles and their faces; where a slot is -1, of one that can never be hit."""
    flat = jnp.where((slots >= 0)[..., None], corners.reshape(-1, 9)[slots], 0.0)
    return jnp.concatenate([_bits(flat.reshape(slots.shape[0], -1)), slots], axis=1)


def build(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Tree:
    """A tree split by surface area, made on the host, so that positions must be known: not inside of `jit`.

    Triangles with a corner that is not finite or beyond 1e12, or without area, are left out and counted in `stats`.
    So are faces that name no vertex where they are traced; where they are known, these raise. Up to 128 triangles
    there is no tree, and positions may be traced.

    Example:
        >>> tree = build(jnp.eye(3), jnp.array([[0, 1, 2], [0, 1, 1]]))
        >>> tree.corners.shape, int(tree.stats.degenerate)
        ((2, 3, 3), 1)
    """
    corners, stats = _prepare("build", vertices, faces)
    if corners.shape[0] <= DENSE:
        return Tree(corners=corners, stats=stats)
    if isinstance(corners, jax.core.Tracer):
        raise TypeError(f"build: vertices are traced, and more than {DENSE} triangles need the host; use build_morton")
    boxes, children, slots = wide_tree(np.asarray(_boxes(corners)), NONE)
    nodes = _rows(jnp.asarray(boxes), jnp.asarray(children.astype(np.int32)))
    leaves = _leaves(corners, jnp.asarray(slots.astype(np.int32)))
    return Tree(corners=corners, stats=stats, nodes=nodes, leaves=leaves)


def _spread(x: Int[Array, " f"]) -> Int[Array, " f"]:
    """The ten bits of a number, two zeros between each and the next."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | (x << shift)) & mask
    return x


def _morton(boxes: Float32[Array, "f 6"]) -> Int[Array, " f"]:
    """Each box's place on the curve, 30 bits; empty ones come last."""
    some = boxes[:, 0] <= boxes[:, 3]
    # Halve before adding: coordinates are far below what overflows, yet empty boxes are not.
    middle = jnp.where(some[:, None], 0.5 * boxes[:, :3] + 0.5 * boxes[:, 3:], 0.0)
    low = jnp.min(jnp.where(some[:, None], middle, jnp.inf), axis=0, keepdims=True)
    size = jnp.max(jnp.where(some[:, None], middle, -jnp.inf), axis=0, keepdims=True) - low
    cell = 1023.0 * (middle - low) / jnp.where((size > 0) & (size < jnp.inf), size, 1.0)
    x, y, z = (_spread(jnp.clip(cell[:, k], 0.0, 1023.0).astype(jnp.int32)) for k in range(3))
    return jnp.where(some, x << 2 | y << 1 | z, 2**30)


def build_morton(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Tree:
    """A tree over triangles in Morton order, traced: for positions that change with each call.

    It is made faster than `build`'s and walked more slowly, for its boxes overlap more. What is left out is as there,
    and up to 128 triangles there is no tree.

    Example:
        >>> tree = build_morton(jnp.eye(3), jnp.array([[0, 1, 2]]))
        >>> tree.corners.shape, tree.nodes is None
        ((1, 3, 3), True)
    """
    corners, stats = _prepare("build_morton", vertices, faces)
    if corners.shape[0] <= DENSE:
        return Tree(corners=corners, stats=stats)
    nodes, leaves = _join(corners)
    return Tree(corners=corners, stats=stats, nodes=nodes, leaves=leaves)


@jax.jit
def _join(corners):
    """Rows of nodes, the root first, and of leaves: neighbours on the curve, four at a time."""
    boxes = _boxes(corners)
    order = jnp.argsort(_morton(boxes)).astype(jnp.int32)
    order = jnp.where(boxes[order, 0] <= boxes[order, 3], order, -1)
    slots = jnp.pad(order, (0, -len(order) % WIDE), constant_values=-1).reshape(-1, WIDE)
    boxes = jnp.where((slots >= 0)[..., None], boxes[slots], jnp.array(EMPTY, jnp.float32)[None, None])
    child, sizes = -1 - jnp.arange(len(slots), dtype=jnp.int32), [len(slots)]
    while sizes[-1] > 1:
        sizes.append(-(-sizes[-1] // WIDE))

    rows = []
    for level, size in enumerate(sizes[1:], 2):
        boxes = jnp.concatenate([jnp.min(boxes[..., :3], axis=1), jnp.max(boxes[..., 3:], axis=1)], axis=-1)
        child = jnp.where(boxes[:, 0] <= boxes[:, 3], child, NONE)
        short = size * WIDE - len(boxes)
        boxes = jnp.concatenate([boxes, jnp.tile(jnp.array([EMPTY], jnp.float32), (short, 1))]).reshape(-1, WIDE, 6)
        child = jnp.pad(child, (0, short), constant_values=NONE).reshape(-1, WIDE)
        rows.append(_rows(boxes, child))
        child = sum(sizes[level:]) + jnp.arange(size, dtype=jnp.int32)
    return jnp.concatenate(rows[::-1]), _leaves(corners, slots)
