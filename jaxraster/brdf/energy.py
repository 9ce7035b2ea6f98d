"""How much of uniform light a rough surface mirrors in all directions together: the split sum of the GGX lobe.

Off the integrals by at most 0.0022 for n·v above 0.001 and roughness above 0.045, 0.0008 for n·v above 0.08; the means
by 1e-4 (measured by the tests). Cosines and α in [0, 1]. A ratio of polynomials, as in MaterialX 1.38, is worked out in
0.5 ms for 512² elements on one core, this table in 1.2 ms; but it is off by up to 0.1, and 1/E is to be multiplied by.

Gradient: exact of the interpolated table, whose slope steps at nodes; 0 where n·v or α is below 1e-12.
Source: Karis 2013, "Real Shading in Unreal Engine 4"; the table is our own.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math.table import fetch
from .energy_table import SIDE, SMALLEST, tables

Value = Float[Array, "*b"]
Color = Float[Array, "*b 3"]


def _place(x: Value) -> tuple:
    """The cell of ⁴√x along an axis of the table, and where in it."""
    at = (SIDE - 1) * jnp.sqrt(jnp.sqrt(jnp.maximum(x, SMALLEST)))
    # Clip for NaN alone, which is no row.
    cell = jnp.clip(at.astype(jnp.int32), 0, SIDE - 2)
    return cell, at - cell.astype(x.dtype)


def split_sum(cosine: Value, alpha: Value) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """(A, B): of f0 and of f90, the share that is mirrored in all directions. A + B is the albedo of a perfect mirror.

    One row of the table is fetched for each element, that of its cell.

    Example:
        >>> a, b = split_sum(jnp.array(1.0), jnp.array(1.0))
        >>> f"{a + b:.4f} is 1 - ln 2"
        '0.3069 is 1 - ln 2'
    """
    (i, x), (j, y) = _place(cosine), _place(alpha)
    row = fetch(jnp.asarray(tables().cells, cosine.dtype), i * (SIDE - 1) + j)
    a, b = (row[..., k] + x * row[..., k + 2] + y * (row[..., k + 4] + x * row[..., k + 6]) for k in (0, 1))
    return a, b


def mean_split_sum(alpha: Value) -> tuple:
    """2 ∫ … μ dμ of A, B, A/E - A and B/E - B, the average over the hemisphere's cosine; E = A + B."""
    roughness = jnp.sqrt(jnp.maximum(alpha, SMALLEST))
    means = [jnp.zeros_like(alpha)] * 4
    for row in tables().means[::-1]:
        means = [mean * roughness + float(coefficient) for mean, coefficient in zip(means, row)]
    return tuple(means)


def directional_albedo(f0: Color, cosine: Value, alpha: Value, f90: float | Value = 1.0) -> Float[Array, "*b 3"]:
    """∫ D V F (n·l) dl = f0·A + f90·B of light that is mirrored once."""
    a, b = split_sum(cosine, alpha)
    return f0 * a[..., None] + (f90 * b)[..., None]
