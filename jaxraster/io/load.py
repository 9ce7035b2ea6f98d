"""Any supported file as a scene and a camera, and pictures back to files."""

import os
import warnings
from collections.abc import Iterable

import numpy as np

from ..errors import AssetWarning, InputError, UsageError
from ..scene import Camera, Scene
from .disk import Path
from .gltf import read_gltf
from .image import write_image
from .mesh import read_mesh
from .rig import frame_camera, key_direction, key_light, sky

READERS = dict.fromkeys((".gltf", ".glb"), read_gltf) | dict.fromkeys((".obj", ".ply", ".stl", ".off"), read_mesh)


def load(path: Path, *, camera: int = 0, light_direction: Iterable | None = None) -> tuple[Scene, Camera]:
    """The scene in a glTF, OBJ, PLY, STL or OFF file, and its `camera`-th camera.

    A file without cameras gets one that frames it. A file with lights has these alone; one without gets a warm key
    light from the camera's upper left and a two-tone environment. `light_direction`, three numbers along which the
    light travels, replaces all lights by such a rig. What is ignored is said by one `AssetWarning` each.
    """
    file, suffix = os.fspath(path), os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in READERS:
        found = f"unknown model format {suffix!r}" if suffix else "no suffix to tell the model's format"
        raise InputError(file, "", f"{found}; known are {', '.join(READERS)}")
    if light_direction is not None:
        light_direction = np.asarray(light_direction, np.float64)
        if light_direction.shape != (3,) or not np.isfinite(light_direction).all() or not light_direction.any():
            raise UsageError(None, "light_direction", f"expected three numbers, not all zero, got {light_direction}")
    asset = READERS[suffix](path)
    for note in asset.notes:
        warnings.warn(f"{file}: {note}", AssetWarning, stacklevel=2)

    cameras = asset.cameras or (frame_camera(asset.mesh),)
    if not 0 <= camera < len(cameras):
        raise UsageError(file, "", f"camera {camera} is not there; the file has {len(asset.cameras)}, counted from 0")
    view = cameras[camera]
    if light_direction is None and asset.lights is not None:
        lights, environment = asset.lights, sky(0.0)
    else:
        lights = key_light(key_direction(view) if light_direction is None else light_direction)
        environment = sky()
    scene = Scene(
        mesh=asset.mesh, materials=asset.materials, textures=asset.textures, lights=lights, environment=environment
    )
    return scene, view


def save(path: Path, image) -> None:
    """Write a display-encoded picture as PNG or JPEG; see `write_image`."""
    write_image(path, image)
