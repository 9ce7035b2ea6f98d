"""Normal mapping: a direction stored as colour, turned into the surface's tangent frame.

The map's (r, g, b) in [0, 1] is the direction 2c - 1 along (tangent, bitangent, normal), its slopes scaled by
`scale`; bitangent = w · normal × tangent. A map, tangent or normal of length 0 leaves the interpolated normal.

Gradient: exact in map, scale and frame.
Source: glTF 2.0 specification, 3.9.3 and 3.7.2.1.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe


def normal_map(
    color: Float[Array, "*b 3"],
    scale: Float[Array, "*b"],
    normal: Float[Array, "*b 3"],
    tangent: Float[Array, "*b 4"],
) -> Float[Array, "*b 3"]:
    """The unit shading normal of a unit interpolated normal and an interpolated tangent."""
    along = tangent[..., :3] - safe.dot(tangent[..., :3], normal)[..., None] * normal
    along = safe.unit(along)
    # Interpolated between corners of one handedness the sign is ±1; take it as such where they disagree.
    handedness = jnp.where(tangent[..., 3:] < 0, -1.0, 1.0).astype(normal.dtype)
    across = handedness * jnp.cross(normal, along)
    direction = 2.0 * color - 1.0
    x, y, z = direction[..., :1] * scale[..., None], direction[..., 1:2] * scale[..., None], direction[..., 2:3]
    mapped = safe.unit(x * along + y * across + z * normal)
    return jnp.where(safe.dot(mapped, mapped)[..., None] > 0, mapped, normal)
