"""Pictures of linear light from files, with what no renderer can stand put right and counted."""

import os

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .asset import LARGEST
from .disk import Path, read_file, suffix_of
from .exr import decode_exr_light
from .radiance import decode_hdr
from .reading import DEFAULT, Limits, Reading

SUFFIXES = (".hdr", ".pic", ".exr")
Light = tuple[Float[np.ndarray, "h w 3"], tuple[str, ...]]  # linear radiance, and notes on it


def check_light(path: Path) -> None:
    """Raise the `InputError` for a name that is none of a file of light."""
    suffix = suffix_of(path)
    if suffix not in SUFFIXES:
        found = f"unknown format of light {suffix!r}" if suffix else "no suffix to tell the format of light"
        raise InputError(os.fspath(path), "", f"{found}; known are {', '.join(SUFFIXES)}")


def decode_light(data: bytes, path: Path, limits: Limits = DEFAULT, *, strict: bool = False) -> Light:
    """What `read_light` returns, from the bytes of a file."""
    name, reading = os.fspath(path), Reading(strict=strict, limits=limits)
    light, notes = (
        decode_exr_light(data, name, limits) if suffix_of(path) == ".exr" else (decode_hdr(data, name, limits), ())
    )

    lost = ~np.isfinite(light).all(axis=-1, keepdims=True)
    light = np.where(lost, np.float32(0), light)
    counts = {
        "are not finite; they become black": lost,
        "are negative; they become 0": (light < 0).any(axis=-1),
        f"are above {LARGEST:g}; they become that": (light > LARGEST).any(axis=-1),
    }
    for what, mask in counts.items():
        if mask.any():
            reading.mend(name, "", f"{mask.sum()} of {mask.size} texels {what}")
    if not light.any():
        reading.ignore("it is black all over")
    return np.clip(light, 0, np.float32(LARGEST)), notes + reading.notes()


def read_light(path: Path, limits: Limits = DEFAULT, *, strict: bool = False) -> Light:
    """Linear radiance in a Radiance (.hdr, .pic) or EXR file, finite and not negative, and what was put right.

    Texels that are not finite become black, negative values 0, values above 1.844e18 that: each noted with its count,
    or an `InputError` where `strict`.
    """
    check_light(path)
    return decode_light(read_file(path, limits), path, limits, strict=strict)
