"""Any supported file as a scene and a camera, or as light, and pictures back to files."""

import os
import warnings
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from ..errors import AssetWarning, InputError, LimitError, UsageError
from ..scene import Camera, Scene
from ..stack import stack_lights
from .disk import Path, check_file, suffix_of
from .environment import Surroundings, surroundings
from .exr import check_exr, write_exr
from .gltf import read_gltf
from .image import check_writable, write_image
from .mesh import read_mesh
from .radiance import write_hdr
from .reading import DEFAULT, Limits, Reading
from .rig import frame_camera, key_direction, key_light, sky

READERS = dict.fromkeys((".gltf", ".glb"), read_gltf) | dict.fromkeys((".obj", ".ply", ".stl", ".off"), read_mesh)


def load(
    path: Path,
    *,
    camera: int = 0,
    light_direction: Iterable | None = None,
    environment: Surroundings | None = None,
    repair: bool = False,
    strict: bool = False,
    limits: Limits | None = None,
) -> tuple[Scene, Camera]:
    """The scene in a glTF, OBJ, PLY, STL or OFF file, and its `camera`-th camera.

    A file without cameras gets one that frames it. A file with lights has these alone; one without gets a warm key
    light from the camera's upper left and a two-tone environment. `light_direction`, three numbers along which the
    light travels, replaces all lights by such a rig. What is ignored is said by one `AssetWarning` each.

    `environment` takes the place of those surroundings, and a file without lights is then lit by it alone: a path to a
    picture of all directions (.hdr, .exr; see `read_environment`), "sky" for a clear one with its sun, an
    `EnvironmentMap`, an `Environment`, or radiance (linear Rec.709, cd/m²): a grey, a colour of three numbers, or two
    colours, of the sky and of the ground.

    What is broken raises an `InputError`; `repair` drops it instead and counts it in a warning, `strict` refuses even
    what could be put right, in the surroundings too. More than the `limits` allow raises a `LimitError` that names the
    limit.
    """
    file, suffix = os.fspath(path), suffix_of(path)
    if suffix not in READERS:
        found = f"unknown model format {suffix!r}" if suffix else "no suffix to tell the model's format"
        raise InputError(file, "", f"{found}; known are {', '.join(READERS)}")
    if type(camera) is not int:
        raise TypeError(f"load: camera must be a whole number, got {camera!r}")
    if light_direction is not None:
        light_direction = _direction(light_direction)
    try:
        asset = READERS[suffix](path, Reading(repair=repair, strict=strict, limits=limits))
    except MemoryError as error:
        raise LimitError(file, "", "does not fit into memory; scale its pictures down, or split it") from error
    for note in asset.notes:
        warnings.warn(f"{file}: {note}", AssetWarning, stacklevel=2)

    cameras = asset.cameras or (frame_camera(asset.mesh),)
    if not 0 <= camera < len(cameras):
        has = (
            f"the file has {len(asset.cameras)}, counted from 0" if asset.cameras else "the file has none; leave it out"
        )
        raise UsageError(file, "", f"camera {camera} is not there; {has}")
    view = cameras[camera]
    lights, around = asset.lights, None
    if environment is not None:
        around, notes = surroundings(environment, strict=strict, limits=limits or DEFAULT)
        for note in notes:
            warnings.warn(note, AssetWarning, stacklevel=2)
    if light_direction is not None or (lights is None and around is None):
        lights = key_light(key_direction(view) if light_direction is None else light_direction)
        around = around or sky()
    lights, around = lights or stack_lights(), around or sky(0.0)
    scene = Scene(
        mesh=asset.mesh, materials=asset.materials, textures=asset.textures, lights=lights, environment=around
    )
    return scene, view


def _direction(given: Iterable) -> Float[np.ndarray, "3"]:
    """Three numbers as a vector whose largest component is 1, so that its length neither overflows nor vanishes."""
    try:
        direction = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        direction = np.zeros(0)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise UsageError(None, "light_direction", f"expected three numbers, not all zero, got {given!r:.60}")
    return direction / np.abs(direction).max()


LINEAR = (".hdr", ".exr")  # the suffixes of files that hold light, not codes for a display


def is_linear(path: Path) -> bool:
    """Whether `save` writes linear light there."""
    return suffix_of(path) in LINEAR


def check_save(path: Path) -> None:
    """Raise the `OutputError` that `save` would end in, as far as it can be known before rendering."""
    if not is_linear(path):
        check_writable(path)
    elif suffix_of(path) == ".exr":
        check_exr(path)
    else:
        check_file(path)


def save(path: Path, image) -> None:
    """Write a display-encoded picture as PNG or JPEG, or linear radiance as .hdr or .exr, as the suffix says.

    See `write_image`, `write_hdr` and `write_exr`, which takes any channels; here it gets R, G, B and perhaps A.
    """
    suffix = suffix_of(path)
    if suffix == ".hdr":
        write_hdr(path, image)
    elif suffix == ".exr":
        image = np.asarray(image)
        if image.ndim != 3 or image.shape[2] not in (3, 4):
            raise ValueError(f"image: expected [h, w, 3] or [h, w, 4], got shape {list(image.shape)}")
        write_exr(path, {name: image[..., i] for i, name in enumerate("RGBA"[: image.shape[2]])})
    else:
        write_image(path, image)
