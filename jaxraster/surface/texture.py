"""Trilinear texture lookup with repeat, clamp and mirrored wrapping.

The mip level is log₂ of the footprint's longer side in texels, clamped to the levels there are; a texture may ask for
the nearest texel or level instead, or for its first level alone. UV origin at the top left, texel centres at
half-integers. Linear values in, linear values out.

Gradient: exact in texels; in uv that of the bilinear weights, 0 for the nearest texel; in the footprint that of the
blend between two levels, 0 where there is none.
uv that are not finite count as 0, as does a footprint that is not a number; an infinite one reads the last level.
Source: Williams 1983, "Pyramidal Parametrics"; level of detail as in the OpenGL 4.6 specification, eq. 8.8.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..check import below, fit, fit_record
from ..math.table import fetch
from ..scene import CLAMP, FIRST, MIRROR, NEAREST, REPEAT, Textures

# Periods a pixel beyond which every texture, however narrow, is at its last level; larger numbers have no square.
PERIODS = 2.0**15


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


def _bilinear(texels, level, u, v, wrap, nearest):
    """Four texels of one level, weighed by the distance to their centres, or the nearest of them alone."""
    offset, width, height = level[..., 0], level[..., 1], level[..., 2]
    x, y = u * width.astype(u.dtype) - 0.5, v * height.astype(v.dtype) - 0.5
    left, top = (lax.stop_gradient(jnp.floor(c)) for c in (x, y))
    x_weight, y_weight = x - left, y - top
    if nearest is not None:
        x_weight, y_weight = (jnp.where(nearest, jnp.floor(w + 0.5), w) for w in (x_weight, y_weight))
    left, top = left.astype(jnp.int32), top.astype(jnp.int32)

    def add_texel(total, corner):
        right, low = corner
        column, line = _texel(left + right, width, wrap[..., 0]), _texel(top + low, height, wrap[..., 1])
        weight = jnp.where(right > 0, x_weight, 1.0 - x_weight) * jnp.where(low > 0, y_weight, 1.0 - y_weight)
        return total + weight[..., None] * fetch(texels, offset + line * width + column).astype(u.dtype), None

    # Loop over the corners: unrolled, XLA would repeat everything above for each of them.
    corners = (jnp.array([0, 1, 0, 1], jnp.int32), jnp.array([0, 0, 1, 1], jnp.int32))
    return lax.scan(add_texel, jnp.zeros((*u.shape, 4), u.dtype), corners)[0]


def texture(
    textures: Textures, index: int | Int[Array, "*#b"], uv: Float[Array, "*b 2"], footprint: Float[Array, "*b 2 2"]
) -> Float[Array, "*b 4"]:
    """RGBA of texture `index`, one for all or each its own, at `uv`; white where the index is -1, or any below 0.

    `footprint[..., i, j]` is ∂uv_i per pixel to the right (j = 0) and down (j = 1), as `footprint` makes it.

    Example:
        >>> import numpy as np
        >>> from jaxraster import pack_textures
        >>> ramp = np.linspace(0.0, 1.0, 4, dtype=np.float32)[None, :, None].repeat(4, axis=-1)
        >>> texture(pack_textures([ramp]), 0, jnp.array([[0.125, 0.5]]), jnp.zeros((1, 2, 2)))[0, 0].item()
        0.0
    """
    fit_record("texture: textures", textures, Textures)
    fit("texture: uv", uv, Float[Array, "*b 2"])
    fit("texture: footprint", footprint, Float[Array, "*b 2 2"])
    # A plain number stays known under `jit` as an array of NumPy's alone.
    rows = index if hasattr(index, "dtype") else np.asarray(index)
    fit("texture: index", rows, Int[Array, "*b"])
    below("texture: index", rows, textures.wrap.shape[0], "textures", least=-(2**31))
    # In 32 bits: the row of a level in the table may be far beyond what a small index can hold.
    index, uv, footprint = jnp.asarray(index).astype(jnp.int32), jnp.asarray(uv), jnp.asarray(footprint)
    if footprint.shape != (*uv.shape, 2):
        raise ValueError(
            f"texture: uv is {list(uv.shape)}, but footprint {list(footprint.shape)}; it has one axis more"
        )
    return lookup(jax.tree.map(jnp.asarray, textures), jnp.broadcast_to(index, uv.shape[:-1]), uv, footprint)


@jax.jit
def lookup(
    textures: Textures, index: Int[Array, "*b"], uv: Float[Array, "*b 2"], footprint: Float[Array, "*b 2 2"]
) -> Float[Array, "*b 4"]:
    """`texture` without its checks; compiled by itself, so that calls outside of `jit` compile once."""
    present = index >= 0
    index = jnp.maximum(index, 0)
    wrap = fetch(textures.wrap, index)
    uv = jnp.where(jnp.isfinite(uv), uv, 0.0)
    u, v = _fold(uv[..., 0], wrap[..., 0]), _fold(uv[..., 1], wrap[..., 1])

    # Choose the level at which a step of one pixel is at most one texel; below one texel there is no level.
    footprint = jnp.where(jnp.isnan(footprint), 0.0, jnp.clip(footprint, -PERIODS, PERIODS))
    size = fetch(textures.levels[:, 0, 1:], index).astype(uv.dtype)
    right, down = (
        (footprint[..., 0, i] * size[..., 0]) ** 2 + (footprint[..., 1, i] * size[..., 1]) ** 2 for i in (0, 1)
    )
    square = jnp.maximum(right, down)
    deepest = textures.levels.shape[1] - 1
    lod = jnp.clip(0.5 * jnp.log2(jnp.maximum(square, 1.0)), 0.0, float(deepest))
    nearest = None
    if textures.filters is not None:
        magnified, minified, between = (fetch(textures.filters[:, i], index) for i in range(3))
        nearest = jnp.where(square > 1.0, minified, magnified) == NEAREST
        lod = jnp.where(between == FIRST, 0.0, jnp.where(between == NEAREST, jnp.round(lod), lod))
    finer = jnp.floor(lax.stop_gradient(lod)).astype(jnp.int32)

    table, blend = textures.levels.reshape(-1, 3), lod - finer.astype(lod.dtype)

    def add_level(total, second):
        row = fetch(table, index * textures.levels.shape[1] + jnp.minimum(finer + second, deepest))
        weight = jnp.where(second > 0, blend, 1.0 - blend)
        return total + weight[..., None] * _bilinear(textures.texels, row, u, v, wrap, nearest), None

    value = lax.scan(add_level, jnp.zeros((*u.shape, 4), uv.dtype), jnp.arange(2, dtype=jnp.int32))[0]
    return jnp.where(present[..., None], value, 1.0)
