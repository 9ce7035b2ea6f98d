"""Screen triangles: snapped corners, the box of pixels they may cover, and the plane of their depth.

Both paths of the rasterizer draw from these numbers: a pixel gets the same bits whichever one its triangle takes.

Gradient: none. Barycentrics and depth are recomputed from the clip positions.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..math.table import apart
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


def _turn(x: Corners, y: Corners, depth: tuple[Floats, Floats, Floats]) -> tuple[Ints, Ints]:
    """Which corner is the farthest, highest, leftmost one, and the winding."""

    def before(i, j):
        level = (y[i] < y[j]) | ((y[i] == y[j]) & (x[i] < x[j]))
        return (depth[i] < depth[j]) | ((depth[i] == depth[j]) & level)

    first = jnp.where(before(1, 0), jnp.where(before(2, 1), 2, 1), jnp.where(before(2, 0), 2, 0))
    return first, winding(x, y)


def _plane(x: Corners, y: Corners, depth: tuple[Floats, Floats, Floats], turn: tuple[Ints, Ints]):
    """Corners clockwise from the first one on, and the rise of depth to the other two for each unit of area."""
    first, side = turn

    def turned(values):
        def corner(step):
            place = first + jnp.where(side < 0, 3 - step, step)
            place = jnp.where(place >= 3, place - 3, place)
            return jnp.where(place == 0, values[0], jnp.where(place == 1, values[1], values[2]))

        return corner(0), corner(1), corner(2)

    x, y, depth = turned(x), turned(y), turned(depth)
    inverse_area = 1.0 / to_float(edge(x[0], y[0], x[1], y[1], x[2], y[2]))
    return x, y, depth, ((depth[1] - depth[0]) * inverse_area, (depth[2] - depth[0]) * inverse_area)


def set_up(
    always: Bool[Array, ""], x: Corners, y: Corners, depth: tuple[Floats, Floats, Floats], height: int, width: int
) -> Triangle:
    """Triangles of snapped corners that have an area. `always` is a condition as `apart` needs one."""
    left, right, top, bottom = boxes(x, y, height, width)
    # Turn counter-clockwise ones, and start from the farthest corner: rounding is the same whatever the order was, and
    # what is added to the least depth does not cancel.
    turn = apart(always, _turn, x, y, depth)
    x, y, (d0, d1, d2), (rise1, rise2) = apart(always, _plane, x, y, depth, turn)

    # Span the plane by differences, which are exactly 0 for one parallel to the screen.
    px, py = position((left + right) >> 1, width), position((top + bottom) >> 1, height)
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
