"""The two colour spaces of ꟻLIP: one in which the eye's blur is told, and one in which equal distances look equal.

Colours are three planes of any shape; X, Y and Z are relative to white, so that white is (1, 1, 1).
Source: Andersson et al. 2020, "FLIP", sections 4.1 and 4.2; Hunt's effect and HyAB as there.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math import rec709, safe

Plane = Float[Array, "*b"]
Color = tuple[Plane, Plane, Plane]

# Relative to white, which is 1, 1, 1 here.
XYZ_FROM_LINEAR = rec709.XYZ_FROM_LINEAR / rec709.WHITE[:, None]
LINEAR_FROM_XYZ = np.linalg.inv(XYZ_FROM_LINEAR)
# CIE 1976: below CORNER³ the cube root, infinitely steep at 0, gives way to a line.
CORNER = 6.0 / 29.0


def _mix(matrix: np.ndarray, color: Color) -> list[Plane]:
    """matrix · color, written out: a matrix unit would round to 10 bits."""
    x, y, z = color
    return [a * x + b * y + c * z for a, b, c in matrix.tolist()]


def opponent_from_linear(color: Color) -> Color:
    """Y, X - Y and Y - Z of linear Rec.709: brightness, red-green and blue-yellow. YCxCz without its scales and its
    offset, which the filters between here and `linear_from_opponent` would leave alone. Gradient: the weights."""
    x, y, z = _mix(XYZ_FROM_LINEAR, color)
    return y, x - y, y - z


def linear_from_opponent(opponent: Color) -> Color:
    """Linear Rec.709 in [0, 1]; what a filter makes of it beyond that is clipped. Gradient: 0 where clipped."""
    y, red_green, blue_yellow = opponent
    red, green, blue = _mix(LINEAR_FROM_XYZ, (y + red_green, y, y - blue_yellow))
    return jnp.clip(red, 0.0, 1.0), jnp.clip(green, 0.0, 1.0), jnp.clip(blue, 0.0, 1.0)


def _root(t: Plane) -> Plane:
    """CIE's ∛t, and the line that touches it at CORNER³ below. exp2 of log2 costs a third of a power."""
    curved = t > CORNER**3
    root = jnp.exp2(jnp.log2(jnp.where(curved, t, 1.0)) / 3.0)
    return jnp.where(curved, root, t / (3.0 * CORNER**2) + 4.0 / 29.0)


def hunt_lab(linear: Color) -> Color:
    """CIELAB of linear Rec.709 with a and b times L/100: in the dark, colours look less colourful.

    Gradient: exact.
    """
    x, y, z = (_root(t) for t in _mix(XYZ_FROM_LINEAR, linear))
    lightness = 116.0 * y - 16.0
    return lightness, 5.0 * lightness * (x - y), 2.0 * lightness * (y - z)


def hyab(first: Color, second: Color) -> Plane:
    """|ΔL| + √(Δa² + Δb²): large differences in brightness and in colour add up.

    Gradient: exact where the colours differ; finite, and 0 in a and b, where they do not.
    """
    lightness, a, b = (one - other for one, other in zip(first, second))
    return jnp.abs(lightness) + safe.sqrt(a * a + b * b)
