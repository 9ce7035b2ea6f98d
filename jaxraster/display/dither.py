"""Dither: noise of about one 8-bit code, added before rounding, that turns the bands of a slow ramp into fine grain.

Display-encoded values in and out. Does not affect: black, white, and pictures stored in floating point.
Source: Lipshitz, Wannamaker and Vanderkooy 1992, "Quantization and Dither": a triangular density of ±1 code makes mean
and variance of the rounding error independent of the signal. Gradient: identity in the picture.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math.hash import uniform
from ..record import Scalar, record


@record
class Dither:
    """`amplitude` ≥ 0: half the width of the noise in 8-bit codes; 1 hides banding fully."""

    amplitude: Scalar = 1.0


def _triangular(shape: tuple[int, ...]) -> Float[Array, "h w 3"]:
    """Noise from -1 to 1 of triangular density: the sum of two hashes of each value's place in the picture."""
    key = 2 * jnp.arange(math.prod(shape), dtype=jnp.uint32).reshape(shape)
    return uniform(key) + uniform(key + 1) - 1.0


def dither(image: Float[Array, "*b h w 3"], settings: Dither) -> Float[Array, "*b h w 3"]:
    """image + noise, the same noise for every picture of a batch.

    Noise is never wider than the distance to 0 or 1: black and white stay exact, no clamp is needed, and the mean
    stays the image everywhere. What lies outside [0, 1] is left as it is.

    Gradient: 1 in the image, also within `amplitude` codes of the ends, where the exact one is 1 plus noise of mean 0;
    in the amplitude noise / 255, and 0 near the ends.
    """
    noise = _triangular(image.shape[-3:]).astype(image.dtype)
    room = jnp.maximum(jax.lax.stop_gradient(jnp.minimum(image, 1.0 - image)), 0.0)
    width = jnp.minimum(settings.amplitude / 255.0, room)
    return image + width * noise.reshape((1,) * (image.ndim - 3) + noise.shape)
