"""The environment itself, where the camera sees no surface.

Radiance in cd/m². The two tones are drawn as a lobe of width `blurriness` would gather them: 0 is bare, with their hard
horizon, 1 a soft gradient. A map is drawn on top, sharp: bilinear between its texels, so that one with more texels than
the picture has pixels is best drawn with `Plan.supersample`. Suns that were cut out of it are drawn as the discs that
they are. Does not affect: surfaces and the light on them.

Gradient: exact in tones, texels, suns, rotation, camera and blurriness.
Source: the blur is `ambient`'s.
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..environment.equirect import lookup, turned
from ..math import safe
from ..math.transform import multiply
from ..record import Scalar, record
from ..scene import Camera, Directional, Environment, EnvironmentMap
from .ambient import tones

RADIUS = 0.00465  # rad, of the sun's disc seen from the earth


@record
class Background:
    """`blurriness` in [0, 1], the alpha of the lobe that blurs the horizon; `gain` multiplies all of it."""

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
    return safe.unit(turned).reshape(height, width, 3)


def _discs(suns: Directional, direction: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Radiance of suns seen as discs of RADIUS, their edges as wide as a tenth of it."""

    def add(total, sun):
        towards, irradiance = sun
        # By the chord: single precision leaves the cosine of so small an angle two digits.
        chord = direction + jnp.broadcast_to(safe.normalize(towards), direction.shape)
        share = jnp.clip(0.5 + (1.0 - safe.dot(chord, chord) / RADIUS**2) / 0.2, 0.0, 1.0)
        radiance = irradiance / (jnp.pi * RADIUS**2)
        return total + share[..., None] * jnp.broadcast_to(radiance, direction.shape), None

    return lax.scan(add, jnp.zeros_like(direction), (suns.direction, suns.irradiance))[0]


@jax.jit
def _shown(surroundings: EnvironmentMap, direction: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """What a map shows along directions, its suns too."""
    there = turned(direction, -surroundings.rotation)
    return lookup(surroundings.texels, there) + _discs(surroundings.suns, there)


def background(
    camera: Camera, environment: Environment, settings: Background, *, height: int, width: int
) -> Float[Array, "h w 3"]:
    """Radiance behind everything."""
    direction = rays(camera, height=height, width=width)
    alpha = jnp.broadcast_to(jnp.asarray(settings.blurriness, direction.dtype), direction.shape[:-1])
    radiance = tones(environment, direction, alpha)
    if environment.map is not None:
        radiance += _shown(environment.map, direction)
    return settings.gain * radiance
