"""Surroundings as matter of one roughness mirrors them, seen head on: their mean, weighed by the GGX lobe.

    L(r) = ∫ K(r·l) L(l) dl / ∫ K(r·l) dl,   K(c) = c₊ / (q + α² (1 - q))²,   q = (1 - c)/2

is D(h) (n·l) for n = v = r, of which only the angle between r and l is left. In a picture with one row per angle from
the pole, K depends on two rows and a difference of columns: the sum over columns is a product of Fourier series, the
sum over rows one of matrices. No direction is drawn at random and no part of the lobe's long tail left out; at α = 1
the lobe is the cosine's, and L irradiance over π. Texels count at their centres: rows should be α/2 apart or closer.

A constant stays what it is, to rounding; nothing positive becomes negative but by rounding, 1e-7 of what is strongest.
Gradient: exact; this is linear in the texels.
Source: Karis 2013, "Real Shading in Unreal Engine 4", for the lobe, which is sampled there; the convolution is ours.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

AT_ONCE = 2**20  # numbers of the lobe that are worked on: what fits into a processor's cache


def _overlap(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """The share of each new interval that every old one covers, of intervals between ascending bounds."""
    both = np.minimum(old[1:], new[1:, None]) - np.maximum(old[:-1], new[:-1, None])
    return np.maximum(both, 0.0) / np.diff(new)[:, None]


def resized(texels: Float[Array, "h w 3"], rows: int, columns: int) -> Float[Array, "r c 3"]:
    """The picture with other numbers of rows and columns, its texels as boxes weighed by the solid angle they share.

    The mean over all directions stays exactly what it is.
    """
    height, width, _ = texels.shape
    if columns != width:
        share = jnp.asarray(_overlap(np.linspace(0, 1, width + 1), np.linspace(0, 1, columns + 1)), texels.dtype)
        texels = jnp.einsum("cw,hwk->hck", share, texels, precision="highest")
    if rows != height:
        bands = (-np.cos(np.linspace(0, np.pi, count + 1)) for count in (height, rows))
        texels = jnp.einsum("rh,hck->rck", jnp.asarray(_overlap(*bands), texels.dtype), texels, precision="highest")
    return texels


def blurred(texels: Float[Array, "h w 3"], alpha: Float[Array, ""]) -> Float[Array, "h w 3"]:
    """L at every texel's centre, for 0 < α ≤ 1; the number of rows is a power of two, at least 2."""
    height, width, _ = texels.shape
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    wave = np.sin(np.pi * np.arange(width) / width) ** 2
    angles, sine, wave = (jnp.asarray(x, texels.dtype) for x in (theta, np.sin(theta)[None, :], wave[None, None, :]))

    # Series of each row weighed by its solid angle, and of each row's mirror image: a lobe about a row in the upper
    # half is the mirror image of that about a row in the lower half.
    series = jnp.fft.rfft(jnp.moveaxis(texels, 2, 0) * sine[..., None])
    series = jnp.concatenate([series, series[:, ::-1]])
    series = jnp.transpose(jnp.concatenate([series.real, series.imag]), (2, 1, 0))

    # Compute the lobe anew for the gradient: kept, it would be as large as the square of the picture.
    @jax.checkpoint
    def about(angle):
        """L in a few rows of the upper half, and in those of the lower half that mirror them."""
        rise = jnp.sin(0.5 * (angle[:, None] - angles[None, :])) ** 2
        q = rise[..., None] + (jnp.sin(angle)[:, None] * sine)[..., None] * wave
        lobe = jnp.maximum(1.0 - 2.0 * q, 0.0) / (q + alpha * alpha * (1.0 - q)) ** 2
        # Even in the difference of columns, so that its series is real.
        lobe = jnp.transpose(jnp.fft.rfft(lobe).real, (2, 0, 1))
        real, imaginary = jnp.split(jnp.matmul(lobe, series, precision="highest"), 2, axis=-1)
        rows = jnp.fft.irfft(jnp.transpose(lax.complex(real, imaginary), (1, 2, 0)), n=width)
        return rows / jnp.sum(lobe[0] * sine, axis=-1)[:, None, None]

    step = max(1, min(height // 2, AT_ONCE // (height * width)))
    upper = lax.map(about, angles[: height // 2].reshape(-1, step)).reshape(height // 2, 6, width)
    return jnp.moveaxis(jnp.concatenate([upper[:, :3], upper[::-1, 3:]]), 1, 2)
