"""The projection of one shadow map: where world points lie in it, and how steeply a receiver's plane rises there.

Parallel for a directional light, central for a lamp. Light space has the map's two axes first and then the height
towards the light; a lamp's own place is 0, so that -height is the distance w before it. In the map

    x = (column / w - low) / texel + margin,  y likewise,  depth = (height - low) / range, or near / w for a lamp,

with w = 1 in parallel light: texels of the map, row 0 at y = 0, and depth 1 at the nearest to the light, 0 for nothing.
Both depths are linear in x and y across a plane; 1 / w is as precise far away as near by, so that `near` may be small.

Gradient: of these formulas; `shadow_map` stops it.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math import safe
from ..math.transform import frame
from ..record import record, static

# Cosine at which a plane's slope stops growing: light that grazes further adds under 1/1000 of its irradiance.
MIN_COSINE = 1e-3
# A lamp's near plane, in units of the farthest it can see: what is nearer throws no shadow, as a bulb around it.
NEAR = 2.0**-12
# Half angles of a spot's map, in radians: tangents of a cone without width, and of one as wide as 90°, make no map.
NARROW, WIDE = 1e-3, 1.45
# Metres of a parallel map's least extent: a gradient divides by a texel's square, which float32 must hold.
THINNEST = 1e-15
Knob = float | Float[Array, ""]  # of one picture, whatever the shape of its pixels
# Rows: two axes and the direction back to the lamp, of a cube's sides in order +X, -X, +Y, -Y, +Z, -Z.
SIDES = np.array([[np.eye(3)[k - 2], s * np.eye(3)[k - 1], -s * np.eye(3)[k]] for k in range(3) for s in (1.0, -1.0)])


@record
class LightView:
    """Axes are rows: the map's two, and the one towards the light. `depth` is (low, range), of lamps (near, near)."""

    axes: Float[Array, "*b 3 3"]
    origin: Float[Array, "*b 3"]
    low: Float[Array, "*b 2"]
    texel: Float[Array, "*b 2"]
    depth: Float[Array, "*b 2"]
    size: int = static()
    margin: int = static()
    central: bool = static()


class Receiver(NamedTuple):
    """A place in the map, in texels; depth, what its plane rises along each texel, and a texel's own depth."""

    x: Float[Array, "*b"]
    y: Float[Array, "*b"]
    depth: Float[Array, "*b"]
    slope_x: Float[Array, "*b"]
    slope_y: Float[Array, "*b"]
    unit: Float[Array, "*b"]


def axes_towards(towards: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rows: two axes across a unit direction, and the direction."""
    return jnp.stack([*frame(towards), towards])


def rotate(axes: Float[Array, "3 3"], vectors: Float[Array, "*b 3"]) -> list[Float[Array, "*b"]]:
    """Components along each axis, written out in full precision."""
    return [safe.dot(vectors, jnp.broadcast_to(axis, vectors.shape)) for axis in axes]


def local(view: LightView, points: Float[Array, "*b 3"]) -> tuple[list[Float[Array, "*b"]], Float[Array, "*b"]]:
    """Light-space coordinates, and the w by which they are divided."""
    if not view.central:
        column, line, height = rotate(view.axes, points)
        return [column, line, height], jnp.ones_like(height)
    column, line, height = rotate(view.axes, points - jnp.broadcast_to(view.origin, points.shape))
    return [column, line, height], -height


def light_clip(view: LightView, vertices: Float[Array, "v 3"]) -> Float[Array, "v 4"]:
    """Clip positions for the rasterizer: reversed depth, w at the near plane."""
    (column, line, height), w = local(view, vertices)
    x = (column - view.low[0] * w) / view.texel[0] + view.margin * w
    y = (line - view.low[1] * w) / view.texel[1] + view.margin * w
    z = jnp.broadcast_to(view.depth[0], w.shape) if view.central else (height - view.depth[0]) / view.depth[1]
    return jnp.stack([x * (2.0 / view.size) - w, w - y * (2.0 / view.size), z, w], axis=-1)


def receiver(view: LightView, position: Float[Array, "*b 3"], normal: Float[Array, "*b 3"]) -> Receiver:
    """Where points lie in the map, with their planes' unit normals; behind a lamp and on it, depth is 2.

    The plane n · p = k of a parallel view rises by -n₁ / n₃ along its first axis; of a central one,
    1 / w = (n₁ x + n₂ y - n₃) / k rises by n₁ / k.
    """
    (column, line, height), w = local(view, position)
    across, along, out = rotate(view.axes, normal)
    texel_x, texel_y = view.texel[0], view.texel[1]
    texel = jnp.maximum(texel_x, texel_y)
    if view.central:
        seen = w > view.depth[0]
        w = jnp.where(seen, w, 1.0)
        depth = jnp.where(seen, view.depth[0] / w, 2.0)
        steep = -(across * column + along * line + out * height)
        least, per_depth, unit = MIN_COSINE * safe.sqrt(column**2 + line**2 + w**2), view.depth[0], depth * texel
    else:
        depth = (height - view.depth[0]) / view.depth[1]
        steep, least, per_depth = out, jnp.full_like(out, MIN_COSINE), 1.0 / view.depth[1]
        unit = jnp.broadcast_to(texel * per_depth, depth.shape)
    scale = -per_depth / jnp.where(steep < 0, jnp.minimum(steep, -least), jnp.maximum(steep, least))
    return Receiver(
        x=(column / w - view.low[0]) / texel_x + view.margin,
        y=(line / w - view.low[1]) / texel_y + view.margin,
        depth=depth,
        slope_x=scale * across * texel_x,
        slope_y=scale * along * texel_y,
        unit=unit,
    )


def inside(view: LightView, place: Receiver) -> Float[Array, "*b"]:
    """1 where a place lies in the map, so far in that its filter does too, and before the lamp; else 0."""
    # Filters reach half a texel less than the margin.
    x, y, rim = place.x, place.y, view.margin - 0.5
    within = (x >= rim) & (x <= view.size - rim) & (y >= rim) & (y <= view.size - rim)
    return (within & (place.depth < 2.0)).astype(place.depth.dtype)


def parallel_view(
    axes: Float[Array, "3 3"], low: Float[Array, "3"], high: Float[Array, "3"], size: int, margin: int
) -> LightView:
    """The view of a directional light that shows what lies between two corners in its space."""
    extent = jnp.maximum(high - low, THINNEST)
    texel = extent[:2] / (size - 2 * margin)
    # Leave a texel's depth at both ends: depth 0 means nothing, and rounding must push no vertex past the near plane.
    depth = jnp.stack([low[2] - jnp.max(texel), extent[2] + 2.0 * jnp.max(texel)])
    whole = {"size": size, "margin": margin, "central": False}
    return LightView(axes=axes, origin=jnp.zeros_like(axes[0]), low=low[:2], texel=texel, depth=depth, **whole)


def central_view(
    axes: Float[Array, "3 3"],
    origin: Float[Array, "3"],
    tangent: Float[Array, ""],
    far: Float[Array, ""],
    size: int,
    margin: int,
) -> LightView:
    """A lamp's view, up to the half angle of that tangent on either axis and its margin beyond."""
    half = jnp.stack([tangent, tangent])
    near = jnp.maximum(NEAR * far, safe.TINY)
    sides = {"size": size, "margin": margin, "central": True}
    texel = 2.0 * half / (size - 2 * margin)
    return LightView(axes=axes, origin=origin, low=-half, texel=texel, depth=jnp.stack([near, near]), **sides)
