"""Visibility in nvdiffrast's layout and back, so that a script may use either rasterizer with the other's stages.

nvdiffrast keeps OpenGL's conventions: rows from the bottom up, and clip z in [-w, w], growing away from the viewer.
Positions keep x, y and w, and z_gl = w - 2 z, z = (w - z_gl) / 2. The third row of a projection converts in the same
way; far distances that OpenGL's z has rounded away stay lost, which `perspective` would have kept.

Source: nvdiffrast's documentation, https://nvlabs.github.io/nvdiffrast/, "Rasterization" and "Coordinate systems".
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float32

from ..buffers import Stats, Visibility
from ..check import fit, fit_record

EXACT = 2**24  # the last of the whole numbers that float32 holds without a gap
OFFSET = 0x4A800000  # from a number above that to the bits of its float: EXACT + OFFSET are the bits of 2.0**24
FARTHEST = 2.0**-26  # the greatest depth that 1 - 2 depth rounds to 1, which is the far plane


def to_nvdiffrast(visibility: Visibility) -> Float32[Array, "*b h w 4"]:
    """What nvdiffrast's `rasterize` returns first: (u, v, z_gl / w, id + 1), row 0 at the bottom, 0 for nothing.

    u and v weigh the first corner and the second; z_gl / w = 1 - 2 depth. From 2²⁴ + 1 on, an id is written as the
    float of the bits `id + 1 + 0x4a800000`, up to id 889192446. nvdiffrast always has a first axis of pictures.
    Gradient: exact in barycentrics and depth.

    Example:
        >>> from jaxraster import rasterize
        >>> pos = jnp.array([[-0.75, -0.75, 0.5, 1.0], [0.25, -0.75, 0.5, 1.0], [-0.75, 0.25, 0.5, 1.0]])
        >>> tri = jnp.array([[0, 1, 2]])
        >>> clip = pos.at[:, 2].set(0.5 * (pos[:, 3] - pos[:, 2]))
        >>> rast = to_nvdiffrast(rasterize(clip, tri, height=2, width=2))
        >>> rast[0, 0].tolist(), rast[1, 0].tolist()  # below, above
        ([0.5, 0.25, 0.5, 1.0], [0.0, 0.0, 0.0, 0.0])
    """
    fit_record("to_nvdiffrast: visibility", visibility, Visibility, batched=True)
    number = jnp.asarray(visibility.face).astype(jnp.int32) + 1
    coded = lax.bitcast_convert_type(number + OFFSET, jnp.float32)
    number = jnp.where(number <= EXACT, number.astype(jnp.float32), coded)
    weights, depth = (jnp.asarray(v).astype(jnp.float32) for v in (visibility.barycentric, visibility.depth))
    z = jnp.where(number > 0, 1.0 - 2.0 * depth, 0.0)
    return jnp.stack([weights[..., 0], weights[..., 1], z, number], axis=-1)[..., ::-1, :, :]


def from_nvdiffrast(rast: Float32[Array, "*b h w 4"]) -> Visibility:
    """The inverse of `to_nvdiffrast`: what `interpolate` and `footprint` ask for, with the `tri` that was drawn.

    Faces, u and v come back bit by bit, and the third weight as 1 - u - v, within 2⁻²². Depth comes back exactly from
    1/4 on, and within 2⁻²⁶ below; what was rounded to the far plane counts as 2⁻²⁶, so that 0 stays nothing. `stats`
    are zeros.
    Arrays of other libraries are taken over with `jnp.from_dlpack(rast)`.
    Gradient: exact in u, v and z_gl / w; 0 where the third weight or the depth is clamped.

    Example:
        >>> visibility = from_nvdiffrast(jnp.array([[[0.5, 0.25, 0.5, 1.0], [0.0, 0.0, 0.0, 0.0]]]))
        >>> visibility.face.tolist(), visibility.barycentric[0, 0].tolist(), visibility.depth.tolist()
        ([[0, -1]], [0.5, 0.25, 0.25], [[0.25, 0.0]])
    """
    fit("from_nvdiffrast: rast", rast, Float32[Array, "*b h w 4"])
    u, v, z, number = (jnp.asarray(rast)[..., ::-1, :, i] for i in range(4))
    coded = lax.bitcast_convert_type(number, jnp.int32) - OFFSET
    face = jnp.maximum(jnp.where(number <= EXACT, number.astype(jnp.int32), coded), 0) - 1
    third = jnp.where(face >= 0, jnp.maximum(1.0 - u - v, 0.0), 0.0)
    depth = jnp.where(face >= 0, jnp.maximum(0.5 * (1.0 - z), FARTHEST), 0.0)
    none = jnp.zeros(face.shape[:-2], jnp.int32)
    stats = Stats(non_finite=none, degenerate=none, out_of_range=none)
    nearness = lax.bitcast_convert_type(depth.astype(jnp.float32), jnp.int32)
    weights = jnp.stack([u, v, third], axis=-1)
    return Visibility(face=face, barycentric=weights, depth=depth, nearness=nearness, stats=stats)
