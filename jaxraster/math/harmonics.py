"""Real spherical harmonics of the bands 0 to 2, and the irradiance of what they describe.

Nine coefficients L give radiance Σ L_k Y_k(d). Order and signs: 1; y, z, x; xy, yz, 3z² - 1, xz, x² - y², each times
its norm. The Y_k are orthonormal: ∫ Y_j Y_k dω = δ_jk.

A cosine about n multiplies band l by A_l = π, 2π/3, π/4. Band 3 and all odd ones above have A = 0, so that nine
coefficients leave out what the bands 4, 6, ... would add: -π/24, π/64, ... of theirs. Of constant and linear radiance,
and of that of a half space, nothing is left out. Of a light in one direction, of irradiance 1, E is off by 3/32 at most
and has the least value -0.0396, at a cosine of -8/15; see `irradiance`.

Gradient: exact.
Source: Ramamoorthi and Hanrahan 2001, "An Efficient Representation for Irradiance Environment Maps".
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Of each harmonic the factors of 1; x, y, z; xx, yy, zz, xy, yz, xz.
_PI = np.pi
_LINEAR, _MIXED = np.sqrt(3 / (4 * _PI)), np.sqrt(15 / (4 * _PI))
MONOMIALS = np.zeros((9, 10))
MONOMIALS[0, 0] = np.sqrt(1 / (4 * _PI))
MONOMIALS[[1, 2, 3], [2, 3, 1]] = _LINEAR
MONOMIALS[[4, 5, 7], [7, 8, 9]] = _MIXED
MONOMIALS[6, [4, 5, 6]] = np.sqrt(5 / (16 * _PI)) * np.array([-1.0, -1.0, 2.0])
MONOMIALS[8, [4, 5]] = 0.5 * _MIXED * np.array([1.0, -1.0])
# A_l / π of each.
COSINE = np.array([1.0] + [2 / 3] * 3 + [1 / 4] * 5)


def monomials(direction: Float[Array, "*b 3"]) -> list[Float[Array, "*b"]]:
    """1; x, y, z; xx, yy, zz, xy, yz, xz: what the harmonics are sums of."""
    x, y, z = (direction[..., i] for i in range(3))
    return [jnp.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, y * z, x * z]


def harmonics(direction: Float[Array, "*b 3"]) -> Float[Array, "*b 9"]:
    """All nine Y_k of unit directions.

    Example:
        >>> [f"{y:.3f}" for y in harmonics(jnp.array([0.0, 0.0, 1.0]))[:4]]
        ['0.282', '0.000', '0.489', '0.000']
    """
    parts = monomials(direction)
    return jnp.stack([sum(float(c) * p for c, p in zip(row, parts) if c) for row in MONOMIALS], axis=-1)


def irradiance(coefficients: Float[Array, "9 3"], normal: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Irradiance over π on a surface with that unit normal: Σ A_l/π L_k Y_k(n), and 0 where that is negative.

    Strong light from one side makes the sum slightly negative towards the other, where its truth is nearly 0.
    Gradient: exact; 0 where the sum is negative.
    """
    factors = jnp.asarray(COSINE[:, None] * MONOMIALS, coefficients.dtype)
    # A polynomial in the normal for each channel: fewer products than nine harmonics.
    weights = jnp.matmul(factors.T, coefficients, precision="highest")
    parts = monomials(normal)
    channels = [sum(weights[i, c] * part for i, part in enumerate(parts)) for c in range(3)]
    # Not a maximum, which would halve the gradient of surroundings that are black.
    return jnp.stack([jnp.where(channel < 0, 0.0, channel) for channel in channels], axis=-1)
