"""Trilinear texture lookup with repeat, clamp and mirrored wrapping.

The mip level is log₂ of the footprint's longer side in texels, clamped to the levels there are. UV origin at the top
left, texel centres at half-integers. Linear values in, linear values out.

Gradient: exact in texels; in uv that of the bilinear weights; in the footprint that of the blend between two levels.
uv that are not finite fetch the texel at 0.
Source: Williams 1983, "Pyramidal Parametrics"; level of detail as in the OpenGL 4.6 specification, eq. 8.8.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..math.table import fetch
from ..scene import CLAMP, MIRROR, REPEAT, Textures


def _fold(coordinate, wrap):
    """A coordinate moved by whole periods to where float32 still resolves texels, or clamped to the edge."""
    repeat = coordinate - lax.stop_gradient(jnp.floor(coordinate))
    mirror = coordinate - lax.stop_gradient(2.0 * jnp.floor(0.5 * coordinate))
    clamp = jnp.clip(coordinate, 0.0, 1.0)
    return jnp.where(wrap == CLAMP, clamp, jnp.where(wrap == MIRROR, mirror, repeat))


def _texel(index, size, wrap):
    """The texel for which an index in [-1, size], or up to 2·size if mirrored, stands (no division: it is slow)."""
    repeated = jnp.where(index < 0, index + size, jnp.where(index >= size, index - size, index))
    mirrored = jnp.where(index >= size, 2 * size - 1 - index, index)
    moved = jnp.where(wrap == REPEAT, repeated, jnp.where(wrap == MIRROR, mirrored, index))
    return jnp.clip(moved, 0, size - 1)


def _bilinear(texels, level, u, v, wrap):
    """Four texels of one level, weighed by the distance to their centres."""
    offset, width, height = level[..., 0], level[..., 1], level[..., 2]
    x, y = u * width.astype(u.dtype) - 0.5, v * height.astype(v.dtype) - 0.5
    left, top = (lax.stop_gradient(jnp.floor(c)) for c in (x, y))
    right_weight, low_weight = (x - left)[..., None], (y - top)[..., None]
    columns = [_texel(left.astype(jnp.int32) + i, width, wrap[..., 0]) for i in (0, 1)]
    lines = [_texel(top.astype(jnp.int32) + i, height, wrap[..., 1]) for i in (0, 1)]
    square = [[fetch(texels, offset + y * width + x) for x in columns] for y in lines]
    above, below = (a + right_weight * (b - a) for a, b in square)
    return above + low_weight * (below - above)


def texture(
    textures: Textures, index: Int[Array, "*b"], uv: Float[Array, "*b 2"], footprint: Float[Array, "*b 2 2"]
) -> Float[Array, "*b 4"]:
    """RGBA of texture `index` at `uv`, white where the index is -1.

    `footprint[..., i, j]` is ∂uv_i per pixel to the right (j = 0) and down (j = 1).
    """
    present = index >= 0
    index = jnp.maximum(index, 0)
    wrap = fetch(textures.wrap, index)
    uv = jnp.where(jnp.isfinite(uv), uv, 0.0)
    u, v = _fold(uv[..., 0], wrap[..., 0]), _fold(uv[..., 1], wrap[..., 1])

    # Choose the level at which a step of one pixel is at most one texel; below one texel there is no level.
    size = fetch(textures.levels[:, 0, 1:], index).astype(uv.dtype)
    right, down = (
        (footprint[..., 0, i] * size[..., 0]) ** 2 + (footprint[..., 1, i] * size[..., 1]) ** 2 for i in (0, 1)
    )
    square = jnp.maximum(right, down)
    square = jnp.where(jnp.isfinite(square), square, 1.0)
    deepest = textures.levels.shape[1] - 1
    lod = jnp.clip(0.5 * jnp.log2(jnp.maximum(square, 1.0)), 0.0, float(deepest))
    finer = jnp.floor(lax.stop_gradient(lod)).astype(jnp.int32)
    coarser = jnp.minimum(finer + 1, deepest)

    table = textures.levels.reshape(-1, 3)
    rows = [fetch(table, index * textures.levels.shape[1] + level) for level in (finer, coarser)]
    fine, coarse = (_bilinear(textures.texels, row, u, v, wrap) for row in rows)
    value = fine + (lod - finer.astype(lod.dtype))[..., None] * (coarse - fine)
    return jnp.where(present[..., None], value, 1.0)
