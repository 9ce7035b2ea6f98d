"""An error map as a picture, in colours that get brighter with the error."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .score import Map

# Every 16th of the 256 sRGB colours of magma, which ꟻLIP is usually shown in; straight lines between them stay within
# 3 codes of the rest. Source: Smith and van der Walt 2015, matplotlib's colour maps (CC0).
MAGMA = """
000004 0a0822 1d1146 36106a 50127c 691c81 822681 9c2e7f b63779 cf4170 e65163 f5695c fb8761 fea571 fec387 fde0a2 fcfdbf
"""
_COLORS = np.array([list(bytes.fromhex(color)) for color in MAGMA.split()]) / 255.0
UNDEFINED = np.array([0.0, 1.0, 0.0])  # green, which magma does not have


def heat(errors: Map) -> Float[Array, "h w 3"]:
    """Errors from 0, black, through violet, red and orange to 1, pale yellow, as display-encoded colours in [0, 1].

    The scale is the same for every map: what is beyond 0 or 1 has the colour of the end, and NaN is green.
    Gradient: of the lines between colours; 0 beyond the ends.

    Example:
        >>> (255 * heat(jnp.array([[0.0, 0.5, 1.0]]))).astype(int).tolist()
        [[[0, 0, 4], [182, 55, 121], [252, 253, 191]]]
    """
    places = jnp.linspace(0.0, 1.0, len(_COLORS), dtype=errors.dtype)
    colors = [jnp.interp(errors, places, jnp.asarray(column, errors.dtype)) for column in _COLORS.T]
    undefined = jnp.isnan(errors)
    return jnp.stack([jnp.where(undefined, float(c), color) for c, color in zip(UNDEFINED, colors)], axis=-1)
