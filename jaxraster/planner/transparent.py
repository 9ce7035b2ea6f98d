"""Whether what is marked as transparent can be seen through anywhere: a proof on the host, on concrete alphas.

A material's opacity is its factor times a texel mix times a vertex colour mix, so it lies between the products of their
least and of their greatest values. Gradient: none, plain NumPy.
"""

import math
from typing import Any

import numpy as np

from ..scene import Scene

ROUNDING = 1e-6  # mixes of texels and of corners are off by some float32 roundings of numbers up to 1


def opacity_bounds(scene: Scene, row: int) -> tuple[float, float]:
    """The least and the greatest opacity that a row of materials may have on any of its faces; concrete leaves."""
    ranges = [_range(scene.materials.base_color[..., row, 3])]
    texture = scene.materials.base_color_texture[row]
    if texture >= 0:
        levels = [scene.textures.texels[..., o : o + w * h, 3] for o, w, h in scene.textures.levels[texture].tolist()]
        ranges.append(_range(np.concatenate(levels, axis=-1)))
    if scene.mesh.colors is not None:
        ranges.append(_range(scene.mesh.colors[..., scene.mesh.faces[scene.mesh.material == row], 3]))
    least, greatest = zip(*ranges)
    return math.prod(least), math.prod(greatest)


def _range(values: Any) -> tuple[float, float]:
    """The least and the greatest value."""
    return float(np.min(values)), float(np.max(values))


def cut_out(scene: Scene, row: int, cutoff: float) -> bool:
    """Whether a masked material may have holes."""
    least, _ = opacity_bounds(scene, row)
    return not least >= cutoff + ROUNDING


def shows_through(scene: Scene, row: int) -> bool:
    """Whether a blended material may let anything through."""
    least, greatest = opacity_bounds(scene, row)
    return not (least >= 1.0 and greatest <= 1.0)
