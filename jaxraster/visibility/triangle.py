"""Screen triangles: snapped corners, the box of pixels they may cover, and the plane of their depth.

Both paths of the rasterizer draw from these numbers: a pixel gets the same bits whichever one its triangle takes.

Gradient: none. Barycentrics and depth are recomputed from the clip positions.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from .fixed_point import SUBPIXELS, edge, pixels_inside, sign, snap, to_float

Ints = Int[Array, " n"]
Floats = Float[Array, " n"]
Corners = tuple[Ints, Ints, Ints]


class Triangle(NamedTuple):
    """Triangles with their corners in clockwise order on the screen, from the farthest, highest, leftmost one on.

    `left` to `bottom` is the box of pixel centres inside the picture, empty where left > right or top > bottom.
    Depth at pixel (column, line) is `depth + slope_y·(line - middle_y) + slope_x·(column - middle_x)`, at least `least`
    and at most `most`: those are bits of floats, never negative, that compare like the floats.
    """

    x: Corners
    y: Corners
    left: Ints
    right: Ints
    top: Ints
    bottom: Ints
    depth: Floats
    slope_x: Floats
    slope_y: Floats
    least: Ints
    most: Ints

    @property
    def middle(self) -> tuple[Ints, Ints]:
        """The pixel at which `depth` holds."""
        return (self.left + self.right) >> 1, (self.top + self.bottom) >> 1


def screen(clip: Float[Array, "*b 4"], height: int, width: int):
    """Snapped x and y, and depth, of vertices whose w is positive; NaN elsewhere is somebody else's to mask."""
    inverse = 1.0 / clip[..., 3]
    x = snap(clip[..., 0] * inverse * (0.5 * width))
    y = snap(-clip[..., 1] * inverse * (0.5 * height))
    return x, y, clip[..., 2] * inverse


def _centres(values: Corners, size: int) -> tuple[Ints, Ints]:
    """The first and last pixel whose centre lies between the least and the greatest value, inside the picture."""
    low = jnp.minimum(jnp.minimum(values[0], values[1]), values[2])
    high = jnp.maximum(jnp.maximum(values[0], values[1]), values[2])
    half = (size - 1) * (SUBPIXELS // 2)
    first = -((-low - half) // SUBPIXELS)
    return jnp.maximum(first, 0), jnp.minimum((high + half) // SUBPIXELS, size - 1)


def boxes(x: Corners, y: Corners, height: int, width: int) -> tuple[Ints, Ints, Ints, Ints]:
    """left, right, top, bottom of the pixel centres a triangle may cover."""
    return *_centres(x, width), *_centres(y, height)


def winding(x: Corners, y: Corners) -> Ints:
    """1 clockwise on the screen, -1 counter-clockwise (a front face), 0 without area."""
    return sign(edge(x[0], y[0], x[1], y[1], x[2], y[2]))


def position(pixel: Ints, size: int) -> Ints:
    """A pixel centre's coordinate in 1/256 pixel from the picture's centre."""
    return pixel * SUBPIXELS - (size - 1) * (SUBPIXELS // 2)


def set_up(x: Corners, y: Corners, depth: tuple[Floats, Floats, Floats], height: int, width: int) -> Triangle:
    """Triangles of snapped corners that have an area."""
    # Turn counter-clockwise ones, then start from the farthest corner: rounding is the same whatever the order was, and
    # what is added to the least depth does not cancel.
    back = winding(x, y) < 0
    start, one, two = zip(x, y, depth)
    corners = (start, *([jnp.where(back, a, b) for a, b in zip(*turned)] for turned in ((two, one), (one, two))))

    def before(p, q):
        level = (p[1] < q[1]) | ((p[1] == q[1]) & (p[0] < q[0]))
        return (p[2] < q[2]) | ((p[2] == q[2]) & level)

    second = before(corners[1], corners[0]) & before(corners[1], corners[2])
    third = before(corners[2], corners[0]) & before(corners[2], corners[1])
    order = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    corners = [
        tuple(jnp.where(second, b, jnp.where(third, c, a)) for a, b, c in zip(*(corners[i] for i in turn)))
        for turn in order
    ]
    x, y, (d0, d1, d2) = zip(*corners)

    # Span the plane by differences, which are exactly 0 for one parallel to the screen.
    left, right, top, bottom = boxes(x, y, height, width)
    px, py = position((left + right) >> 1, width), position((top + bottom) >> 1, height)
    inverse_area = 1.0 / to_float(edge(x[0], y[0], x[1], y[1], x[2], y[2]))
    rise1, rise2 = (d1 - d0) * inverse_area, (d2 - d0) * inverse_area
    at1 = to_float(edge(x[2], y[2], x[0], y[0], px, py))
    at2 = to_float(edge(x[0], y[0], x[1], y[1], px, py))
    differences = (y[2] - y[0], y[0] - y[1], x[0] - x[2], x[1] - x[0])
    step = [(difference * SUBPIXELS).astype(jnp.float32) for difference in differences]

    def bits(value):
        return lax.bitcast_convert_type(jnp.maximum(value, 0.0), jnp.int32)

    return Triangle(
        x=x,
        y=y,
        left=left,
        right=right,
        top=top,
        bottom=bottom,
        depth=d0 + (at1 * rise1 + at2 * rise2),
        slope_x=step[0] * rise1 + step[1] * rise2,
        slope_y=step[2] * rise1 + step[3] * rise2,
        least=bits(jnp.minimum(jnp.minimum(d0, d1), d2)),
        most=bits(jnp.maximum(jnp.maximum(d0, d1), d2)),
    )


def edges_at(triangle: Triangle, column: Ints, line: Ints, height: int, width: int):
    """Per edge (value, per pixel to the right, per line down): a pixel is inside where all three are at least 0."""
    px, py = position(column, width), position(line, height)
    (x0, x1, x2), (y0, y1, y2) = triangle.x, triangle.y
    found = []
    for ax, ay, bx, by in ((x1, y1, x2, y2), (x2, y2, x0, y0), (x0, y0, x1, y1)):
        dx, dy = bx - ax, by - ay
        found.append((pixels_inside(edge(ax, ay, bx, by, px, py), dx, dy), -dy, dx))
    return found


def nearness(depth, slope_x, slope_y, least, most, right, down) -> Int[Array, "..."]:
    """Bits of the depth so many pixels to the right of and below the middle, comparable as integers.

    Clamped, for slivers' planes overshoot; as integers, for then a NaN of overflowing slopes is clamped too.
    """
    value = (depth + slope_y * down) + slope_x * right
    return jnp.minimum(jnp.maximum(lax.bitcast_convert_type(value, jnp.int32), least), most)
