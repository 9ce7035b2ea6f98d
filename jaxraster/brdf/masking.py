"""V: how much of that area both the light and the viewer see, over 4 (n·l)(n·v).

All of them are GGX's by Smith, one divided by the lengths |αv| of the two directions in the space where the surface's
ellipsoid is a sphere. They cover the viewer's sight exactly once: G₁(v) = 4 (n·v) V, lit along n, has
∫ G₁(v) D (v·h)₊ dh = n·v, but for `smith_fast`, a fit. Cosines in [0, 1], of which one may be 0 but not both; α > 0.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe


def stretched_length(v: Float[Array, "*b 3"], alpha: Float[Array, "*b 2"]) -> Float[Array, "*b"]:
    """√((αₓ vₓ)² + (α_y v_y)² + v_z²) of v in the surface's own space: |v| where its ellipsoid is a sphere.

    Gradient: exact; 0 where the length is 0.
    """
    x, y, z = alpha[..., 0] * v[..., 0], alpha[..., 1] * v[..., 1], v[..., 2]
    return safe.sqrt(x * x + y * y + z * z)


def _stretched(cosine: Float[Array, "*b"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """The same for a unit vector of this cosine and one α: √(cos² (1 - α²) + α²)."""
    a2 = alpha * alpha
    return jnp.sqrt((cosine - a2 * cosine) * cosine + a2)


def smith_correlated(
    n_dot_v: Float[Array, "*b"], n_dot_l: Float[Array, "*b"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """V = ½ / ((n·l) |αv| + (n·v) |αl|), |αv| = √((n·v)² (1 - α²) + α²): what is seen from one side is high, and more
    likely seen from the other.

    Gradient: exact.
    Source: Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", eq. 99.
    """
    return 0.5 / (n_dot_l * _stretched(n_dot_v, alpha) + n_dot_v * _stretched(n_dot_l, alpha))


def smith_correlated_anisotropic(
    v: Float[Array, "*b 3"], l: Float[Array, "*b 3"], alpha: Float[Array, "*b 2"]
) -> Float[Array, "*b"]:
    """`smith_correlated` of two α, v and l in the surface's own space: V = ½ / (l_z |αv| + v_z |αl|).

    Gradient: exact. Source: Heitz 2014, eqs. 87 and 99.

    Example:
        >>> v, l = jnp.array([0.6, 0.0, 0.8]), jnp.array([0.0, 0.6, 0.8])
        >>> f"{smith_correlated_anisotropic(v, l, jnp.array([0.2, 0.8])):.4f}"
        '0.3588'
    """
    return 0.5 / (l[..., 2] * stretched_length(v, alpha) + v[..., 2] * stretched_length(l, alpha))


def smith_separable(
    n_dot_v: Float[Array, "*b"], n_dot_l: Float[Array, "*b"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """V = 1 / ((n·v + |αv|) (n·l + |αl|)): G₁(v) G₁(l), as if light and viewer saw unrelated parts of the surface.

    Never above `smith_correlated`, the same where one of both is n, and far below where both graze: at n·v = 0.1 and
    α = ¼ white metal returns 0.854 instead of 0.892. Both cosines may be 0. Gradient: exact.
    Source: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces", eqs. 23 and 34.
    """
    return 1.0 / ((n_dot_v + _stretched(n_dot_v, alpha)) * (n_dot_l + _stretched(n_dot_l, alpha)))


def smith_fast(
    n_dot_v: Float[Array, "*b"], n_dot_l: Float[Array, "*b"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """V = ½ / (2 (n·v)(n·l) (1 - α) + (n·v + n·l) α): `smith_correlated` with |αv| fitted by n·v (1 - α) + α, no roots.

    Exact at α = 0 and 1 and never above; below by up to 29 %, 1 - 1/√2, where both cosines are α and small. White metal
    returns up to 0.03 less head on, and 0.21 less at n·v = 0.05. Gradient: exact of the fit.
    Source: Hammon 2017, "PBR Diffuse Lighting for GGX+Smith Microfacets"; as a fit of the roots in Filament's
    documentation, 4.4.2.
    """
    return 0.5 / (2.0 * n_dot_v * n_dot_l * (1.0 - alpha) + (n_dot_v + n_dot_l) * alpha)
