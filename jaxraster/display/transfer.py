"""Between linear light and sRGB codes, and how bright a colour is.

Source: IEC 61966-2-1:1999, with its rounded constants; the two pieces miss each other by 3e-8 at the threshold.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

# exp2(y log2 x) takes a third of the time of jnp.power on the CPU. Its error in float32, 2e-7, is small beside half a
# 16-bit code, 8e-6: every 8-bit and 16-bit code survives decoding, encoding and rounding.


def srgb_encode(linear: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Display-linear light in [0, 1] as sRGB values in [0, 1]: 1.055 x^(1/2.4) - 0.055, and 12.92 x up to 0.0031308.

    Nothing is clipped: the line goes on below 0, the power above 1. `tonemap` delivers [0, 1].
    Gradient: exact, 12.92 at 0 and below; at infinity alone it is NaN.
    """
    curved = linear > 0.0031308
    power = jnp.exp2(jnp.log2(jnp.where(curved, linear, 1.0)) / 2.4)
    # Write 1.055 p - 0.055 around p = 1, so that white is exactly 1 in float32.
    return jnp.where(curved, power + 0.055 * (power - 1.0), 12.92 * linear)


def srgb_decode(encoded: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """sRGB values in [0, 1] as linear light in [0, 1]: ((v + 0.055) / 1.055)^2.4, and v / 12.92 up to 0.04045.

    Nothing is clipped, as in `srgb_encode`.
    Gradient: exact, 1 / 12.92 at 0 and below.
    """
    curved = encoded > 0.04045
    power = jnp.exp2(jnp.log2((jnp.where(curved, encoded, 1.0) + 0.055) / 1.055) * 2.4)
    return jnp.where(curved, power, encoded / 12.92)


def luminance(rgb: Float[Array, "*b 3"]) -> Float[Array, "*b"]:
    """0.2126 R + 0.7152 G + 0.0722 B of linear Rec.709 light.

    Source: the Y row of IEC 61966-2-1's RGB to XYZ matrix, and ITU-R BT.709.
    Gradient: the weights.
    """
    return 0.2126 * rgb[..., 0] + 0.7152 * rgb[..., 1] + 0.0722 * rgb[..., 2]
