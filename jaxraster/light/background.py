"""The environment itself, where the camera sees no surface.

Radiance in cd/m², drawn as a lobe of width `blurriness` would gather it: 0 is the bare two tones with their hard
horizon, 1 a soft gradient. Does not affect: surfaces and the light on them.

Gradient: exact in tones, camera and blurriness.
Source: the blur is `ambient`'s.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe
from ..math.transform import multiply
from ..record import Scalar, record
from ..scene import Camera, Environment
from .ambient import tones


@record
class Background:
    """`blurriness` in [0, 1], the alpha of the lobe that blurs the horizon; `gain` multiplies both tones."""

    blurriness: Scalar = 0.5
    gain: Scalar = 1.0


def rays(camera: Camera, *, height: int, width: int) -> Float[Array, "h w 3"]:
    """Unit directions from the eye through every pixel's centre, world space."""
    x = ((jnp.arange(width, dtype=camera.clip_from_view.dtype) + 0.5) * (2.0 / width) - 1.0) * (width / height)
    y = 1.0 - (jnp.arange(height, dtype=camera.clip_from_view.dtype) + 0.5) * (2.0 / height)
    p = camera.clip_from_view
    # Solve the projection's first two rows for a direction with w = 1, or straight ahead for a parallel one.
    perspective = p[3, 2] != 0
    view_x = jnp.where(perspective, (x[None, :] + p[0, 2]) / p[0, 0], 0.0)
    view_y = jnp.where(perspective, (y[:, None] + p[1, 2]) / p[1, 1], 0.0)
    skew = jnp.where(perspective, p[0, 1] / p[0, 0], 0.0)
    view_x, view_y = jnp.broadcast_arrays(view_x - skew * view_y, view_y)
    direction = jnp.stack([view_x, view_y, -jnp.ones_like(view_x)], axis=-1).reshape(-1, 3)
    turned = multiply(direction, camera.world_from_view[:3, :3].T)
    return safe.normalize(turned).reshape(height, width, 3)


def background(
    camera: Camera, environment: Environment, settings: Background, *, height: int, width: int
) -> Float[Array, "h w 3"]:
    """Radiance behind everything."""
    direction = rays(camera, height=height, width=width)
    alpha = jnp.broadcast_to(jnp.asarray(settings.blurriness, direction.dtype), direction.shape[:-1])
    return settings.gain * tones(environment, direction, alpha)
