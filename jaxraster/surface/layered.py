"""Gathering and materials for layers of visible triangles, most of which are seen at few pixels.

Empty layers are skipped, and materials are made in runs of the pixels where something is seen.
Gradient: that of `gather` and `material`.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Surface, Visibility
from ..math.sparse import where_present
from ..scene import Camera, Scene
from .gather import gather
from .material import material


def layered(
    scene: Scene, visibility: Visibility, clip: Float[Array, "v 4"], camera: Camera, slots: tuple[str, ...]
) -> Surface:
    """The surface of every layer `[l, h, w]`, with its opacity."""

    def make(fragment):
        return material(fragment, scene.materials, scene.textures, slots, layered=True)

    def look_up(seen, _):
        fragment = gather(scene, seen, clip, camera)
        return where_present(make, fragment.mask, fragment)

    # Look the first layer up in any case: what is made of it stands in wherever nothing is seen.
    def step(ahead, layer):
        number, seen = layer
        mask = seen.face >= 0
        surface = lax.cond((number == 0) | jnp.any(mask), look_up, lambda _, ahead: ahead, seen, ahead)
        return surface, replace(surface, mask=mask)

    shapes = jax.eval_shape(look_up, jax.tree.map(lambda leaf: leaf[0], visibility), None)
    blank = jax.tree.map(lambda value: jnp.zeros(value.shape, value.dtype), shapes)
    number = jnp.arange(visibility.face.shape[0], dtype=jnp.int32)
    return lax.scan(step, blank, (number, visibility))[1]
