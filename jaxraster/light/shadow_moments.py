"""A shadow with a gradient: the mean and the variance of the depths about a place, and the bound that these two set.

Of depths with mean μ and variance σ², at least 1 - σ² / (σ² + (μ - t)²) are above t < μ (Cantelli), so that a place at
t counts as lit for

    (σ² + b²) / (σ² + b² + (μ - t)²) where t < μ, else 1, with the bias b:

the very share of a box where one flat caster is above one flat receiver, and too much light where several casters at
different heights are (light bleeding: up to a quarter for one three times as high as the other). Depths are averaged
before they are compared, so that this is smooth, and has a slope everywhere but in the light. The bias is a deviation,
not a distance: no place is dark at once, and h below a flat caster b² / h² of the light is left.

Why two moments: a plane's mean over a box is the plane, so that it is lit however steep it is. Four moments find 5/18
of a plane in its own shadow, exponents 1 - 1 / (1 + s²/12) of one that rises by s of them across half a box, and
float32 holds none above 44. Variances are added up by the law of total variance, over lines, columns and the lookup:
nothing cancels, none is negative, and none is lost in the rounding of squares.

Gradient: in the receiver, the light, and the vertices: exact where one face fills the box. A silhouette moves by whole
texels, which has none; what it sweeps over is put in its place, as the nearer surface's own motion times the jump in
depth, half of it in either texel, so that where a shadow lies has a gradient, too. The bound's slopes for that are
those of a box in which the silhouette has already swept a little: in a box of no variance the first bit of another
depth counts a thousandfold, but only for the first thousandth of a texel. They add up to 1 - 1 / (4 width) of what
geometry says of a lone edge; of all of the stage, whose shadows are few texels wide, up to 2.5 times as much (by the
tests). What a silhouette uncovers is taken to be as deep as the texel beside it.
Source: Donnelly & Lauritzen 2006, "Variance Shadow Maps". Worchel & Alexa 2023, "Differentiable Shadow Mapping for
Efficient Inverse Graphics", antialias the map's silhouettes instead.
"""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..buffers import Visibility
from ..math import safe
from ..math.table import fetch
from ..visibility.barycentric import interpolate
from ..visibility.raster import rasterize, rasterize_depth
from .shadow_frame import LightView, Receiver, light_clip, receiver

NOTHING = -1.0  # the depth of an empty texel: as far below all casters as these are deep, for it shadows nobody
Picture = Float[Array, "h w"]
Moments = tuple[Float[Array, "..."], Float[Array, "..."]]  # mean and variance
# The map: depths; and what texels' means and variances change by as silhouettes move, of value 0.
Drawn = tuple[Picture, Picture, Picture]


def _pairs(picture: Float[Array, "h w"] | Int[Array, "h w"], axis: int):
    """Neighbours along an axis."""
    count = picture.shape[axis]
    return lax.slice_in_dim(picture, 0, count - 1, axis=axis), lax.slice_in_dim(picture, 1, count, axis=axis)


def _windows(picture: Picture, width: int, axis: int) -> list[Array]:
    """So many pictures, each shifted by one more."""
    count = picture.shape[axis] - width + 1
    return [lax.slice_in_dim(picture, k, k + count, axis=axis) for k in range(width)]


def _swept(depth: Picture, moved: Picture, face: Int[Array, "h w"], axis: int) -> Drawn:
    """What texels' depths, means and variances change by as their contents move along an axis: derivatives, of value 0.

    A border between depths a and b that moves by d turns d of b into a: half of it in each of the two texels, whose
    means change by (a - b) d / 2, and whose variances by ∓(a - b)² d / 2. Within a surface that is its depth's slope.
    """
    (a, b), (moved_a, moved_b), (face_a, face_b) = (_pairs(part, axis) for part in (depth, moved, face))
    jump = a - b
    # One surface goes on where its depth does: by the same face, or by as much as before or behind.
    more = [(1, 1) if k == axis else (0, 0) for k in (0, 1)]
    before, _, behind = _windows(jnp.pad(jump, more), 3, axis)
    inner = (face_a == face_b) | (4.0 * jump * before >= jump * jump) | (4.0 * jump * behind >= jump * jump)
    # There the border moves as the mean, so that planes have their exact slope; else with what is nearer.
    slope = jnp.where(inner, 0.25 * jump * (moved_a + moved_b), 0.0)
    border = jnp.where(inner, 0.0, 0.5 * jnp.where(a > b, moved_a, moved_b))
    mean, variance = jump * border, jump * jump * border
    first, second = ([(0, 0)] * axis + [pad] + [(0, 0)] * (1 - axis) for pad in ((0, 1), (1, 0)))

    def both(part, sign=1.0):
        return sign * jnp.pad(part, first) + jnp.pad(part, second)

    return both(slope), both(mean), both(variance, -1.0)


def _followed(view: LightView, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], seen: Visibility) -> Drawn:
    """`texels` as what each shows moves."""
    points = interpolate(vertices, faces, seen)
    # Each texel's place and depth are those of the very point that it shows; its plane's slope goes unused.
    place = receiver(view, points, jnp.zeros_like(points))
    depth = jnp.where(seen.face >= 0, place.depth, NOTHING)
    still, within = lax.stop_gradient(depth), depth
    mean = variance = jnp.zeros_like(depth)
    for axis, position in enumerate((place.y, place.x)):
        inner, *swept = _swept(still, position - lax.stop_gradient(position), seen.face, axis)
        within, mean, variance = within + inner, mean + swept[0], variance + swept[1]
    return within, mean, variance


def _cleared(nearness: Picture, dtype) -> Drawn:
    depth = jnp.where(nearness > 0, nearness, NOTHING).astype(dtype)
    return depth, jnp.zeros_like(depth), jnp.zeros_like(depth)


@jax.custom_jvp
def texels(view: LightView, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Drawn:
    """The map: each texel's depth is that of the nearest triangle at its centre."""
    drawn = rasterize_depth(light_clip(view, vertices), faces, height=view.size, width=view.size)
    return _cleared(drawn, vertices.dtype)


@texels.defjvp
def _tangents(primals, tangents):
    view, vertices, faces = primals
    seen = rasterize(light_clip(view, vertices), faces, height=view.size, width=view.size)
    moved = jax.jvp(lambda view, vertices: _followed(view, vertices, faces, seen), (view, vertices), tangents[:2])[1]
    # The depth that decided is what `rasterize_depth` would draw again.
    return _cleared(lax.bitcast_convert_type(seen.nearness, jnp.float32), vertices.dtype), moved


def _mixed(shares: Sequence, means: Sequence, variances: Sequence) -> Moments:
    """Mean and variance of a mixture; shares add up to 1."""
    nothing = jnp.zeros_like(means[0])
    mean = sum((share * one for share, one in zip(shares, means)), nothing)
    spread = (own + (one - mean) ** 2 for own, one in zip(variances, means))
    return mean, sum((share * one for share, one in zip(shares, spread)), nothing)


def _boxes(moments: Moments, width: int) -> list[Array]:
    """Mean and variance of every box of so many texels on a side."""
    for axis in (0, 1):
        moments = _mixed([1.0 / width] * width, *(_windows(part, width, axis) for part in moments))
    return [*moments]


def _steps(depth: Picture, width: int) -> Float[Array, "k k"]:
    """The variance that a silhouette in or beside each box puts there on a quarter of a texel's way."""
    low = high = jnp.pad(depth, 1, mode="edge")
    for axis in (0, 1):
        low = functools.reduce(jnp.minimum, _windows(low, width + 2, axis))
        high = functools.reduce(jnp.maximum, _windows(high, width + 2, axis))
    return (high - low) ** 2 / (4 * width)


def _share(place: Receiver, boxes: list[Array], bias: Float[Array, "*b"], width: int) -> Float[Array, "*b"]:
    """The bound for boxes' means, variances, and what is added to these."""
    table, side = jnp.stack(boxes, axis=-1).reshape(-1, len(boxes)), boxes[0].shape[0]
    # Mix the four boxes about the place, whose corners these are.
    x, y = (jnp.clip(position - 0.5 * width, 0.0, side - 1.0) for position in (place.x, place.y))
    column, line = (jnp.minimum(jnp.floor(position), side - 2.0) for position in (x, y))
    index = line.astype(jnp.int32) * side + column.astype(jnp.int32)
    right, down = x - column, y - line
    rows = [fetch(table, index + step) for step in (0, 1, side, side + 1)]
    shares = [(1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down]
    mean, variance = _mixed(shares, [row[..., 0] for row in rows], [row[..., 1] for row in rows])
    variance = variance + bias * bias
    for more in range(2, len(boxes)):
        variance = variance + functools.reduce(jnp.maximum, [row[..., more] for row in rows])
    gap = jnp.maximum(mean - place.depth, 0.0)
    return safe.divide(variance, variance + gap * gap, 1.0)


@functools.partial(jax.custom_jvp, nondiff_argnums=(3,))
def moments(place: Receiver, drawn: Drawn, bias: Float[Array, "*b"], width: int) -> Float[Array, "*b"]:
    """The share of a box of `width` texels about each place that leaves it lit; `bias` is that in depth."""
    return _share(place, _boxes((drawn[0], jnp.zeros_like(drawn[0])), width), bias, width)


@moments.defjvp
def _moments_jvp(width, primals, tangents):
    place, (depth, *still), bias = primals
    moved_place, (moved_depth, *moved), moved_bias = tangents

    def smooth(place, depth, bias):
        return _share(place, _boxes((depth, jnp.zeros_like(depth)), width), bias, width)

    def silhouettes(mean, variance):
        return _share(place, [*_boxes((depth + mean, variance), width), _steps(depth, width)], bias, width)

    share, change = jax.jvp(smooth, (place, depth, bias), (moved_place, moved_depth, moved_bias))
    return share, change + jax.jvp(silhouettes, tuple(still), tuple(moved))[1]
