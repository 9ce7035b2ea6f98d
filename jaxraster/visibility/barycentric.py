"""Where in its triangle each pixel lies, and what is interpolated there: the differentiable half of visibility.

With a pixel at (X, Y) of the screen's [-1, 1]² and q_i = (x_i - X w_i, y_i - Y w_i) of its triangle's clip positions,
e_0 = q_1 × q_2 and so on, the perspective-correct barycentrics are β_i = e_i / Σe. No w is divided by, so that corners
behind the camera do no harm.

Gradient: exact in clip positions and attributes, for the given faces.
Source: Olano & Greer 1997, "Triangle Scan Conversion using 2D Homogeneous Coordinates".
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from ..buffers import Visibility
from ..check import below, fit
from ..math import safe
from ..math.table import apart, fetch

LIMIT = 1.844e18  # a tenth of √FLT_MAX: sums of products of two such coordinates stay below what float32 holds

EXPONENT = 0x7F800000  # the bits of a float32 that are its power of two
TWO_BIASES = 0x7F000000  # less those bits, they are those of the reciprocal of the power


def rows(table: Float[Array, "f n"], face: Int[Array, "*b"], background: Float[Array, " n"]) -> Float[Array, "*b n"]:
    """Rows of a per-face table, and `background` where there is no face: index -1 would wrap to the last one."""
    table = jnp.concatenate([table, background[None]])
    return fetch(table, jnp.where(face < 0, table.shape[0] - 1, face))


def _from(centres: np.ndarray, values, w):
    """value - centre·w of corners, as if the centres had not been rounded."""
    rounded = centres.astype(w[0].dtype)
    left = (centres - rounded).astype(w[0].dtype)
    q = [value - rounded * scale for value, scale in zip(values, w)]
    return [value - left * scale for value, scale in zip(q, w)] if left.any() else q


def _scale(w):
    """The power of two that brings the corners' largest |w| to [1, 2): it loses no digit, and products of huge and of
    tiny scenes stay inside float32's range."""
    largest = jnp.maximum(jnp.maximum(jnp.maximum(abs(w[0]), abs(w[1])), abs(w[2])), safe.TINY)
    power = lax.bitcast_convert_type(lax.stop_gradient(largest).astype(jnp.float32), jnp.int32) & EXPONENT
    return lax.bitcast_convert_type(TWO_BIASES - power, jnp.float32).astype(w[0].dtype)


def _products(x, y, w, scale, height: int, width: int):
    """Scaled q_x and q_y, and e of these, of corners at pixels `[h, w]`."""
    qx = _from((2.0 * np.arange(width)[None, :] + 1) / width - 1, x, w)
    qy = _from(1 - (2.0 * np.arange(height)[:, None] + 1) / height, y, w)
    # Scale only now: the differences above are to round once, and XLA would fuse a scaled corner's product instead.
    qx, qy = ([scale * value for value in q] for q in (qx, qy))
    # Round one product, which a comparison forces: XLA would fuse either into the difference, and then a triangle with
    # its corners in another order gets other weights.
    rounded = [qy[i] * qx[j] for i, j in ((1, 2), (2, 0), (0, 1))]
    rounded = [jnp.where(product < jnp.inf, product, 0.0) for product in rounded]
    return qx, qy, [qx[i] * qy[j] - r for r, (i, j) in zip(rounded, ((1, 2), (2, 0), (0, 1)))]


def _finite_corners(clip, faces):
    """Corners `[f, 3, 4]`; for those that no picture shows, but that have a derivative, harmless ones."""
    return jnp.where(jnp.all(jnp.abs(clip) < LIMIT, axis=-1, keepdims=True), clip, 1.0)[faces]


def _edges(clip, faces, face):
    """Scaled q_x, q_y, w, z of the three corners, and e, at every pixel; where there is no face, of one harmless."""
    height, width = face.shape
    table = jnp.swapaxes(_finite_corners(clip, faces), 1, 2).reshape(-1, 12)
    row = rows(table, face, jnp.array([1, 0, -1, 0, 1, -1, 0, 0, 0, 1, 1, 1], clip.dtype))
    x, y, z, w = (tuple(row[..., 3 * c + i] for i in range(3)) for c in range(4))
    scale = _scale(w)
    qx, qy, e = _products(x, y, w, scale, height, width)
    w, z = ([scale * value for value in part] for part in (w, z))
    return qx, qy, w, z, e


def _formula(clip, faces, face):
    """`barycentric` as autodiff reads it, from a row of corners per pixel."""
    _, _, w, z, e = _edges(clip, faces, face)
    reversed_winding = e[0] + e[1] + e[2] < 0
    e = [jnp.maximum(jnp.where(reversed_winding, -v, v), 0.0) for v in e]
    total = e[0] + e[1] + e[2]
    beta = [jnp.where(face >= 0, safe.divide(v, total), 0.0) for v in e]
    depth = safe.divide(sum(b * v for b, v in zip(beta, z)), sum(b * v for b, v in zip(beta, w)))
    return jnp.stack(beta, axis=-1), depth


def _evaluate(clip, faces, face):
    """`barycentric` as a processor likes it: one access per number, all of a pixel's in one loop."""
    height, width = face.shape
    corners = _finite_corners(clip, faces).reshape(-1, 12)

    def corner(index, component):
        return [corners.at[index, 4 * i + component].get(mode="promise_in_bounds") for i in range(3)]

    def weigh(face):
        x, y, w = (corner(jnp.maximum(face, 0), component) for component in (0, 1, 3))
        _, _, e = _products(x, y, w, _scale(w), height, width)
        sign = jnp.where(e[0] + e[1] + e[2] < 0, -1.0, 1.0)
        e = [jnp.maximum(sign * v, 0.0) for v in e]
        total = e[0] + e[1] + e[2]
        total = jnp.where(total > 0, total, 1.0)
        # Two numbers in one, or XLA would evaluate all this again for each array: the two weights that follow the
        # largest, which is what they leave of 1 without loss. Their signs say which that is; both, that there is none.
        second = (e[1] > e[0]) & (e[1] >= e[2])
        third = (e[2] > e[0]) & (e[2] > e[1])
        one, two = (
            jnp.where(second, b, jnp.where(third, c, a)) / total for a, b, c in ((e[1], e[2], e[0]), (e[2], e[0], e[1]))
        )
        nothing = face < 0
        signs = (jnp.where(where | nothing, -1.0, 1.0) for where in (second, third))
        return lax.complex(*(value * sign for value, sign in zip((one, two), signs)))

    beta = apart(face[0, 0] >= -1, weigh, face)

    # Select each weight by its place: a stack would read its parts from memory twice.
    def weight(place, beta):
        second, third = jnp.signbit(jnp.real(beta)), jnp.signbit(jnp.imag(beta))
        one, two = jnp.abs(jnp.real(beta)), jnp.abs(jnp.imag(beta))
        after = place - jnp.where(second, 1, jnp.where(third, 2, 0))
        after = jnp.where(after < 0, after + 3, after)
        value = jnp.where(after == 0, 1.0 - (one + two), jnp.where(after == 1, one, two))
        return jnp.where(second & third, 0.0, value)

    weights = weight(jnp.arange(3, dtype=jnp.int32)[None, None, :], beta[..., None])
    index, parts = jnp.maximum(face, 0), [weight(place, beta) for place in range(3)]
    z, w = (sum(part * value for part, value in zip(parts, corner(index, component))) for component in (2, 3))
    # Rounding must not take what is seen out of (0, 1].
    depth = jnp.clip(jnp.where(w > 0, z / jnp.where(w > 0, w, 1.0), 1.0), safe.TINY, 1.0)
    return weights, jnp.where(face >= 0, depth, 0.0)


# Compiled apart, and one by one under `vmap`: the same bits in any program, and no batch of temporaries.
_evaluate_apart = jax.custom_batching.sequential_vmap(
    jax.jit(lambda clip, faces, face: apart(face[0, 0] >= -1, _evaluate, clip, faces, face))
)


@jax.custom_jvp
def barycentric(
    clip: Float[Array, "v 4"], faces: Int[Array, "f 3"], face: Int[Array, "h w"]
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w"]]:
    """β and depth Σ β_i z_i / Σ β_i w_i of the given faces at every pixel's centre; 0 where there is none.

    β is clamped to [0, 1] and sums to 1, because a centre that is covered by the snapped triangle may lie up to 1/256
    pixel outside the true one; there the clamped β have no gradient.
    """
    return _evaluate_apart(clip, faces, face)


@barycentric.defjvp
def _tangents(primals, tangents):
    clip, faces, face = primals
    _, moved = jax.jvp(lambda clip: _formula(clip, faces, face), (clip,), (tangents[0],))
    return barycentric(clip, faces, face), moved


def _from_first(corners: Float[Array, "*b m"], beta: Float[Array, "*b 3"]) -> Float[Array, "*b c"]:
    """β₁ (c₁ - c₀) + β₂ (c₂ - c₀)."""
    num = corners.shape[-1] // 3
    c0, c1, c2 = corners[..., :num], corners[..., num : 2 * num], corners[..., 2 * num :]
    return beta[..., 1:2] * (c1 - c0) + beta[..., 2:3] * (c2 - c0)


def combine(corners: Float[Array, "*b m"], beta: Float[Array, "*b 3"]) -> Float[Array, "*b c"]:
    """c₀ + β₁ (c₁ - c₀) + β₂ (c₂ - c₀) of three corners' attributes laid end to end, m = 3c.

    This form gives a constant attribute exactly, and with β on the simplex stays within the corners' values, but for
    rounding.
    """
    return corners[..., : corners.shape[-1] // 3] + _from_first(corners, beta)


def corners_at(
    attributes: Float[Array, "v c"], faces: Int[Array, "f 3"], face: Int[Array, "*b"]
) -> Float[Array, "*b m"]:
    """The attributes of the three corners of each pixel's face, laid end to end; 0 where there is none."""
    table = attributes[faces].reshape(faces.shape[0], 3 * attributes.shape[1])
    return rows(table, face, jnp.zeros(table.shape[1], attributes.dtype))


def interpolate(
    attributes: Float[Array, "v c"], faces: Int[Array, "f 3"], visibility: Visibility
) -> Float[Array, "*b h w c"]:
    """Perspective-correct attributes at every pixel, 0 where there is nothing.

    Gradient: exact in attributes and barycentrics.

    Example:
        >>> from jaxraster import rasterize
        >>> clip = jnp.array([[-1.0, -1.0, 0.5, 1.0], [3.0, -1.0, 0.5, 1.0], [-1.0, 3.0, 0.5, 1.0]])
        >>> visibility = rasterize(clip, jnp.array([[0, 1, 2]]), height=1, width=2)
        >>> interpolate(clip[:, :1], jnp.array([[0, 1, 2]]), visibility)[..., 0].tolist()
        [[-0.5, 0.5]]
    """
    fit("interpolate: attributes", attributes, Float[Array, "v c"], batched=False)
    fit("interpolate: faces", faces, Int[Array, "f 3"])
    below("interpolate: faces", faces, attributes.shape[0], "vertices")
    attributes, faces = jnp.asarray(attributes), jnp.asarray(faces)
    return combine(corners_at(attributes, faces, visibility.face), visibility.barycentric)


def footprint(
    attributes: Float[Array, "v c"], clip: Float[Array, "v 4"], faces: Int[Array, "f 3"], visibility: Visibility
) -> Float[Array, "h w c 2"]:
    """∂attribute/∂(pixel right, pixel down), exactly: what `texture` asks for uv. 0 where there is nothing.

    Batches are mapped. No differences between neighbouring pixels: with s = Σe, ∂β_i = (∂e_i - β_i ∂s) / s, and e is
    linear in X and Y.
    Gradient: exact.

    Example:
        >>> from jaxraster import rasterize
        >>> clip, faces = jnp.array([[-1.0, -1, 0.5, 1], [3, -1, 0.5, 1], [-1, 3, 0.5, 1]]), jnp.array([[0, 1, 2]])
        >>> visibility = rasterize(clip, faces, height=2, width=4)
        >>> footprint(clip[:, :2], clip, faces, visibility)[0, 0].tolist()  # two units over 4 and over 2 pixels
        [[0.5, -0.0], [0.0, -1.0]]
    """
    sizes: dict[str, int] = {}
    fit("footprint: attributes", attributes, Float[Array, "v c"], sizes, batched=False)
    fit("footprint: clip", clip, Float[Array, "v 4"], sizes, batched=False)
    fit("footprint: faces", faces, Int[Array, "f 3"])
    fit("footprint: visibility.face", visibility.face, Int[Array, "h w"], batched=False)
    below("footprint: faces", faces, clip.shape[0], "vertices")
    attributes, clip, faces = (jnp.asarray(each) for each in (attributes, clip, faces))
    return spread(corners_at(attributes, faces, visibility.face), clip, faces, visibility)


def spread(
    corners: Float[Array, "h w m"], clip: Float[Array, "v 4"], faces: Int[Array, "f 3"], visibility: Visibility
) -> Float[Array, "h w c 2"]:
    """`footprint` of the three corners' attributes of each pixel's face, laid end to end."""
    qx, qy, w, _, e = _edges(clip, faces, visibility.face)
    height, width = visibility.face.shape
    total = e[0] + e[1] + e[2]
    pairs = ((1, 2), (2, 0), (0, 1))
    steps = [[(w[j] * qy[i] - w[i] * qy[j]) * (2.0 / width) for i, j in pairs]]
    steps += [[(w[i] * qx[j] - w[j] * qx[i]) * (-2.0 / height) for i, j in pairs]]
    derivatives = []
    for step in steps:
        sum_step = step[0] + step[1] + step[2]
        change = [safe.divide(s - visibility.barycentric[..., i] * sum_step, total) for i, s in enumerate(step)]
        beta = jnp.where((visibility.face >= 0)[..., None], jnp.stack(change, axis=-1), 0.0)
        # The changes of β sum to 0, so that the first corner cancels.
        derivatives.append(_from_first(corners, beta))
    return jnp.stack(derivatives, axis=-1)
