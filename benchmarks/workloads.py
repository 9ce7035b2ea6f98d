"""What rasterizers are measured on: clip positions and faces of six scenes, the same for every program."""

import functools
import pathlib
import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

import jaxraster as jr
from jaxraster.geometry import shapes
from jaxraster.io.rig import frame_camera


class Workload(NamedTuple):
    """Clip positions `[v, 4]` with reversed depth, and faces `[f, 3]`."""

    clip: np.ndarray
    faces: np.ndarray


def _seen(mesh, camera, size: int) -> Workload:
    clip = jr.project(mesh.vertices, camera, height=size, width=size)
    return Workload(np.asarray(clip), np.asarray(mesh.faces))


def _sphere(subdivisions: int):
    def build(size: int) -> Workload:
        mesh = shapes.icosphere(1.0, subdivisions)
        return _seen(mesh, frame_camera(mesh), size)

    return build


def _cornell_box(size: int) -> Workload:
    scene, camera = jr.scenes.cornell_box()
    return _seen(scene.mesh, camera, size)


def _soup(size: int, *, count: int = 10_000, depth_complexity: float = 10.0) -> Workload:
    """Triangles of 5 to 40 px, placed so densely that ten of them cover a pixel on average, at random depths."""
    rng = np.random.default_rng(0)
    side = np.exp(rng.uniform(np.log(5.0), np.log(40.0), count))
    angle = rng.uniform(0, 2 * np.pi, (count, 1)) + np.array([0, 2, 4]) * np.pi / 3
    shape = side[:, None, None] / np.sqrt(3) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    # An equilateral triangle covers √3/4 of its side's square.
    area = np.sqrt(3) / 4 * np.sum(side**2)
    extent = min(size, np.sqrt(area / depth_complexity))
    centre = size / 2 + rng.uniform(-extent / 2, extent / 2, (count, 1, 2))
    points = (centre + shape) * (2.0 / size) - 1.0
    depth = np.broadcast_to(rng.uniform(0.1, 0.9, (count, 1, 1)), (count, 3, 1))
    clip = np.concatenate([points, depth, np.ones_like(depth)], axis=-1).reshape(-1, 4)
    return Workload(clip.astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))


@functools.cache
def _load(path: pathlib.Path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return jr.load(path)


def _file(path: pathlib.Path):
    """A workload of a file, seen by the camera that frames it."""

    def build(size: int) -> Workload:
        scene, camera = _load(path)
        return _seen(scene.mesh, camera, size)

    return build


WORKLOADS = {
    "W1 sphere of 1,280 faces": _sphere(3),
    "W2 sphere of 81,920 faces": _sphere(6),
    "W3 sphere of 327,680 faces": _sphere(7),
    "W5 Cornell box": _cornell_box,
    "W6 10,000 triangles of 5 to 40 px": _soup,
}


def with_files(**files: pathlib.Path | None) -> dict[str, Callable[[int], Workload]]:
    """All workloads in order, the ones named (W4, W5) being files: a function of the picture's size for each."""
    given = {f"{number} {path.stem}": _file(path) for number, path in files.items() if path}
    generated = {name: build for name, build in WORKLOADS.items() if not files.get(name.split()[0])}
    return dict(sorted((generated | given).items()))
