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
depth, half of it in either texel, so that where a shadow lies has a gradient, too: 0.96 of what geometry says at a
`width` of 5, as some falls beyond the lit end of the ramp. What a silhouette uncovers is taken to be as deep as the
texel beside it.
Source: Donnelly & Lauritzen 2006, "Variance Shadow Maps". Worchel & Alexa 2023, "Differentiable Shadow Mapping for
Efficient Inverse Graphics", antialias the map's silhouettes instead.
"""

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


def _pairs(picture: Float[Array, "h w"] | Int[Array, "h w"], axis: int):
    """Neighbours along an axis."""
    count = picture.shape[axis]
    return lax.slice_in_dim(picture, 0, count - 1, axis=axis), lax.slice_in_dim(picture, 1, count, axis=axis)


def _swept(depth: Picture, moved: Picture, face: Int[Array, "h w"], axis: int) -> Moments:
    """What texels' means and variances change by as their contents move along an axis: a derivative, of value 0.

    A border between depths a and b that moves by d turns d of b into a: half of it in each of the two texels, whose
    means change by (a - b) d / 2, and whose variances by ∓(a - b)² d / 2.
    """
    (a, b), (moved_a, moved_b), (face_a, face_b) = (_pairs(part, axis) for part in (depth, moved, face))
    # Within a face the border moves as the mean, so that planes have their exact slope; else with what is nearer.
    border = jnp.where(face_a == face_b, 0.5 * (moved_a + moved_b), jnp.where(a > b, moved_a, moved_b))
    jump = jnp.where(face_a == face_b, 0.0, a - b)
    mean, variance = 0.5 * (a - b) * border, 0.5 * jump * jump * border
    first, second = ([(0, 0)] * axis + [pad] + [(0, 0)] * (1 - axis) for pad in ((0, 1), (1, 0)))
    return jnp.pad(mean, first) + jnp.pad(mean, second), jnp.pad(variance, second) - jnp.pad(variance, first)


def _followed(view: LightView, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], seen: Visibility) -> Moments:
    """`texels` as what each shows moves."""
    points = interpolate(vertices, faces, seen)
    # Each texel's place and depth are those of the very point that it shows; its plane's slope goes unused.
    place = receiver(view, points, jnp.zeros_like(points))
    depth = jnp.where(seen.face >= 0, place.depth, NOTHING)
    mean, variance = depth, jnp.zeros_like(depth)
    for axis, position in enumerate((place.y, place.x)):
        moved = position - lax.stop_gradient(position)
        swept = _swept(lax.stop_gradient(depth), moved, seen.face, axis)
        mean, variance = mean + swept[0], variance + swept[1]
    return mean, variance


def _cleared(nearness: Picture, dtype) -> Moments:
    depth = jnp.where(nearness > 0, nearness, NOTHING).astype(dtype)
    return depth, jnp.zeros_like(depth)


@jax.custom_jvp
def texels(view: LightView, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Moments:
    """The map: each texel's depth, that of the nearest triangle at its centre, and its variance, which is 0."""
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


def _boxes(drawn: Moments, width: int) -> Float[Array, "n 2"]:
    """Mean and variance of every box of so many texels on a side, row by row."""
    for axis in (0, 1):
        count = drawn[0].shape[axis] - width + 1
        parts = ([lax.slice_in_dim(part, k, k + count, axis=axis) for k in range(width)] for part in drawn)
        drawn = _mixed([1.0 / width] * width, *parts)
    return jnp.stack(drawn, axis=-1).reshape(-1, 2)


def moments(place: Receiver, drawn: Moments, bias: Float[Array, "*b"], width: int) -> Float[Array, "*b"]:
    """The share of a box of `width` texels about each place that leaves it lit; `bias` is that in depth."""
    table, side = _boxes(drawn, width), drawn[0].shape[0] - width + 1
    # Mix the four boxes about the place, whose corners these are.
    x, y = (jnp.clip(position - 0.5 * width, 0.0, side - 1.0) for position in (place.x, place.y))
    column, line = (jnp.minimum(jnp.floor(position), side - 2.0) for position in (x, y))
    index = line.astype(jnp.int32) * side + column.astype(jnp.int32)
    right, down = x - column, y - line
    rows = [fetch(table, index + step) for step in (0, 1, side, side + 1)]
    shares = [(1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down]
    mean, variance = _mixed(shares, [row[..., 0] for row in rows], [row[..., 1] for row in rows])
    gap, variance = jnp.maximum(mean - place.depth, 0.0), variance + bias * bias
    return safe.divide(variance, variance + gap * gap, 1.0)
