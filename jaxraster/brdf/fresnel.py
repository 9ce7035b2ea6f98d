"""F: the share of light a microfacet mirrors."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def schlick(
    f0: Float[Array, "*b 3"], cosine: Float[Array, "*b"], f90: float | Float[Array, "*b"] = 1.0
) -> Float[Array, "*b 3"]:
    """F = f0 + (f90 - f0)(1 - cos)⁵; the cosine is clamped to [0, 1], as a rounded product of unit vectors may pass 1.

    f90, the share at grazing angles, is 1 in nature; an authored weight of the reflection scales it as it does f0.

    Gradient: exact inside (0, 1), halved at the clamp's two ends.
    Source: Schlick 1994, "An Inexpensive BRDF Model for Physically-based Rendering", eq. 15.
    """
    x = 1.0 - jnp.clip(cosine, 0.0, 1.0)
    x2 = x * x
    weight = (x2 * x2 * x)[..., None]
    return f0 + (jnp.broadcast_to(f90, cosine.shape)[..., None] - f0) * weight
