"""Rays against triangles by Embree, on the host and on all of its cores: what `trace(..., backend="embree")` calls.

Needs the package embreex, and arrays in the processor's memory. Embree's own tree is kept for the last few geometries,
found again by comparing them bit for bit; a geometry that changes with each call is built with each call. Rays start at
t_min: embreex knows no other way to say it, so that origins move by a rounding where it is not 0. Gradient: none.
"""

import concurrent.futures
import functools
import importlib
import os
import threading
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

KEPT = 4  # geometries whose trees are kept
SHARE = 2**14  # rays handed over at a time: what comes back then takes no fresh pages
FAR = 1e37  # Embree's own distance of nothing


class _Scene(NamedTuple):
    """Embree's scene of some triangles, and the faces of those that have an area."""

    corners: np.ndarray
    embree: Any
    face: np.ndarray


_scenes: list[_Scene] = []  # the latest first
_lock = threading.Lock()  # several devices may ask at once


def _scene(corners: np.ndarray) -> _Scene:
    """The scene of equal triangles, bit for bit, or a new one."""
    with _lock:
        equal = (s for s in _scenes if np.array_equal(s.corners.view(np.int32), corners.view(np.int32)))
        scene = next(equal, None) or _build(corners)
        _scenes[:] = [scene, *(other for other in _scenes if other is not scene)][:KEPT]
        return scene


def _build(corners: np.ndarray) -> _Scene:
    face = np.flatnonzero(np.any(corners != corners[:, :1], axis=(1, 2)))
    embree = importlib.import_module("embreex.rtcore_scene").EmbreeScene()
    if len(face):
        importlib.import_module("embreex.mesh_construction").TriangleMesh(embree, np.ascontiguousarray(corners[face]))
    return _Scene(corners.copy(), embree, face.astype(np.int32))


def _search(any_hit, _, out, *inputs):
    """Write lengths from t_min on, and faces, -1 for none, straight into the arrays that XLA gives out."""
    length, face = map(np.asarray, out)
    corners, *rays = map(np.asarray, inputs)
    scene = _scene(corners)
    if len(scene.face) == 0:
        face[:] = -1
        return

    def run(part):
        origin, direction, t_min, t_max = (values[part] for values in rays)
        if t_min.any():
            origin = origin + t_min[:, None] * direction
        reach = np.minimum(t_max - t_min, FAR)
        if any_hit:
            # Nobody asks how far away it is.
            face[part] = scene.embree.run(origin, direction, reach, query="OCCLUDED")
            return
        hits = scene.embree.run(origin, direction, reach, output=True)
        length[part], ids = hits["tfar"], hits["primID"]
        face[part] = ids if len(scene.face) == len(corners) else np.where(ids >= 0, scene.face[ids], -1)

    # embreex lets go of the interpreter while it traces.
    parts = (slice(start, start + SHARE) for start in range(0, len(face), SHARE))
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(run, parts))


def trace_embree(corners, origin, direction, t_min, t_max, any_hit: bool):
    """Faces, -1 for none, and t of rays `[n]` against triangles of corners `[f, 3, 3]`; all numbers finite but t_max.

    A ray whose t_max is not above its t_min hits nothing. Raises `ImportError` in one line where embreex is missing.
    """
    try:
        importlib.import_module("embreex")
    except ImportError:
        raise ImportError("backend 'embree' needs the package embreex: pip install 'jaxraster[rays]'") from None
    # Not pure_callback, which copies all inputs and results: an eighth of the time.
    shapes = tuple(jax.ShapeDtypeStruct(t_min.shape, dtype) for dtype in (jnp.float32, jnp.int32))
    search = buffer_callback(functools.partial(_search, any_hit), shapes, vmap_method="sequential")
    length, face = search(corners, origin, direction, t_min, t_max)
    return face, jnp.where(face >= 0, length + t_min, jnp.inf)
