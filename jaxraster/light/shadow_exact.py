"""Exact hard shadows: a ray from every pixel to the light, and whether it meets anything.

The ray leaves the surface on the light's side by a bound on the rounding of positions, 2⁻²⁰ of the scene's largest
coordinate, and ends a little before a lamp, where maps have their near plane: what is nearer throws no shadow.

Gradient: none, on purpose: occlusion is a step.
Source: Whitted 1980, "An Improved Illumination Model for Shaded Display".
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Surface
from ..geometry.bvh import build_morton
from ..geometry.intersect import OFFSET, Rays
from ..math import safe
from ..scene import Mesh
from ..visibility.trace import occluded
from .shadow_frame import NEAR


def exact(kind: str, lights, surface: Surface, mesh: Mesh) -> Float[Array, "n *b"]:
    """1 where a pixel sees each of the lights of one kind, else 0; what is not seen itself costs nothing."""
    tree = build_morton(mesh.vertices, mesh.faces)
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    offset = OFFSET * jnp.max(jnp.where(jnp.isfinite(corners), jnp.abs(corners), 0.0))
    normal, shape = surface.geometric_normal, surface.position.shape

    def lit(light):
        if kind == "directional":
            towards, end = jnp.broadcast_to(-safe.normalize(light.direction), shape), jnp.inf
        else:
            towards, end = jnp.broadcast_to(light.position, shape) - surface.position, 1.0 - NEAR
        side = jnp.where(safe.dot(normal, towards) < 0, -offset, offset)
        origin = surface.position + side[..., None] * normal
        direction = jnp.where(surface.mask[..., None], towards, 0.0)
        blocked = occluded(Rays(origin=origin, direction=direction, t_max=end), tree)
        return jnp.where(blocked, 0.0, 1.0).astype(surface.alpha.dtype)

    return lax.map(lit, lights)
