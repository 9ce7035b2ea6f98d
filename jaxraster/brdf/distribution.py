"""D: how much microfacet area faces the half vector, per steradian. ∫ D (n·h) dh = 1 over the hemisphere.

Of a lobe at most MIRROR wide D is no number, and returned as 0. `ggx_anisotropic` takes the surface's own space, z
along n and x and y along the axes of its two alpha, as `sampling` does.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe

# Lobes of at most this α count as a mirror's, whose density is no number: float32 directions are hardly finer.
MIRROR = 1e-6
# Beckmann's tan²θ is above 1100 where n·h is below this, and e^-1100 is 0 in double precision too, for all α up to 1.
EDGE = 0.03


def ggx(n: Float[Array, "*b 3"], h: Float[Array, "*b 3"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """D = k²/π with k = α / (|n × h|² + α² (n·h)²); 0 below the horizon.

    |n × h|² is 1 - (n·h)² without its cancellation, which at α = 0.002 would cost float32 three percent of the peak.
    Near the peak n × h cancels too; n × (h - n) is the same and does not, since close numbers subtract exactly: D of
    given float32 vectors is right to 1e-6 for all α above 0.002.
    Gradient: exact in n, h and α; 0 at h = 0.

    Source: Walter et al. 2007, eq. 33; the cross product as in Filament's documentation, 4.4.1, less its cancellation.
    """
    across = jnp.cross(n, h - n)
    n_dot_h = safe.dot(n, h)
    seen = (n_dot_h > 0) & (alpha > MIRROR)
    k = alpha / jnp.where(seen, safe.dot(across, across) + (n_dot_h * alpha) ** 2, 1.0)
    return jnp.where(seen, k * k / jnp.pi, 0.0)


def ggx_anisotropic(h: Float[Array, "*b 3"], alpha: Float[Array, "*b 2"]) -> Float[Array, "*b"]:
    """D = 1/(π αₓα_y q²), q = (hₓ/αₓ)² + (h_y/α_y)² + h_z²: the `ggx` of equal α, stretched; 0 below the horizon.

    Right to 1e-6 in float32. Gradient: exact in h and both α; 0 at h = 0.
    Source: Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", its anisotropic GGX.

    Example:
        >>> f"{ggx_anisotropic(jnp.array([0.0, 0.0, 1.0]), jnp.array([0.1, 0.3])):.4f}"
        '10.6103'
    """
    a, b = alpha[..., 0], alpha[..., 1]
    seen = (h[..., 2] > 0) & (a > MIRROR) & (b > MIRROR)
    a, b = jnp.where(seen, a, 1.0), jnp.where(seen, b, 1.0)
    # D = k²/π with k = √(αₓα_y) / (αₓα_y q), in which no α is squared.
    k = jnp.sqrt(a * b) / jnp.where(seen, h[..., 0] ** 2 * b / a + h[..., 1] ** 2 * a / b + a * b * h[..., 2] ** 2, 1.0)
    return jnp.where(seen, k * k / jnp.pi, 0.0)


def beckmann(n: Float[Array, "*b 3"], h: Float[Array, "*b 3"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """D = e^-(tan²θ/α²) / (π α² cos⁴θ), θ the angle between n and h: a Gaussian of slopes, without GGX's long tail.

    For comparison; the masking that goes with it is not in `masking`. α up to 1. A rounding counts tan²θ/α² times:
    float32 is right to 1e-5 where D is above a millionth of its peak, and to 1e-11 of the peak below.
    Gradient: exact in n, h and α; 0 at h = 0.
    Source: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces", eq. 25.

    Example:
        >>> n = jnp.array([0.0, 0.0, 1.0])
        >>> f"{beckmann(n, n, jnp.array(0.1)):.3f}"
        '31.831'
    """
    across = jnp.cross(n, h - n)
    n_dot_h = safe.dot(n, h)
    seen = (n_dot_h > EDGE) & (alpha > MIRROR)
    cosine2, a2 = jnp.where(seen, n_dot_h, 1.0) ** 2, jnp.where(seen, alpha, 1.0) ** 2
    lobe = jnp.exp(-safe.dot(across, across) / (cosine2 * a2)) / (jnp.pi * a2 * cosine2 * cosine2)
    return jnp.where(seen, lobe, 0.0)
