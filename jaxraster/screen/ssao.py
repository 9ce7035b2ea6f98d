"""Ambient occlusion by random points: how many of those in the normal's hemisphere lie behind what is seen there.

V = (1 - Σ occluded / samples)^intensity, occluded being a point p + r ω that is farther away than the surface at its
pixel, unless that surface lies more than the radius before p, then less and less up to twice the radius. Directions ω
are spread as the cosine, distances r evenly, and both are turned about the normal at each pixel of a tile of 4 × 4,
which `denoise` brings together. What is outside of the picture occludes nothing. Background is 1. Does not affect:
direct light.

The classic, for comparison: `horizon` is exact where this is not, and faster.

Gradient: exact in `intensity`; that of `occlusion` in all else, which is compared, not measured.
Source: Mittring 2007, "Finding next gen"; Filion & McNaughton 2008 (hemisphere, range check). Cosine and 0 for what is
outside are ours.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Occlusion, Surface
from ..math import safe
from ..math.sampling import cosine_hemisphere
from ..math.sobol import sobol
from ..math.table import fetch
from ..math.transform import frame
from ..record import Scalar, record, static
from ..scene import Camera
from .border import remaining
from .height_field import HeightField, Planes, pixel_of, pixels, places
from .occlusion import on_screen
from .sweep import ORDER, PHASES, TILE

MOST_SAMPLES = 1024  # as many fetches of each pixel; more hardly differ


@record
class SSAO:
    """`radius` in metres; `bias` is the share of it by which a point must lie behind what is seen; `samples` points.

    What occludes counts less and less over the last `edge` heights of the picture before its border; 0 for not so.
    """

    radius: Scalar = 0.25
    bias: Scalar = 0.05
    intensity: Scalar = 1.0
    edge: Scalar = 0.0
    samples: int = static(default=16)

    def validate(self):
        """Raise one clear line for a count that means nothing."""
        if type(self.samples) is not int or not 1 <= self.samples <= MOST_SAMPLES:
            raise ValueError(f"SSAO.samples must be a whole number from 1 to {MOST_SAMPLES}, got {self.samples!r}")


def _points(samples: int, dtype) -> Float[Array, "s 3"]:
    """Points of the unit hemisphere about +Z."""
    number = jnp.arange(samples, dtype=jnp.uint32)
    direction, _ = cosine_hemisphere(sobol(number, jnp.uint32(0)).astype(dtype))
    return direction * ((number.astype(dtype) + 0.5) / samples)[:, None]


def _estimate(field: HeightField, settings: SSAO) -> Planes:
    height, width = field.mask.shape
    radius = settings.radius / field.unit
    per_radius = 1.0 / jnp.maximum(radius, safe.TINY)
    here = places(field)
    normal = jnp.stack(field.normal, axis=-1)
    tangent, bitangent = (tuple(axis[..., k] for k in range(3)) for axis in frame(normal))
    column, line = (place.astype(jnp.int32) for place in pixels(field))
    angle = fetch(jnp.asarray(2 * np.pi * ORDER / PHASES, field.depth.dtype), line % TILE * TILE + column % TILE)
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    band = settings.edge * height
    seen = jnp.where(field.mask, field.depth, jnp.inf).reshape(-1)

    def add(total, point):
        occluded, *hidden = total
        a, b = cosine * point[0] - sine * point[1], sine * point[0] + cosine * point[1]
        offset = [a * t + b * s + point[2] * n for t, s, n in zip(tangent, bitangent, field.normal)]
        column, line, depth = pixel_of(field, tuple(p + radius * o for p, o in zip(here, offset)))
        inside = (column > -0.5) & (column < width - 0.5) & (line > -0.5) & (line < height - 0.5)
        column, line = (jnp.clip(jnp.round(c), 0, n - 1) for c, n in ((column, width), (line, height)))
        before = fetch(seen, line.astype(jnp.int32) * width + column.astype(jnp.int32))
        near = jnp.clip(2.0 - (field.depth - before) * per_radius, 0.0, 1.0)
        behind = jnp.where(inside & (depth > before + settings.bias * radius), near, 0.0)
        behind = behind * jnp.minimum(remaining(column, width, band), remaining(line, height, band))
        length = behind / safe.length(point)
        return (occluded + behind, *(total + length * o for total, o in zip(hidden, offset))), None

    zero = jnp.zeros_like(field.depth)
    points = _points(settings.samples, field.depth.dtype)
    occluded, *hidden = lax.scan(add, (zero,) * 4, points)[0]
    # All of a hemisphere has a mean of two thirds of its normal.
    bend = (-1.5 / settings.samples * part for part in hidden)
    return 1.0 - occluded / settings.samples, zero + 1.0, *bend


@jax.jit
def ssao(surface: Surface, camera: Camera, settings: SSAO) -> Occlusion:
    """How much of the ambient light reaches every pixel, and from where; see `Occlusion`."""
    found = on_screen(surface, camera, settings, _estimate)
    # The power of what is not 0: its slope in the exponent is finite.
    light = jnp.maximum(found.visibility, safe.TINY) ** settings.intensity
    return replace(found, visibility=jnp.where(surface.mask, light, 1.0))
