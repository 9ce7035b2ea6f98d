"""Structural similarity: do neighbourhoods have the same mean, contrast and pattern."""

import jax
import jax.numpy as jnp
import numpy as np

from ..math.filter import separable
from .score import Picture, Score, mean, pair, score

# The paper's: Gaussian weights of standard deviation 1.5 pixels in a window of 11 x 11.
RADIUS, DEVIATION = 5, 1.5
LEAST = 2 * RADIUS + 1  # pixels across, for one window
# ... and its constants for white = 1, which keep flat or black neighbourhoods from dividing by 0.
C1, C2 = 0.01**2, 0.03**2


def _window() -> np.ndarray:
    """The window's weights along one axis."""
    weights = np.exp(-0.5 * (np.arange(-RADIUS, RADIUS + 1) / DEVIATION) ** 2)
    return weights / weights.sum()


@jax.jit
def ssim(image: Picture, reference: Picture) -> Score:
    """Mean of (2 μᵢμᵣ + C₁)(2 σᵢᵣ + C₂) / ((μᵢ² + μᵣ² + C₁)(σᵢ² + σᵣ² + C₂)), from -1 to 1, which only identical
    pictures reach. For display-encoded pictures whose white is 1; channels apart, then averaged.

    With s = i + r and d = i - r it is (1 - μ_d² / (½(μ_s² + μ_d²) + C₁)) (1 - σ_d² / (½(σ_s² + σ_d²) + C₂)): four
    filters instead of five, and exactly 1 where d is 0. Mirrored at the border; the value is the mean over pixels
    whose window lies inside the picture, which has to have 11 x 11 pixels.

    Gradient: exact in both, 0 for identical pictures.
    Source: Wang et al. 2004, "Image Quality Assessment: From Error Visibility to Structural Similarity", eq. 13.

    Example:
        >>> ramp = jnp.broadcast_to(jnp.linspace(0.0, 1.0, 16)[:, None, None], (16, 16, 3))
        >>> float(ssim(ramp, ramp).value), f"{ssim(ramp**1.5, ramp).value:.2f}"
        (1.0, '0.93')
    """
    image, reference, sound = pair("ssim", image, reference)
    height, width = sound.shape
    if min(height, width) < LEAST:
        raise ValueError(f"ssim: image must have at least {LEAST} x {LEAST} pixels, got {width} x {height}")
    s, d = image + reference, image - reference
    window = _window()
    mean_s, mean_d, square_s, square_d = separable(jnp.stack([s, d, s * s, d * d]), window, window, "symmetric")
    means = 0.5 * (mean_s**2 + mean_d**2)
    luminance = 1.0 - mean_d**2 / (means + C1)
    structure = 1.0 - (square_d - mean_d**2) / (0.5 * (square_s + square_d) - means + C2)
    values = jnp.mean(luminance * structure, axis=0)
    inside = slice(RADIUS, -RADIUS)
    return score(mean(values[inside, inside], sound[inside, inside]), values, sound)
