"""Suns in a picture of all directions, taken out of it to become directional lights.

A sun holds half of a clear sky's light in less than a ten thousandth of a steradian. Blurred from texels it would be
bands and blots; as a light of its own it is exact, and casts a shadow. What is cut is what lies above its surroundings,
so that picture and lights together give the light that the picture gave, in every channel.

Runs on the host, because how many suns there are is a shape, on which programs depend. Gradient: none through the cut.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math.rec709 import XYZ_FROM_LINEAR
from ..scene import Directional
from .equirect import solid_angles

# Times the mean luminance of all directions: a photograph's glare about its sun ends near 100, in which the disc itself
# is 1e4 to 1e5, whereas overcast skies, windows and bright walls stay below 30.
STRONG = 100.0
RADIUS = np.radians(3.0)  # of a sun with its glare; what is larger has an area, which a blur shows well
SHARE = 0.01  # of all light, below which a shadow would hardly show
SMALLEST = 1e-30  # sr, for what lies around a sun where nothing is known of it: black takes the sun's place


def _towards(row, column, height, width):
    """Unit directions of texel centres, of some texels alone: of all, in double precision, they would fill memory."""
    theta, phi = (row + 0.5) * (np.pi / height), ((column + 0.5) / width - 0.5) * (2.0 * np.pi)
    parts = np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def _surroundings(texels, bands, strong, center, reach):
    """The mean of what lies around a sun that reaches so far from its middle, one and a half texels wide."""
    height, width, _ = texels.shape
    reach, theta = min(reach + 1.5 * np.pi / height, np.pi), np.arccos(np.clip(center[1], -1.0, 1.0))
    top, bottom = np.clip(np.array([theta - reach, theta + reach]) * (height / np.pi), 0, height).astype(int)
    rows = slice(top, bottom + 1)
    towards = _towards(np.arange(height)[rows, None], np.arange(width)[None], height, width)
    near = (towards @ center > np.cos(reach)) & ~strong[rows] & np.isfinite(texels[rows]).all(axis=-1)
    weight = near * bands[rows, None]
    return np.einsum("hw,hwc->c", weight, np.where(near[..., None], texels[rows], 0.0)) / max(weight.sum(), SMALLEST)


def cut_suns(
    texels: Float[np.ndarray, "h w 3"] | Float[Array, "h w 3"], most: int = 4
) -> tuple[Float[np.ndarray, "h w 3"], Directional]:
    """The texels without their suns, and those, the strongest first, in the coordinates of the picture.

    A sun is all that is STRONG about a bright texel, if it lies within RADIUS of its middle, nothing as strong lies
    around it, and it gives a SHARE of all light. Its direction is the centroid of its light, its irradiance (lx) what
    is cut. There are `most` of them at most; a picture with none comes back as it is. Texels that are not finite count
    for nothing.

    Example:
        >>> texels = np.ones((64, 128, 3), np.float32)
        >>> texels[20, 64] = 1e5
        >>> left, suns = cut_suns(texels)
        >>> left.max().item(), suns.irradiance.shape, suns.direction[0].round(1).tolist()
        (1.0, (1, 3), [-0.800000011920929, -0.5, -0.0])
    """
    given = np.asarray(texels)
    height, width, _ = given.shape
    bands = np.asarray(solid_angles(height, width), np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        luminance = given @ XYZ_FROM_LINEAR[1].astype(given.dtype)
    luminance = np.where(np.isfinite(luminance), luminance, 0.0)
    total = luminance.sum(axis=1, dtype=np.float64) @ bands
    strong = luminance > STRONG / (4.0 * np.pi) * total
    row, column = np.nonzero(strong)
    towards, power = _towards(row, column, height, width), luminance[strong] * bands[row]

    left, found, open = given.copy(), [], np.ones(len(row), bool)
    while open.any() and len(found) < most:
        # Start anew from the middle of what is about the brightest texel, which may lie at the edge of a sun.
        brightest = np.argmax(np.where(open, luminance[strong], -1.0))
        around = open & (towards @ towards[brightest] > np.cos(2.0 * RADIUS))
        center = power[around] @ towards[around]
        center /= np.linalg.norm(center)
        cosine = towards @ center
        cut, spread = (cosine > np.cos(r) for r in (RADIUS, 2.0 * RADIUS))
        open &= ~(around | spread)
        if (around | spread).sum() > cut.sum() or power[cut].sum() < SHARE * total:
            continue
        reach = np.arccos(np.clip(cosine[cut].min(), -1.0, 1.0))
        light = given[row[cut], column[cut]].astype(np.float64)
        removed = np.maximum(light - _surroundings(given, bands, strong, center, reach), 0.0)
        left[row[cut], column[cut]] = light - removed
        found.append((-center, bands[row[cut]] @ removed))
    if not found:
        return given, Directional(direction=jnp.zeros((0, 3)), irradiance=jnp.zeros((0, 3)))
    direction, irradiance = (jnp.asarray(np.array(each, np.float32)) for each in zip(*found))
    return left, Directional(direction=direction, irradiance=irradiance)
