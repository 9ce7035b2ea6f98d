"""Peak signal-to-noise ratio: the mean squared error in decibels below white."""

import jax
import jax.numpy as jnp

from .score import Picture, Score, mean, pair, score


@jax.jit
def psnr(image: Picture, reference: Picture) -> Score:
    """10 log₁₀(1 / MSE) in dB, for pictures whose white is 1; ∞ for identical ones. The map is the squared error.

    Gradient: exact in both for MSE > 0; 0 for identical pictures, where there is none.

    Example:
        >>> grey = jnp.full((2, 2, 3), 0.5)
        >>> f"{psnr(grey + 0.1, grey).value:.2f} dB, {psnr(grey, grey).value} dB"
        '20.00 dB, inf dB'
    """
    image, reference, sound = pair("psnr", image, reference)
    values = jnp.mean((image - reference) ** 2, axis=0)
    mse = mean(values, sound)
    different = mse != 0  # NaN, too: the ratio of no pixels is not infinite
    value = jnp.where(different, -10.0 * jnp.log10(jnp.where(different, mse, 1.0)), jnp.inf)
    return score(value, values, sound)
