"""Ambient occlusion from the horizons of the height field that is on the screen.

V = Σ_slices w ∫ (n·ω) sin θ dθ between both horizons, over the same without them: exactly 1 where nothing is in front
of the face's own plane, in however few slices and whatever the normal n that it is shaded with. A slice contains the
direction to the viewer and a line on the screen; w is how much of a turn about that direction it stands for, as lines
evenly spread on the screen are not so around an oblique ray. Horizons reach `radius` metres from the pixel. What is
outside of the picture, or hidden, occludes nothing. Background is 1. Does not affect: direct light.

Lines take the same steps at every fourth pixel (`sweep`), and 4 × 4 pixels are brought together (`denoise`), both sums
before one is divided by the other.

A place q = p + δ on the line lies at the angle θ from the viewer with cot θ = g / b, where, for unit ô along the line
and the unit ray r̂ from the eye, b² = 1 - (ô·r̂)², and g = |r| (z_p/z_q - 1) / |o| - ô·r̂ of the rays r and r + o at
z = -1. So the highest horizon is the greatest g, and nothing but z_q is looked up.

Gradient: that of `occlusion`: 0 in places, camera and settings; the bent normal moves with the normal.
Source: Jimenez, Wu, Pesce & Jarabo 2016, "Practical Real-Time Strategies for Accurate Indirect Occlusion" (slices,
arcs, thickness); Strugar & McCabe 2021, XeGTAO (fading towards the tangent plane, steps that grow). The
quotient, the weights of slices and cotangents in place of cosines are ours.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from ..buffers import Occlusion, Surface
from ..math.table import apart
from ..record import Scalar, record, static
from ..scene import Camera
from .arc import arc, mean_direction
from .border import remaining
from .height_field import HeightField, Planes, plane_at
from .occlusion import on_screen
from .sweep import PHASES, TILE, Sweep, margin, sweep, tiles, untiled

MOST_SLICES, MOST_STEPS = 64, 64  # more hardly differ, and steps are unrolled
# Where there is nothing, as a nearness in units: farther behind than any horizon, yet its square is finite.
NOWHERE = -1e6
# The least cosine between normal and viewer by which a tangent plane's horizon is found: 0.06° from the edge.
EDGE_ON = 1e-3
# The least share of the radius over which occlusion ends: a step would have no slope.
SHARPEST = 1e-3
# Squares of lengths that count as none: a thousandth of a pixel or a millionth of a normal, whose slopes stay finite.
FAINT = 1e-12


@record
class HorizonAO:
    """`radius` in metres: how far away something may be that occludes. Lines end at half of the picture's longer side,
    so that inf is for all that is on the screen that near.

    Over its last share `falloff`, in [0, 1], occlusion fades; 0 for none. `thickness` in [0, 1] is how soon light
    passes behind what stands before a line's further places: 0 for never, which is what a height field is, 1 at once.
    What occludes counts less and less over the last `edge` heights of the picture before its border; 0 for not so.

    `slices` lines are taken through each pixel, in `steps` to either side. They grow by equal ratios, up to as many
    pixels as the radius is anywhere in the picture: what is near leaves fewer to what is far. An edge between two of
    them is found beyond where it is: by default the foot of a wall is up to 0.03 too bright and the middle of a pit up
    to 0.16; by one slice of 16 steps 0.03 and 0.09, at the same price but with more noise where surfaces are small; by
    4 slices of 48 steps 0.03 and 0.03 (measured by the tests, without limits of radius).
    """

    radius: Scalar = 0.25
    falloff: Scalar = 0.0
    thickness: Scalar = 0.0
    edge: Scalar = 0.0
    slices: int = static(default=2)
    steps: int = static(default=8)

    def validate(self):
        """Raise one clear line for a count that means nothing."""
        for name, most in (("slices", MOST_SLICES), ("steps", MOST_STEPS)):
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= most:
                raise ValueError(f"HorizonAO.{name} must be a whole number from 1 to {most}, got {value!r}")


class _Tile(NamedTuple):
    """Each fourth pixel's |r| z_p, |r|, r̂, normal and n·v; |r| and -|r| z_p for a parallel projection.

    `slope` is of the face's plane: g + ô·r̂ of its places is the slope's product with ô.
    """

    scale: Array
    shift: Array
    ray: tuple[Array, ...]
    normal: tuple[Array, ...]
    n_dot_v: Array
    slope: tuple[Array, ...]


def _tile(field: HeightField, phase, depth, *normals) -> _Tile:
    column, line = (lax.broadcasted_iota(depth.dtype, depth.shape, axis) for axis in (1, 0))
    column, line = (
        TILE * at + offset.astype(depth.dtype) for at, offset in ((column, phase % TILE), (line, phase // TILE))
    )
    x, y = (jnp.where(field.perspective, part, 0.0) for part in plane_at(field, column, line))
    square = 1.0 + x * x + y * y
    shrink = lax.rsqrt(square)
    ray, stretch = (x * shrink, y * shrink, -shrink), square * shrink
    normal, face = normals[:3], normals[3:]
    n_dot_v, face_dot_v = (jnp.maximum(-sum(a * b for a, b in zip(n, ray)), 0.0) for n in (normal, face))
    slope = tuple(-part / jnp.maximum(face_dot_v, EDGE_ON) for part in face[:2])
    scale = jnp.where(field.perspective, stretch * depth, stretch)
    shift = jnp.where(field.perspective, stretch, -stretch * depth)
    scale, shift, ray, n_dot_v, slope = lax.optimization_barrier((scale, shift, ray, n_dot_v, slope))
    return _Tile(scale=scale, shift=shift, ray=ray, normal=normal, n_dot_v=n_dot_v, slope=slope)


def _slice(tile: _Tile, along) -> tuple[Array, Array, Array]:
    """ô·r̂ and b² of a direction, and g of the face's own plane."""
    aside = along[0] * tile.ray[0] + along[1] * tile.ray[1]
    return aside, 1.0 - aside * aside, along[0] * tile.slope[0] + along[1] * tile.slope[1] - aside


def _highest(field: HeightField, nearness, tile: _Tile, line: Sweep, kept, settings: HorizonAO):
    """The greatest g along a line, at least the face's plane's."""
    aside, out, plane = _slice(tile, line.along)
    # In squares of distances over the radius the weight is 1 up to (1 - falloff)² and 0 from 1 on.
    width = SHARPEST + 1.0 - (1.0 - settings.falloff) ** 2
    per_square = 1.0 / jnp.maximum(width * (settings.radius / field.unit) ** 2, FAINT)

    def look(place):
        return lax.dynamic_slice(nearness, tuple(place), (1, *aside.shape))[0]

    highest = plane
    for k in range(line.share.shape[0]):
        near = look(line.first[k])
        near = near + line.share[k] * (look(line.second[k]) - near)
        g = (tile.scale * near - tile.shift) * (1.0 / line.length[k]) - aside
        distance = line.length[k] * jnp.where(field.perspective, 1.0 / near, 1.0)
        weight = jnp.clip(1.0 / width - per_square * distance * distance * (out + g * g), 0.0, 1.0)
        # What is not there is no horizon, nor does light pass behind it.
        there = near > jnp.where(field.perspective, 0.0, 0.5 * NOWHERE)
        weight = jnp.where(there, weight * jnp.minimum(kept[0][k], kept[1][k]), 0.0)
        g = plane + weight * (g - plane)
        highest = jnp.maximum(g, highest + settings.thickness * (g - highest))
    return highest


def _kept(lines: Sweep, shape, height: int, width: int, edge) -> tuple[Array, Array]:
    """What counts of each step's occluders as far as the border is near: by columns, and by lines."""
    phase = np.arange(PHASES)[:, None, None, None]
    kept = []
    for axis, (first, count, size) in enumerate(((phase % TILE, shape[2], width), (phase // TILE, shape[1], height))):
        at = lines.offset[..., axis, None] + jnp.asarray(first + TILE * np.arange(count), lines.offset.dtype)
        kept.append(remaining(at, size, edge * height))
    return kept[0][..., None, :], kept[1][..., :, None]


def _arcs(tile: _Tile, along, ahead, behind):
    """Of a slice, what is seen of how much between its horizons, and the parts of the mean direction along v and d that
    the horizons take away.

    Without them all is seen that lies above both planes, the face's and the one perpendicular to the normal.
    """
    aside, out, plane = _slice(tile, along)
    n_dot_v = tile.n_dot_v
    n_dot_d = (tile.normal[0] * along[0] + tile.normal[1] * along[1] + aside * n_dot_v) * lax.rsqrt(out)
    tilt = n_dot_d * lax.rsqrt(jnp.maximum(n_dot_v * n_dot_v + n_dot_d * n_dot_d, FAINT))
    seen = whole = along_v = along_d = 0.0
    for side, g in ((1.0, ahead), (-1.0, behind)):
        least = jnp.clip(side * plane * lax.rsqrt(out + plane * plane), -side * tilt, 1.0)
        cosine = jnp.clip(g * lax.rsqrt(out + g * g), least, 1.0)
        seen, whole = (total + arc(n_dot_v, side * n_dot_d, c) for total, c in ((seen, cosine), (whole, least)))
        (v, d), (all_v, all_d) = (mean_direction(n_dot_v, side * n_dot_d, c) for c in (cosine, least))
        along_v, along_d = along_v + (v - all_v), along_d + side * (d - all_d)
    return seen, whole, along_v, along_d


def _together(tile: _Tile, lines: Sweep, horizons):
    """From the horizons of all directions: what is seen, of how much, and what bends the normal."""
    slices = horizons.shape[0] // 2
    seen = whole = weights = x = y = back = 0.0
    for s in range(slices):
        along = lines.along[s]
        parts = _arcs(tile, along, horizons[s], horizons[s + slices])
        aside, out, _ = _slice(tile, along)
        weight = 1.0 / out
        d = weight * lax.rsqrt(out) * parts[3]
        seen, whole, weights = seen + weight * parts[0], whole + weight * parts[1], weights + weight
        x, y, back = x + d * along[0], y + d * along[1], back + weight * parts[2] + d * aside
    # All of a hemisphere has a mean of two thirds of its normal.
    bend = (1.5 / weights * (add - back * ray) for add, ray in zip((x, y, 0.0), tile.ray))
    return seen, whole, *bend


def _estimate(field: HeightField, settings: HorizonAO) -> Planes:
    height, width = field.mask.shape
    around = margin(height, width)
    nearness = jnp.where(field.mask, jnp.where(field.perspective, 1.0 / field.depth, -field.depth), NOWHERE)
    nearness = tiles(nearness, NOWHERE, around)
    planes = [tiles(plane, 1.0) for plane in (field.depth, *field.normal, *field.geometric)]
    nearness, planes = lax.optimization_barrier((nearness, planes))

    # Let lines reach as far as the radius does anywhere.
    pixel = jnp.sqrt(jnp.abs(field.across[0] * field.down[1])) * field.unit
    reach = settings.radius / (pixel * jnp.where(field.perspective, field.depth, 1.0))
    reach = jnp.max(jnp.where(field.mask, reach, 0.0))
    lines = sweep(settings.slices, settings.steps, reach, around, field.across, field.down)

    kept = _kept(lines, planes[0].shape, height, width, settings.edge)
    always = field.unit > 0

    def phase(_, row):
        number, lines, kept, planes = row
        tile = _tile(field, number, *planes)
        # Work in branches: what a loop writes down as it computes it keeps from vectors.
        horizons = lax.map(lambda line: apart(always, _highest, field, nearness, tile, *line, settings), (lines, kept))
        return None, apart(always, _together, tile, lines, horizons)

    _, sums = lax.scan(phase, None, (jnp.arange(PHASES, dtype=jnp.int32), lines, kept, planes))
    return tuple(untiled(plane, height, width) for plane in sums)


@jax.jit
def horizon(surface: Surface, camera: Camera, settings: HorizonAO) -> Occlusion:
    """How much of the ambient light reaches every pixel, and from where; see `Occlusion`."""
    return on_screen(surface, camera, settings, _estimate)
