"""Relative mean squared error: how the error of a light estimate is usually told."""

import jax
import jax.numpy as jnp
from jax import lax

from .score import Picture, Score, mean, pair, score

# Light squared below which an error counts as absolute, for white at 1; 0.01 is the value in common use, so that
# numbers can be compared. It keeps a black reference from dividing by 0.
EPSILON = 0.01


@jax.jit
def relative_mse(image: Picture, reference: Picture) -> Score:
    """Mean of (i - r)² / (r² + 0.01) over channels and pixels; 0 for identical pictures, without upper end.

    Whatever the unit of the light, it should have white near 1: the constant is not relative.
    Gradient: exact in both.
    Source: Rousselle et al. 2011, "Adaptive Sampling and Reconstruction using Greedy Error Minimization", section 6.

    Example:
        >>> grey = jnp.full((2, 2, 3), 0.3)
        >>> f"{relative_mse(2.0 * grey, grey).value:.3f}"
        '0.900'
    """
    image, reference, sound = pair("relative_mse", image, reference)
    # Measure both in units of the reference where that is above 1, or the squares of bright light would overflow.
    unit = lax.stop_gradient(jnp.maximum(jnp.abs(reference), 1.0))
    error, level = (image - reference) / unit, reference / unit
    values = jnp.mean(error * error / (level * level + EPSILON / unit / unit), axis=0)
    return score(mean(values, sound), values, sound)
