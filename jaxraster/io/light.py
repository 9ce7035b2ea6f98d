"""Pictures of linear light from files, with what no renderer can stand put right and counted."""

import os

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from .asset import LARGEST
from .disk import Path, suffix_of
from .exr import read_exr_light
from .radiance import read_hdr
from .reading import DEFAULT, Limits

SUFFIXES = (".hdr", ".pic", ".exr")


def read_light(path: Path, limits: Limits = DEFAULT) -> tuple[Float[np.ndarray, "h w 3"], tuple[str, ...]]:
    """Linear radiance in a Radiance (.hdr, .pic) or EXR file, finite and not negative, and what was put right.

    Texels that are not finite become black, negative values 0, values above 1.844e18 that: each noted with its count.
    """
    file, suffix = os.fspath(path), suffix_of(path)
    if suffix in (".hdr", ".pic"):
        light, notes = read_hdr(path, limits), ()
    elif suffix == ".exr":
        light, notes = read_exr_light(path, limits)
    else:
        raise InputError(file, "", f"unknown format of light {suffix!r}; known are {', '.join(SUFFIXES)}")

    lost = ~np.isfinite(light).all(axis=-1, keepdims=True)
    light = np.where(lost, np.float32(0), light)
    counts = {
        "are not finite; they become black": lost,
        "are negative; they become 0": (light < 0).any(axis=-1),
        f"are above {LARGEST:g}; they become that": (light > LARGEST).any(axis=-1),
    }
    notes += tuple(f"{mask.sum()} of {mask.size} texels {what}" for what, mask in counts.items() if mask.any())
    if not light.any():
        notes += ("it is black all over",)
    return np.clip(light, 0, np.float32(LARGEST)), notes
