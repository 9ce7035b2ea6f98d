"""V: how much of that area both the light and the viewer see, over 4 (n·l)(n·v)."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def smith_correlated(
    n_dot_v: Float[Array, "*b"], n_dot_l: Float[Array, "*b"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """V = ½ / ((n·l) √((n·v)² (1 - α²) + α²) + (n·v) √((n·l)² (1 - α²) + α²)), height-correlated.

    Cosines in [0, 1], of which one may be 0 but not both, α > 0. Gradient: exact.
    Source: Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", eq. 99.
    """
    a2 = alpha * alpha
    view = n_dot_l * jnp.sqrt((n_dot_v - a2 * n_dot_v) * n_dot_v + a2)
    light = n_dot_v * jnp.sqrt((n_dot_l - a2 * n_dot_l) * n_dot_l + a2)
    return 0.5 / (view + light)
