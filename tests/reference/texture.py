"""Texture lookup's twin in NumPy: double precision and true remainders."""

import numpy as np

REPEAT, CLAMP, MIRROR = 0, 1, 2


def wrapped(index: np.ndarray, size: np.ndarray, wrap: np.ndarray) -> np.ndarray:
    """The texel that stands at any whole number."""
    mirrored = np.mod(index, 2 * size)
    mirrored = np.where(mirrored < size, mirrored, 2 * size - 1 - mirrored)
    clamped = np.clip(index, 0, size - 1)
    return np.where(wrap == REPEAT, np.mod(index, size), np.where(wrap == CLAMP, clamped, mirrored)).astype(np.int64)


def bilinear(texels: np.ndarray, level: np.ndarray, uv: np.ndarray, wrap: np.ndarray) -> np.ndarray:
    """Four texels of one level (offset, width, height) around uv, weighed by the distance to their centres."""
    offset, size = level[..., :1], level[..., 1:]
    # Two periods hold an image and its mirror; farther away the fraction would drown even in double precision.
    uv = np.where(wrap == CLAMP, np.clip(uv, 0, 1), np.mod(uv, 2))
    place = uv * size - 0.5
    first = np.floor(place)
    weight = place - first
    total = 0.0
    for right in (0, 1):
        for down in (0, 1):
            step = np.array([right, down])
            texel = wrapped(first + step, size, wrap)
            share = np.where(step == 1, weight, 1 - weight).prod(axis=-1)
            total = total + share[..., None] * texels[offset[..., 0] + texel[..., 1] * size[..., 0] + texel[..., 0]]
    return total


def level_of_detail(footprint: np.ndarray, size: np.ndarray, deepest: int) -> np.ndarray:
    """log₂ of the longer of the two steps in texels, within the levels there are."""
    steps = np.hypot(*np.moveaxis(footprint * size[..., :, None], -2, 0)).max(axis=-1)
    return np.clip(np.log2(np.maximum(steps, 1.0)), 0, deepest)


def texture(textures, index: np.ndarray, uv: np.ndarray, footprint: np.ndarray) -> np.ndarray:
    """Trilinear RGBA, white for index -1; what is not finite in uv counts as 0."""
    texels, levels, wrap = (np.asarray(a) for a in (textures.texels, textures.levels, textures.wrap))
    texels, uv, footprint = (np.asarray(a, np.float64) for a in (texels, uv, footprint))
    present, index = index >= 0, np.maximum(index, 0)
    uv = np.where(np.isfinite(uv), uv, 0.0)
    deepest = levels.shape[1] - 1
    lod = level_of_detail(footprint, levels[index, 0, 1:].astype(np.float64), deepest)
    finer = np.floor(lod).astype(np.int64)
    blend = (lod - finer)[..., None]
    near = bilinear(texels, levels[index, finer], uv, wrap[index])
    far = bilinear(texels, levels[index, np.minimum(finer + 1, deepest)], uv, wrap[index])
    return np.where(present[..., None], (1 - blend) * near + blend * far, 1.0)
