"""Ambient occlusion of whatever is on the screen: from surfaces to `Occlusion`, by a method for one height field.

Layers, samples or batches of pictures are taken one by one, each of them as a height field of its own: what lies in one
layer does not occlude another. Pictures without a surface cost nothing.

Gradient: 0 through what is found, on purpose, as through shadows: what hides the sky is found by comparing depths, and
compiling its derivative would take most of a minute. A bent normal moves with the normal that it was bent from.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax import lax

from ..buffers import Occlusion, Surface
from ..math import safe
from ..scene import Camera
from .denoise import denoise
from .height_field import HeightField, Planes, height_field

# Bent normals of a millionth and less have no direction, nor a finite slope.
FAINT = 1e-12


# From a height field and settings to five planes: how much light each pixel sees, of how much, and what, added to its
# normal, bends it: 0 where all is seen, so that means over neighbours leave details of normals alone.
Method = Callable[[HeightField, Any], Planes]


def _one_picture(mask, position, normal, geometric, camera, settings, method):
    field = height_field(mask, position, normal, geometric, camera)
    # Divide sums, not each pixel by itself: those that look in other directions see other shares of the hemisphere.
    light, whole, *bend = denoise(field, method(field, settings))
    visibility = safe.divide(light, whole, 1.0)
    rotation = camera.world_from_view[:3, :3]
    bent = [normal[..., i] + sum(bend[k] * rotation[i, k] for k in range(3)) for i in range(3)]
    square = sum(part * part for part in bent)
    bends = mask & (square > FAINT)
    shrink = lax.rsqrt(jnp.where(bends, square, 1.0))
    bent = [jnp.where(bends, shrink * part, normal[..., i]) for i, part in enumerate(bent)]
    return jnp.where(mask, jnp.clip(visibility, 0.0, 1.0), 1.0), jnp.stack(bent, axis=-1)


def on_screen(surface: Surface, camera: Camera, settings: Any, method: Method) -> Occlusion:
    """The occlusion of every picture, by a method for one of them."""
    *batch, height, width = surface.mask.shape
    still = surface.mask, surface.position, surface.normal, surface.geometric_normal
    parts, camera, settings = lax.stop_gradient((still, camera, settings))

    def make(parts):
        mask, position, normal, geometric = parts
        return _one_picture(mask, position, normal, geometric, camera, settings, method)

    def found(visibility, bent):
        visibility, bent = visibility.reshape(surface.mask.shape), bent.reshape(surface.normal.shape)
        return Occlusion(visibility=visibility, bent_normal=surface.normal + lax.stop_gradient(bent - surface.normal))

    if not batch:
        return found(*make(parts))

    def make_some(parts):
        mask, _, normal, _ = parts
        return lax.cond(jnp.any(mask), make, lambda _: (jnp.ones(mask.shape, normal.dtype), normal), parts)

    flat = [part.reshape(-1, height, width, *part.shape[len(batch) + 2 :]) for part in parts]
    return found(*lax.map(make_some, tuple(flat)))
