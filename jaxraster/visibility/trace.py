"""What rays hit first, or whether they hit anything: `trace` and `occluded`, for thousands to millions of rays.

Few triangles are all tested against every ray (`trace_dense`); a tree is walked by streams of rays (`trace_tree`), or
handed to Embree (`trace_embree`). All loops are of dynamic length over chunks of fixed size, and batches run one after
the other. Against few triangles, results do not depend on what is traced together, but for triangles seen exactly
edge-on, which rounding may accept from beside. Neighbours should stand near each
other in the arrays: rays of a picture in its order, shadow rays in that of their places.

Gradient: none, on purpose: `stop_gradient` stands in `_hits`. What has one is recomputed from the face, by
`geometry.intersect.intersection`.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..check import fit_record
from ..geometry.bvh import Tree
from ..geometry.intersect import LIMIT, Rays, check_rays, main_axis
from ..math import safe
from ..math.pair import pair, unpair
from ..math.scan import partition
from ..math.table import fetch
from ..record import record
from .trace_dense import trace_dense
from .trace_embree import trace_embree
from .trace_tree import trace_tree

BACKENDS = "jax", "embree"


@record
class Hits:
    """Of each ray the face that it hits first, -1 for none, and where, in lengths of its direction, inf for none.

    Faces hit at equal t: the lowest id.
    """

    face: Int[Array, "*b"]
    t: Float[Array, "*b"]


def _by_axis(axis, *rays):
    """Rays' numbers, ordered by axis, those of none last, where each axis' rays start, and which ray is where."""
    order, starts = partition(axis)
    rows = fetch(jnp.concatenate([part.reshape(len(axis), -1) for part in rays], axis=1), order)
    return tuple(rows[:, k] for k in range(rows.shape[1])), starts[:4], order


def _as_they_are(axis, *rays):
    """The same for rays of one axis, as most pictures' are: nothing to sort and to count."""
    starts = jnp.where(jnp.arange(4, dtype=jnp.int32) <= axis[0], 0, axis.shape[0])
    columns = (part.reshape(len(axis), -1) for part in rays)
    order = jnp.arange(axis.shape[0], dtype=jnp.int32) + axis * 0
    return tuple(part[:, k] for part in columns for k in range(part.shape[1])), starts, order


def _search(origin, direction, t_min, t_max, tree, any_hit, backend):
    """Faces and t of rays `[n]`, and how many steps it took."""
    num, longest = len(t_min), jnp.max(jnp.abs(direction), axis=1)
    usable = jnp.all(jnp.abs(origin) < LIMIT, axis=1) & (longest > safe.TINY) & (longest < 1.0 / safe.TINY)
    # Not so for NaN.
    usable = usable & (t_min < t_max)
    if backend == "embree" and tree.nodes is not None:
        # Of a ray that cannot hit, leave no number that is none.
        origin, direction = (jnp.where(usable[:, None], v, 1.0) for v in (origin, direction))
        t_min, t_max = jnp.where(usable, t_min, 0.0), jnp.where(usable, t_max, -1.0)
        face, t = trace_embree(tree.corners, origin, direction, t_min, t_max, any_hit)
        # Of those, embreex calls some occluded.
        return jnp.where(usable, face, -1), t, jnp.int32(0)

    # Order rays by the axis that they mostly follow, and leave out those that can hit nothing.
    axis = jnp.where(usable, main_axis([direction[:, k] for k in range(3)]), -1)
    one = jnp.all(axis == axis[0]) & usable[0]
    rays, starts, order = lax.cond(one, _as_they_are, _by_axis, axis, origin, direction, t_min, t_max)
    if tree.nodes is None:
        hits, steps = trace_dense(tree.corners, rays, starts, any_hit)
    else:
        hits, steps = trace_tree(tree.nodes, tree.leaves, rays, starts[3], any_hit)

    def back(hits):
        place = jnp.where(jnp.arange(num, dtype=jnp.int32) < starts[3], order, num)
        return pair(jnp.full(num, jnp.inf), order * 0 - 1).at[place].set(hits, mode="drop")

    hits = lax.cond(one, lambda hits: hits, back, hits)
    face = unpair(hits)[1]
    return face, jnp.where(face >= 0, lax.real(hits), jnp.inf), steps


@functools.cache
def _core(any_hit: bool, backend: str):
    """The compiled search; batches run one after the other, in loops of their own length."""
    search = functools.partial(_search, any_hit=any_hit, backend=backend)
    return jax.custom_batching.sequential_vmap(jax.jit(search))


def _hits(where, rays, tree, any_hit, backend):
    """Checked, flattened, searched: faces, t and steps."""
    origin, direction, t_min, t_max = check_rays(f"{where}: rays", rays)
    shape = t_min.shape
    fit_record(f"{where}: tree", tree, Tree)
    if backend not in BACKENDS:
        raise ValueError(f"{where}: backend must be one of {BACKENDS}, got {backend!r}")
    parts = origin.reshape(-1, 3), direction.reshape(-1, 3), jnp.maximum(t_min, 0.0).reshape(-1), t_max.reshape(-1)
    if parts[2].shape[0] == 0 or tree.corners.shape[0] == 0:
        return jnp.full(shape, -1, jnp.int32), jnp.full(shape, jnp.inf, jnp.float32), jnp.int32(0)
    parts, tree = lax.stop_gradient(([part.astype(jnp.float32) for part in parts], tree))
    face, t, steps = _core(any_hit, backend)(*parts, tree)
    return face.reshape(shape), t.reshape(shape), steps


def trace(rays: Rays, tree: Tree, *, backend: str = "jax") -> Hits:
    """The first face that each ray hits, from either side.

    Args:
        tree: of `build` or `build_morton`.
        backend: "jax", or "embree" for Embree, with arrays of the CPU and the package embreex installed: several times
            as fast with a tree, without promises about edges, ties and small t_min; a hit at t_max itself counts there.
            Few triangles are always tested here.

    Closed surfaces have no gaps: a ray through an edge or corner hits one of the faces there. Embree's rounding is
    its own.
    Gradient: none; see `intersection`.

    Example:
        >>> from jaxraster.geometry.bvh import build
        >>> tree = build(jnp.eye(3), jnp.array([[0, 1, 2]]))
        >>> hits = trace(Rays(origin=jnp.zeros((2, 3)), direction=jnp.array([[1.0, 1.0, 2.0], [-1.0, 0.0, 0.0]])), tree)
        >>> hits.face.tolist(), hits.t.tolist()
        ([0, -1], [0.25, inf])
    """
    face, t, _ = _hits("trace", rays, tree, False, backend)
    return Hits(face=face, t=t)


def occluded(rays: Rays, tree: Tree, *, backend: str = "jax") -> Bool[Array, "*b"]:
    """Whether each ray hits anything: where `trace` finds a face, and found without looking for the first one.

    Gradient: none.

    Example:
        >>> from jaxraster.geometry.bvh import build
        >>> tree = build(jnp.eye(3), jnp.array([[0, 1, 2]]))
        >>> rays = Rays(origin=jnp.zeros((2, 3)), direction=jnp.ones((2, 3)), t_max=jnp.array([0.3, 0.4]))
        >>> occluded(rays, tree).tolist()
        [False, True]
    """
    return _hits("occluded", rays, tree, True, backend)[0] >= 0
