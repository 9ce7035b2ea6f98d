"""Surfaces made by hand, one per row of positions, for tests of light that need no picture."""

import jax.numpy as jnp
import numpy as np

from jaxraster.buffers import Surface


def surface(
    position, normal=(0.0, 0.0, 1.0), view=None, *, diffuse=1.0, f0=0.0, f90=1.0, alpha=0.25, occlusion=1.0
) -> Surface:
    """Surfaces at `position` `[*b, 3]`, seen along the normal unless `view` says otherwise; the rest broadcasts."""
    position = np.asarray(position, np.float32)
    shape = position.shape[:-1]

    def full(value, *size):
        return jnp.asarray(np.broadcast_to(np.asarray(value, np.float32), (*shape, *size)))

    return Surface(
        mask=jnp.ones(shape, bool),
        position=full(position, 3),
        normal=full(normal, 3),
        geometric_normal=full(normal, 3),
        view=full(normal if view is None else view, 3),
        uv=full(0, 2),
        diffuse_color=full(diffuse, 3),
        f0=full(f0, 3),
        f90=full(f90),
        alpha=full(alpha),
        emissive=full(0, 3),
        occlusion=full(occlusion),
    )


def towards(theta, phi=0.0) -> np.ndarray:
    """Unit vectors at angle theta from +Z, in radians."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
