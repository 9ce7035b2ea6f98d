"""The sun seen through the air: its spectrum, and what air, haze and ozone let through.

exp(-m (0.008735 λ^-4.08 + β λ^-1.3 + 0.35 k)), λ in µm, k the ozone's absorption per cm, β = 0.04608 T - 0.04586 for a
turbidity T, and m = 1/(cos θ + 0.15 (93.885 - θ°)^-1.253) the relative mass of air, 36.5 at the horizon.
Water vapour and mixed gases absorb beyond 689 nm, where the eye hardly sees, and are left out.
Irradiance in lx, linear Rec.709, on a surface that faces the sun: 128 klx above the air, some 90 klx at noon.

Gradient: exact; 0 in a channel that the primaries cannot mix, which is cut at 0, and below the horizon.
Source: Preetham, Shirley & Smits 1999, "A Practical Analytic Model for Daylight", appendix A.1 and table 2; the eye's
curves are the fits of Wyman, Sloan & Shirley 2013, "Simple Analytic Approximations to the CIE XYZ Color Matching
Functions", eq. 4.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math.rec709 import LINEAR_FROM_XYZ

STEP = 10.0  # nm between the wavelengths, of which the first is 380 nm
SOLID_ANGLE = 6.8e-5  # sr, of the sun's disc
LUMENS = 683.0  # of a watt where the eye sees most
# The sun's radiance above the air, in 100 W/(m² nm sr), and the ozone's absorption, 1/cm, to 720 nm.
SUN = np.ravel(
    [
        [165.5, 162.3, 211.2, 258.8, 258.2, 242.3, 267.6],
        [296.6, 305.4, 300.6, 306.6, 288.3, 287.1, 278.2],
        [271.0, 272.3, 263.6, 255.0, 250.6, 253.1, 253.5],
        [251.3, 246.3, 241.7, 236.8, 232.1, 228.2, 223.4],
        [219.7, 215.3, 211.0, 207.3, 202.4, 198.7, 194.3],
    ]
)
OZONE = np.ravel(
    [
        [0, 0, 0, 0, 0, 0, 0],
        [0.003, 0.006, 0.009, 0.014, 0.021, 0.030, 0.040],
        [0.048, 0.063, 0.075, 0.085, 0.103, 0.120, 0.120],
        [0.115, 0.125, 0.120, 0.105, 0.090, 0.079, 0.067],
        [0.057, 0.048, 0.036, 0.028, 0.023, 0.018, 0.014],
    ]
)
WAVELENGTH = 380.0 + STEP * np.arange(len(SUN))
# The eye's curves for X, Y and Z as sums of lobes: weight, middle (nm), and 1/width to the left and right of it.
LOBES = (
    ((0.362, 442.0, 0.0624, 0.0374), (1.056, 599.8, 0.0264, 0.0323), (-0.065, 501.1, 0.0490, 0.0382)),
    ((0.821, 568.8, 0.0213, 0.0247), (0.286, 530.9, 0.0613, 0.0322)),
    ((1.217, 437.0, 0.0845, 0.0278), (0.681, 459.0, 0.0385, 0.0725)),
)


def matching(nm: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3 n"]:
    """The eye's curves X, Y and Z at some wavelengths."""

    def lobe(weight, middle, left, right):
        return weight * np.exp(-0.5 * ((nm - middle) * np.where(nm < middle, left, right)) ** 2)

    return np.stack([sum(lobe(*one) for one in lobes) for lobes in LOBES])


# The light of each wavelength above the air as linear Rec.709, lx.
LIGHT = LINEAR_FROM_XYZ @ matching(WAVELENGTH) * (SUN * (100.0 * SOLID_ANGLE * LUMENS * STEP))


def sunlight(zenith: Float[Array, ""], turbidity: Float[Array, ""]) -> Float[Array, "3"]:
    """Irradiance from a sun `zenith` radians from straight above; as at the horizon where it is lower.

    Example:
        >>> (sunlight(jnp.array(0.5), jnp.array(3.0)) // 1000.0).tolist()
        [101.0, 85.0, 72.0]
    """
    zenith = jnp.minimum(zenith, 0.5 * jnp.pi)
    mass = 1.0 / (jnp.cos(zenith) + 0.15 * (93.885 - zenith * (180.0 / jnp.pi)) ** -1.253)
    um, light, ozone = (jnp.asarray(x, mass.dtype) for x in (1e-3 * WAVELENGTH, LIGHT, 0.35 * OZONE))  # µm of a nm
    depth = 0.008735 * um**-4.08 + (0.04608 * turbidity - 0.04586) * um**-1.3 + ozone
    return jnp.maximum(jnp.sum(light * jnp.exp(-mass * depth)[None], axis=-1), 0.0)
