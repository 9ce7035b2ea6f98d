"""Light on a surface that scatters alike to all sides: irradiance over π, for every normal.

Twice: as nine coefficients of harmonics (`math/harmonics` says what they leave out), and as a small octahedral image,
which follows strong lights of any size but costs an access to memory for each pixel.

Gradient: exact; both are linear in the texels.
Source: Ramamoorthi and Hanrahan 2001, "An Efficient Representation for Irradiance Environment Maps".
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math.harmonics import MONOMIALS
from . import octahedral
from .blur import blurred, resized

CELLS = 32  # along a quadrant: E of light from one direction is off by 1.3 % of its greatest at most, where it sets
ROWS = 128  # of the picture that it is made of, whose texels count at their centres


def coefficients(texels: Float[Array, "h w 3"]) -> Float[Array, "9 3"]:
    """∫ L Y_k dω of a picture whose texels are boxes of constant radiance: exact, whatever its size.

    Example:
        >>> [f"{abs(x):.3f}" for x in coefficients(jnp.ones((1, 1, 3)))[:4, 0]]
        ['3.545', '0.000', '0.000', '0.000']
    """
    height, width, _ = texels.shape
    theta, phi = np.linspace(0.0, np.pi, height + 1), np.linspace(-np.pi, np.pi, width + 1)
    # Integrate over each row's angle and each column's: sin θ times a power of sin θ and one of cos θ, and a wave.
    s, c = np.sin(theta), np.cos(theta)
    rows = {
        "1": -c,
        "c": -0.5 * c * c,
        "cc": -(c**3) / 3.0,
        "s": 0.5 * (theta - s * c),
        "sc": s**3 / 3.0,
        "ss": c**3 / 3.0 - c,
    }
    double = 0.25 * np.sin(2.0 * phi)
    columns = {"1": phi, "c": np.sin(phi), "s": -np.cos(phi)}
    columns |= {"cc": 0.5 * phi + double, "ss": 0.5 * phi - double, "sc": 0.5 * np.sin(phi) ** 2}
    # x = sin θ cos φ, y = cos θ, z = sin θ sin φ, in the order of the monomials.
    pairs = "1 1", "s c", "c 1", "s s", "ss cc", "cc 1", "ss ss", "sc c", "sc s", "ss sc"
    down, across = (
        jnp.asarray(np.stack([np.diff(of[pair.split()[i]]) for pair in pairs]), texels.dtype)
        for i, of in enumerate((rows, columns))
    )
    moments = jnp.einsum("mh,mw,hwk->mk", down, across, texels, precision="highest")
    return jnp.matmul(jnp.asarray(MONOMIALS, texels.dtype), moments, precision="highest")


def irradiance(texels: Float[Array, "h w 3"]) -> Float[Array, "i 12"]:
    """The octahedral image's table, for `octahedral.lookup` with CELLS."""
    around = blurred(resized(texels, ROWS, 2 * ROWS), jnp.ones((), texels.dtype))
    return octahedral.table(octahedral.sampled(around, CELLS))
