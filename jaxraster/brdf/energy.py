"""How much of uniform light a rough surface mirrors in all directions together."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def directional_albedo(
    f0: Float[Array, "*b 3"],
    n_dot_v: Float[Array, "*b"],
    alpha: Float[Array, "*b"],
    f90: float | Float[Array, "*b"] = 1.0,
) -> Float[Array, "*b 3"]:
    """∫ D V F (n·l) dl = f0·A + f90·B of the single-scattering GGX lobe, fitted by two ratios of biquadratics.

    For roughness from 0.045 to 1 and n·v from 0.05 it is off the integral by at most 0.08 in A + B and 0.025 in B,
    from 0.01 by 0.1 and 0.04 (measured by the tests). Never above 1, so that what is left for the diffuse is not
    negative. Gradient: exact of the fit, 0 where A, B or the sum is clamped to [0, 1].

    Source: the coefficients are those of MaterialX 1.38's `mx_ggx_dir_albedo_analytic`.
    """
    # Rows: numerators of A and B, then their denominators.
    coefficients = {
        (0, 0): (0.1003, 0.9345, 1.0, 1.0),
        (1, 0): (-0.6303, -2.323, -1.765, 0.2281),
        (0, 1): (9.748, 2.229, 8.263, 15.94),
        (1, 1): (-2.038, -3.748, 11.53, -55.83),
        (2, 0): (29.34, 1.424, 28.96, 13.08),
        (0, 2): (-8.245, -0.7684, -7.507, 41.26),
        (2, 1): (-26.44, 1.436, -36.11, 54.9),
        (1, 2): (19.99, 0.2913, 15.86, 300.2),
        (2, 2): (-5.448, 0.6286, 33.37, -285.1),
    }
    terms = {(i, j): n_dot_v**i * alpha**j for i, j in coefficients}
    sums = [sum(c[row] * terms[power] for power, c in coefficients.items()) for row in range(4)]
    a, b = (jnp.clip(sums[row] / sums[row + 2], 0.0, 1.0)[..., None] for row in (0, 1))
    return jnp.minimum(f0 * a + jnp.broadcast_to(f90, alpha.shape)[..., None] * b, 1.0)
