"""Rays against triangles by Embree, on the host and on all of its cores: what `trace(..., backend="embree")` calls.

Needs the package embreex. Embree's own tree is kept for the last few geometries, found again by what they hold; a
geometry that changes with each call is built with each call. Rays start at t_min: embreex knows no other way to say it,
so that origins move by a rounding where it is not 0. Gradient: none.
"""

import concurrent.futures
import functools
import hashlib
import importlib
import os

import jax
import jax.numpy as jnp
import numpy as np

from ..math.pair import pair

KEPT = 4  # geometries whose trees are kept
SHARE = 2**14  # rays handed over at a time: what comes back then takes no fresh pages
FAR = 1e37  # Embree's own distance of nothing


class _Corners:
    """Triangles that are equal where their bytes are."""

    def __init__(self, corners: np.ndarray):
        self.corners, self.digest = corners, hashlib.sha1(np.ascontiguousarray(corners).data).digest()

    def __hash__(self):
        return hash(self.digest)

    def __eq__(self, other):
        return self.digest == other.digest


@functools.lru_cache(KEPT)
def _scene(key: _Corners):
    """Embree's scene, and the faces of its triangles: those that have an area."""
    face = np.flatnonzero(np.any(key.corners != key.corners[:, :1], axis=(1, 2)))
    scene = importlib.import_module("embreex.rtcore_scene").EmbreeScene()
    key.corners = np.ascontiguousarray(key.corners[face])
    if len(face):
        importlib.import_module("embreex.mesh_construction").TriangleMesh(scene, key.corners)
    return scene, face.astype(np.int32)


def _search(corners, origin, direction, reach, count, *, any_hit):
    """Faces, -1 for none, and lengths from the origin, of the first `count` rays."""
    scene, names = _scene(_Corners(np.asarray(corners)))
    origin, direction, reach = (np.asarray(v) for v in (origin, direction, reach))
    num = min(len(reach), int(count))
    face, t = np.full(len(reach), -1, np.int32), np.full(len(reach), np.inf, np.float32)
    if num == 0 or len(names) == 0:
        return face, t

    def run(part):
        # Copy: it takes no arrays that may not be written.
        rays = tuple(np.array(values[part], np.float32) for values in (origin, direction, reach))
        if any_hit:
            face[part] = scene.run(*rays, query="OCCLUDED")
            return
        found = scene.run(*rays, output=True)
        hits = found["primID"]
        face[part] = hits if len(names) == len(corners) else np.where(hits >= 0, names[hits], -1)
        t[part] = found["tfar"]

    # embreex lets go of the interpreter while it traces.
    parts = (slice(start, min(start + SHARE, num)) for start in range(0, num, SHARE))
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(run, parts))
    return face, t


def trace_embree(corners, rays, count, any_hit: bool):
    """As `trace_tree`, of corners `[f, 3, 3]`, without steps to count; raises `ImportError` in one line."""
    try:
        importlib.import_module("embreex")
    except ImportError:
        raise ImportError("backend 'embree' needs the package embreex: pip install 'jaxraster[rays]'") from None
    num, t_min = rays.shape[0], rays[:, 6]
    shapes = jax.ShapeDtypeStruct((num,), jnp.int32), jax.ShapeDtypeStruct((num,), jnp.float32)
    search = functools.partial(_search, any_hit=any_hit)
    reach = jnp.minimum(rays[:, 7] - t_min, FAR)
    inputs = corners, rays[:, :3] + t_min[:, None] * rays[:, 3:6], rays[:, 3:6], reach
    face, t = jax.pure_callback(search, shapes, *inputs, count, vmap_method="sequential")
    return pair(t + t_min, face), count * 0
