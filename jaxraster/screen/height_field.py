"""The picture as a height field: at each pixel how deep the surface lies, on which ray, and which ways it faces.

View space in planes [h, w], y up, and without metres: lengths are counted in `unit`, the least depth seen, or half of
the picture's height for a parallel projection, so that nothing depends on a scene's scale. Depth is -z.

Gradient: none is asked for; `occlusion` stops it before.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from ..math import safe
from ..record import record
from ..scene import Camera

Plane = Float[Array, "h w"]
Planes = tuple[Float[Array, "h w"], ...]


@record
class HeightField:
    """Depth, 1 where there is nothing; normals towards the viewer or 0, to shade with and the face's own; and rays.

    A ray's x and y where z = -1, or where it is for a parallel projection, are `centre` in the middle of the picture,
    and change by `across` with each pixel to the right and by `down` with each line.
    """

    mask: Bool[Array, "h w"]
    depth: Float[Array, "h w"]
    normal: tuple[Float[Array, "h w"], Float[Array, "h w"], Float[Array, "h w"]]
    geometric: tuple[Float[Array, "h w"], Float[Array, "h w"], Float[Array, "h w"]]
    centre: Float[Array, "2"]
    across: Float[Array, "2"]
    down: Float[Array, "2"]
    unit: Float[Array, ""]
    perspective: Bool[Array, ""]


def turned(vectors: Float[Array, "*b 3"], rotation: Float[Array, "3 3"]) -> tuple:
    """The parts of Rᵀ v: world space to view space, for the rotation of `world_from_view`."""
    return tuple(sum(vectors[..., i] * rotation[i, k] for i in range(3)) for k in range(3))


def height_field(
    mask: Bool[Array, "h w"],
    position: Float[Array, "h w 3"],
    normal: Float[Array, "h w 3"],
    geometric: Float[Array, "h w 3"],
    camera: Camera,
) -> HeightField:
    """The height field of one picture in world space; where `mask` is false there is nothing."""
    height = mask.shape[0]
    lens, rotation = camera.clip_from_view, camera.world_from_view[:3, :3]
    perspective = lens[3, 2] != 0
    eye = jnp.broadcast_to(camera.world_from_view[:3, 3], position.shape)
    z = -turned(position - eye, rotation)[2]

    # Count in a length that scales with the scene, and from where no depth is 0.
    least = jnp.min(jnp.where(mask, z, jnp.inf))
    least = jnp.where(jnp.isfinite(least), least, 1.0)
    half = 1.0 / jnp.abs(lens[1, 1])
    unit = jnp.where(perspective, jnp.maximum(least, safe.TINY), half)
    depth = jnp.where(perspective, z, z - (least - unit)) / unit

    # Solve the projection's first two rows for rays; for parallel ones the last column stands in for the third.
    shift = jnp.where(perspective, lens[:2, 2], -lens[:2, 3] / unit)
    scale = jnp.where(perspective, 1.0, unit)
    skew = lens[0, 1] / lens[0, 0]
    right, up = (2.0 / (height * scale * lens[k, k]) for k in (0, 1))
    y = shift[1] / lens[1, 1]
    x = shift[0] / lens[0, 0] - skew * y
    return HeightField(
        mask=mask,
        depth=jnp.where(mask, depth, 1.0),
        normal=turned(normal, rotation),
        geometric=turned(geometric, rotation),
        centre=jnp.stack([x, y]),
        across=jnp.stack([right, jnp.zeros_like(right)]),
        down=jnp.stack([skew * up, -up]),
        unit=unit,
        perspective=perspective,
    )


def plane_at(field: HeightField, column: Plane, line: Plane) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """x and y of the rays through these pixels, counted from the first one's centre, as `HeightField` has them."""
    height, width = field.mask.shape
    column, line = column - 0.5 * (width - 1), line - 0.5 * (height - 1)
    x, y = (field.centre[k] + field.across[k] * column + field.down[k] * line for k in (0, 1))
    return x, y


def pixels(field: HeightField) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """Column and line of every pixel."""
    shape, dtype = field.depth.shape, field.depth.dtype
    return lax.broadcasted_iota(dtype, shape, 1), lax.broadcasted_iota(dtype, shape, 0)


def places(field: HeightField) -> Planes:
    """Where the surface lies at every pixel, view space."""
    x, y = plane_at(field, *pixels(field))
    stretch = jnp.where(field.perspective, field.depth, 1.0)
    return x * stretch, y * stretch, -field.depth


def pixel_of(field: HeightField, place: tuple) -> tuple[Float[Array, "*b"], Float[Array, "*b"], Float[Array, "*b"]]:
    """Column, line and depth of places in view space; -1 and -1 for what is not before a camera."""
    x, y, z = place
    ahead = ~field.perspective | (z < -safe.TINY)
    shrink = jnp.where(field.perspective, -1.0 / jnp.where(z < -safe.TINY, z, -1.0), 1.0)
    x, y = x * shrink - field.centre[0], y * shrink - field.centre[1]
    line = y / field.down[1]
    column = (x - line * field.down[0]) / field.across[0]
    height, width = field.mask.shape
    column, line = column + 0.5 * (width - 1), line + 0.5 * (height - 1)
    return jnp.where(ahead, column, -1.0), jnp.where(ahead, line, -1.0), -z
