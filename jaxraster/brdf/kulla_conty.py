"""Light that is mirrored several times between microfacets as a lobe of its own: reciprocal, and what `compensation`,
which is cheaper, is compared against.

f = (1 - E(l)) (1 - E(v)) / (π (1 - Ē)) · F̄² Ē / (1 - F̄ (1 - Ē)), added to D V F, with E the albedo of a perfect mirror
and Ē its mean. The first factor returns, of all light, what the lobe of a perfect mirror loses; the second is what
remains of it when each bounce keeps F̄, the mean of F: the sum of F̄ⁿ Ē (1 - Ē)ⁿ⁻² from n = 2 bounces on.

Gradient: as of `energy`, exact in F̄.
Source: Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks", with F̄² for their F̄, which the sum
calls for.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .energy import Color, Value, mean_split_sum, split_sum

# Polished to the last ten-thousandth, where the table's own error is as large, nothing bounces twice.
MIN_LOST = 1e-4


def kulla_conty(n_dot_v: Value, n_dot_l: Value, alpha: Value, mean_fresnel: Color) -> Float[Array, "*b 3"]:
    """f, per steradian, for cosines in [0, 1]; F̄ of Schlick's Fresnel is f0 + (1 - f0)/21.

    Example:
        >>> alpha = jnp.array([1.0])
        >>> f = kulla_conty(jnp.array([1.0]), jnp.array([0.5]), alpha, jnp.ones((1, 3)))
        >>> f"{f[0, 0]:.4f}"
        '0.2051'
    """
    lost_v, lost_l = (1.0 - sum(split_sum(cosine, alpha)) for cosine in (n_dot_v, n_dot_l))
    a, b, *_ = mean_split_sum(alpha)
    kept = (a + b)[..., None]
    lost = jnp.maximum(1.0 - a - b, MIN_LOST)
    color = mean_fresnel * mean_fresnel * kept / (1.0 - mean_fresnel * (1.0 - kept))
    return (lost_l * lost_v / (jnp.pi * lost))[..., None] * color
