"""Cascades: several maps of a directional light for what is in view, finer near the eye.

What is seen lies between the depths n and f along the camera's axis; the i-th of m cascades begins at

    z_i = λ n (f / n)^(i/m) + (1 - λ) (n + (f - n) i / m)

and hands over to the next within the last tenth of its depth, where both are weighed linearly. Each shows the box, in
light space, around the pixels that it has, as far up as there are casters. Its texels are one of four sizes an octave,
and their edges are multiples of it: while the camera moves a little, no texel does.

Gradient: none.
Source: Zhang et al. 2006, "Parallel-Split Shadow Maps" (the split); Lauritzen, Salvi & Lefohn 2011, "Sample
Distribution Shadow Maps" (fitting to what is seen); Valient 2008, "Stable Rendering of Cascaded Shadow Maps" (snaps).
"""

import itertools

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from ..scene import Camera
from .shadow_frame import THINNEST, Knob, LightView, rotate

NEAREST = 1e-3  # of the farthest depth: the ratio of depths has no bound as the near one goes to 0
OVERLAP = 0.1  # of a cascade's depth, shared with the next
SIZES = 4  # of texels in an octave: coarser by 9 % in the mean than the box asks for, and seldom another


def splits(near: Float[Array, ""], far: Float[Array, ""], count: int, split: Knob) -> Float[Array, " n"]:
    """The count + 1 depths between which cascades lie; near and far above 0.

    Example:
        >>> [f"{depth:.2f}" for depth in splits(jnp.float32(0.1), jnp.float32(100.0), 4, 0.5).tolist()]
        ['0.10', '12.82', '26.61', '46.40', '100.00']
    """
    share = jnp.arange(count + 1, dtype=near.dtype) / count
    return split * near * (far / near) ** share + (1.0 - split) * (near + (far - near) * share)


def _depths(surface: Surface, camera: Camera) -> Float[Array, "*b"]:
    """Distance from the eye along the camera's axis."""
    pose = camera.world_from_view
    eye, back = (jnp.broadcast_to(pose[:3, k], surface.position.shape) for k in (3, 2))
    return safe.dot(eye - surface.position, back)


def cascades(
    whole: LightView, surface: Surface, camera: Camera, count: int, split: Knob
) -> tuple[LightView, Float[Array, "n *b"]]:
    """So many views in place of that of the whole scene, and the weight of each at every pixel; they add up to 1."""
    depth, seen = _depths(surface, camera), surface.mask
    far = jnp.maximum(jnp.max(jnp.where(seen, depth, -jnp.inf)), safe.TINY)
    near = jnp.clip(jnp.min(jnp.where(seen, depth, jnp.inf)), NEAREST * far, far)
    begin = splits(near, far, count, split)

    # Rise from 0 to 1 before each beginning but the first; what lies between two rises is a cascade's weight.
    width = OVERLAP * (begin[1:-1] - begin[:-2])
    rises = [
        safe.divide(depth - (z - w), jnp.broadcast_to(w, depth.shape), 1.0)
        for z, w in zip(begin[1:-1], width, strict=True)
    ]
    steps = [jnp.ones_like(depth), *(jnp.clip(rise, 0.0, 1.0) for rise in rises), jnp.zeros_like(depth)]
    weights = jnp.stack([start - end for start, end in itertools.pairwise(steps)])

    # Fit each to its pixels, and to the grid of its texels.
    among = seen[None] & (weights > 0)
    places = [jnp.broadcast_to(place, among.shape) for place in rotate(whole.axes, surface.position)[:2]]
    axes = tuple(range(1, among.ndim))
    low = jnp.stack([jnp.min(jnp.where(among, place, jnp.inf), axis=axes) for place in places], axis=-1)
    high = jnp.stack([jnp.max(jnp.where(among, place, -jnp.inf), axis=axes) for place in places], axis=-1)
    low, high = (jnp.where(jnp.isfinite(bound), bound, 0.0) for bound in (low, high))
    texels = whole.size - 2 * whole.margin - 1
    needed = jnp.maximum(jnp.max(high - low, axis=-1, keepdims=True), THINNEST) / texels
    texel = jnp.exp2(jnp.ceil(SIZES * jnp.log2(needed)) / SIZES) + jnp.zeros_like(low)

    def each(value):
        return jnp.broadcast_to(value, (count, *value.shape))

    return LightView(
        axes=each(whole.axes),
        origin=each(whole.origin),
        low=jnp.floor(low / texel) * texel,
        texel=texel,
        depth=each(whole.depth),
        size=whole.size,
        margin=whole.margin,
        central=False,
    ), weights
