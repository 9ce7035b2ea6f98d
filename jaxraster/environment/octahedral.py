"""All directions on an octahedron, its faces cut into triangles, with numbers in between mixed linearly.

Its four quadrants, x and z of either sign, are squares [0, 1]² with +Y at (0, 0), the horizon as one diagonal and -Y at
(1, 1); each has `cells`² cells, cut along that diagonal. Edges of the octahedron are edges of triangles, and neighbours
share the numbers at their corners: no seam, no border and no fold within a triangle, where weights of four texels in
the usual unfolded square would be off by as much as numbers change over half a texel.

A table has a row for each cell, with the numbers at its four corners: one access for a lookup.

Gradient: exact in numbers; in directions that of the linear pieces, one-sided at their edges.
Source: the octahedron as in Engelhardt and Dachsbacher 2008, "Octahedron Environment Maps"; its triangles are ours.
"""

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..math import safe
from ..math.table import fetch, once
from . import equirect

Number = Float[Array, "*b"]
Whole = Int[Array, "*b"] | int
Cell = tuple[Int[Array, "*b"], Number, Number]  # a row or quadrant, and where in it, across and along


def directions(cells: int) -> Float[Array, "4 n n 3"]:
    """Unit directions of all cells' corners, n = cells + 1: quadrants x, z = ++, -+, +-, --, lines away from x = 0.

    Example:
        >>> directions(1)[0].tolist()
        [[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]]
    """
    z, x = np.meshgrid(*[np.arange(cells + 1) / cells] * 2, indexing="ij")
    height = 1.0 - x - z
    x, z = (np.where(height < 0, 1.0 - other, one) for one, other in ((x, z), (z, x)))
    # A sum with 0 leaves no -0, so that quadrants share their borders to the bit.
    point = np.stack([[sign_x * x + 0.0, height, sign_z * z + 0.0] for sign_z in (1, -1) for sign_x in (1, -1)])
    return jnp.asarray(np.moveaxis(point / np.linalg.norm(point, axis=1, keepdims=True), 1, -1), jnp.result_type(float))


def sampled(texels: Float[Array, "h w 3"], cells: int) -> Float[Array, "4 n n 3"]:
    """An equirectangular picture at all cells' corners."""
    # Behind a barrier: the compiler would work the angles of known directions out itself, which takes it a minute.
    return equirect.lookup(texels, lax.optimization_barrier(directions(cells).astype(texels.dtype)))


def table(corners: Float[Array, "4 n n c"]) -> Float[Array, "r k"]:
    """The numbers at all corners as a row of 4 c for each cell."""
    parts = [corners[:, i : corners.shape[1] - 1 + i, j : corners.shape[1] - 1 + j] for i in (0, 1) for j in (0, 1)]
    return jnp.concatenate(parts, axis=-1).reshape(-1, 4 * corners.shape[-1])


def place(direction: Float[Array, "*b 3"]) -> Cell:
    """Which quadrant a direction of any length lies in, and where in its square; at +Y for a length of 0."""
    x, y, z = (direction[..., i] for i in range(3))
    scale = safe.divide(jnp.ones_like(x), jnp.abs(x) + jnp.abs(y) + jnp.abs(z))
    across, along = jnp.abs(x) * scale, jnp.abs(z) * scale
    across, along = (jnp.where(y < 0, 1.0 - other, one) for one, other in ((across, along), (along, across)))
    return jnp.where(x < 0, 1, 0) + jnp.where(z < 0, 2, 0), across, along


def cell(at: Cell, cells: Whole, offset: Whole = 0) -> Cell:
    """The row for a `place` in a table of so many cells that starts at row `offset`, and where in that cell it lies."""
    quadrant, across, along = at
    cells = jnp.asarray(cells, jnp.int32)
    across, along = (c * cells.astype(c.dtype) for c in (across, along))
    # The far border belongs to the last cell; clip for NaN, too, which is in none.
    column, line = (jnp.clip(c.astype(jnp.int32), 0, cells - 1) for c in (across, along))
    row = offset + (quadrant * cells + line) * cells + column
    return row, across - column.astype(across.dtype), along - line.astype(along.dtype)


def mixed(rows: Float[Array, "n 12"], at: Cell) -> Float[Array, "*b 3"]:
    """What a table holds at that place of a cell: the weights of three corners of a triangle, and 0 for the fourth."""
    row, across, along = at
    beyond = across + along - 1.0
    near, far = jnp.where(beyond < 0, -beyond, 0.0), jnp.where(beyond < 0, 0.0, beyond)
    weights = (near, 1.0 - along - near, 1.0 - across - near, far)
    numbers = fetch(rows, row)
    parts = [weight[..., None] * numbers[..., 3 * i : 3 * i + 3] for i, weight in enumerate(weights)]
    return parts[0] + parts[1] + parts[2] + parts[3]


def lookup(rows: Float[Array, "n 12"], direction: Float[Array, "*b 3"], cells: int) -> Float[Array, "*b 3"]:
    """What the table of so many cells holds in each direction."""
    # In two steps: row and weights must agree on the cell, so that both start from the same rounded numbers.
    quadrant, *within = once(place, direction)
    return mixed(rows, once(lambda *within: cell((quadrant, *within), cells), *within))
