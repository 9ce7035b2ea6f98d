"""Pictures of all directions in equirectangular projection.

A direction (x, y, z) lies at u = atan2(z, x)/2π + ½ and v = acos(y)/π: row 0 is around +Y, the middle column towards
+X, and columns onwards turn to +Z, so that seen from inside u grows to the right. Texel centres are at half-integers.

Gradient: exact in texels; in directions that of the bilinear weights, which grows as 1/sin of the angle to a pole and
is 0 on it.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..math import safe
from ..math.angle import turns
from ..math.table import fetch


def directions(height: int, width: int) -> Float[Array, "h w 3"]:
    """Unit directions of the texel centres.

    Example:
        >>> directions(1, 1).tolist()
        [[[1.0, 0.0, 0.0]]]
    """
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    phi = ((np.arange(width) + 0.5) / width - 0.5) * (2.0 * np.pi)
    sine = np.sin(theta)[:, None]
    # Cosines of π/2 in the middle row and elsewhere are no 6e-17.
    unit = np.stack(np.broadcast_arrays(sine * np.cos(phi), np.cos(theta)[:, None], sine * np.sin(phi)), axis=-1)
    return jnp.asarray(np.where(np.abs(unit) < np.finfo(float).eps, 0.0, unit), jnp.result_type(float))


def solid_angles(height: int, width: int) -> Float[Array, " h"]:
    """What a texel of each row covers of the sphere, in sr: 4π/w sin(π/2h) sin θ, which is exact; all texels add up
    to 4π.

    Example:
        >>> solid_angles(2, 4).tolist() == [np.float32(np.pi / 2)] * 2
        True
    """
    theta = (np.arange(height) + 0.5) * (np.pi / height)
    bands = (4.0 * np.pi / width) * np.sin(0.5 * np.pi / height) * np.sin(theta)
    return jnp.asarray(bands, jnp.result_type(float))


def turned(direction: Float[Array, "*b 3"], rotation: Float[Array, "*#b"] | float) -> Float[Array, "*b 3"]:
    """R_y(rotation) · direction: +X goes to (cos, 0, -sin), counter-clockwise seen from above.

    Surroundings turned by an angle show along d what they showed along d turned by minus that angle.
    """
    cosine, sine = (f(jnp.asarray(rotation, direction.dtype)) for f in (jnp.cos, jnp.sin))
    x, y, z = (direction[..., i] for i in range(3))
    return jnp.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)


def uv(direction: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """Where a direction of any length lies in the picture, u and v in [0, 1].

    At the poles u is ½; a vector that is 0 or not finite counts as +Y.
    """
    known = jnp.isfinite(direction[..., 0] + direction[..., 1] + direction[..., 2])
    x, y, z = (jnp.where(known, direction[..., i], float(i == 1)) for i in range(3))
    # By the tangent: the arc cosine has an infinite slope at the poles, and leaves 3 digits of the angle near them.
    return turns(z, x) + 0.5, 2.0 * turns(safe.sqrt(x * x + z * z), y)


def lookup(texels: Float[Array, "h w 3"], direction: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """What lies in a direction, of any length but 0, weighed linearly between the four texels about it.

    Neighbours go on around the seam, and over a pole in the column half a turn away.

    Example:
        >>> black_and_white = jnp.array([[[0.0] * 3, [1.0] * 3]])
        >>> lookup(black_and_white, jnp.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))[:, 0].tolist()
        [1.0, 0.5, 0.0]
    """
    height, width, _ = texels.shape
    u, v = uv(direction)
    x, y = u * width - 0.5, v * height - 0.5
    left, top = (lax.stop_gradient(jnp.floor(c)) for c in (x, y))
    x_weight, y_weight = x - left, y - top
    left, top = (c.astype(jnp.int32) for c in (left, top))
    flat = texels.reshape(-1, 3)

    def add_texel(total, corner):
        right, low = corner
        line, column = top + low, left + right
        beyond = (line < 0) | (line >= height)
        line = jnp.clip(line, 0, height - 1)
        column = column + jnp.where(beyond, width // 2, 0)
        column = jnp.where(column < 0, column + width, jnp.where(column >= width, column - width, column))
        weight = jnp.where(right > 0, x_weight, 1.0 - x_weight) * jnp.where(low > 0, y_weight, 1.0 - y_weight)
        return total + weight[..., None] * fetch(flat, line * width + column).astype(u.dtype), None

    # Loop over the corners: unrolled, XLA would repeat everything above for each of them.
    corners = (jnp.array([0, 1, 0, 1], jnp.int32), jnp.array([0, 0, 1, 1], jnp.int32))
    return lax.scan(add_texel, jnp.zeros((*u.shape, 3), u.dtype), corners)[0]
