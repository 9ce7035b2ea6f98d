"""D: how much microfacet area faces the half vector."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe


def ggx(n: Float[Array, "*b 3"], h: Float[Array, "*b 3"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """D = k²/π with k = α / (|n × h|² + α² (n·h)²), per steradian; 0 below the horizon.

    |n × h|² is 1 - (n·h)² without its cancellation, which at α = 0.002 would cost float32 three percent of the peak.
    Near the peak n × h cancels too; n × (h - n) is the same and does not, since close numbers subtract exactly: D of
    given float32 vectors is right to 1e-6 for all α above 0.002.
    Gradient: exact in n, h and α; finite for α > 0, and 0 at h = 0.

    Source: Walter et al. 2007, eq. 33; the cross product as in Filament's documentation, 4.4.1, less its cancellation.
    """
    across = jnp.cross(n, h - n)
    n_dot_h = safe.dot(n, h)
    above = n_dot_h > 0
    k = alpha / jnp.where(above, safe.dot(across, across) + (n_dot_h * alpha) ** 2, 1.0)
    return jnp.where(above, k * k / jnp.pi, 0.0)
