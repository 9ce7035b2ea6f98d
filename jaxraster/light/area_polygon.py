"""How much of the hemisphere a polygon fills, weighed by the cosine: Lambert's formula, with the horizon.

form factor = 1/(2π) |Σ θ n·(p × q)/|p × q|| over the edges from p to q, θ the angle between them: E = π L times that.
Positions are relative to the receiver, in any unit. The part below the horizon is cut off, edge by edge, and what was
cut is closed by one more edge. Exact; float32 loses about 1e-7 of the ratio of distance to size.

Gradient: exact in positions and normal; finite at corners, on edges and in the polygon's plane, where it is one-sided.
Source: Lambert 1760, "Photometria"; Arvo 1995, "Applications of Irradiance Tensors to the Simulation of Non-Lambertian
Phenomena", section 2.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..math import safe

Vector = Float[Array, "*b 3"]
# Starts and ends of k edges, side by side: one program for all of them compiles in a fraction of the time.
Edges = tuple[Float[Array, "k *b 3"], Float[Array, "k *b 3"]]
OneMore = tuple[Float[Array, "k+1 *b 3"], Float[Array, "k+1 *b 3"]]
# Where the tangent of an angle is below this, angle/sine is a series whose next term is 1e-10.
SMALL = 0.03


def edges(corners: Float[Array, "k *b 3"]) -> Edges:
    """The edges around corners that are in order, in the unit of the farthest: squares neither over- nor underflow."""
    far = jnp.max(jnp.abs(corners), axis=(0, -1), keepdims=True)
    corners = corners / lax.stop_gradient(jnp.where(far > safe.TINY, far, 1.0))
    return corners, jnp.roll(corners, -1, axis=0)


def clip(edges: Edges, n: Vector) -> OneMore:
    """What of a convex polygon's edges is above the plane with normal n, and the edge that closes them."""
    p, q = edges
    n = jnp.broadcast_to(n, p.shape)
    high, low = safe.dot(p, n)[..., None], safe.dot(q, n)[..., None]
    above, end_above = high >= 0, low >= 0
    crossing = p + safe.divide(high, high - low) * (q - p)
    start, end = jnp.where(above, p, crossing), jnp.where(end_above, q, crossing)
    kept = [jnp.where(above | end_above, x, 0.0) for x in (start, end)]
    closing = [
        jnp.where(cut, crossing, 0.0).sum(axis=0, keepdims=True) for cut in (above & ~end_above, end_above & ~above)
    ]
    return jnp.concatenate([kept[0], closing[0]]), jnp.concatenate([kept[1], closing[1]])


def turn(p: Vector, q: Vector, n: Vector) -> Float[Array, "*b"]:
    """θ n·(p × q)/|p × q|; 0 where p and q are along one line, also in opposite directions."""
    across = jnp.cross(p, q - p)  # p × q without its cancellation
    square, cosine = safe.dot(across, across), safe.dot(p, q)
    small = (cosine > 0) & (square < (SMALL * cosine) ** 2)
    sine = safe.sqrt(jnp.where(small, 1.0, square))
    t2 = safe.divide(jnp.where(small, square, 0.0), cosine * cosine)
    series = safe.divide(1.0 - t2 * (1.0 / 3.0 - 0.2 * t2), jnp.where(small, cosine, 1.0))
    usable = sine > 0
    angle = jnp.arctan2(sine, jnp.where(usable, cosine, 1.0))
    return safe.dot(across, n) * jnp.where(small, series, safe.divide(angle, sine))


def form_factor(edges: Edges, n: Vector) -> Float[Array, "*b"]:
    """The sum over edges that are all above the horizon, counter-clockwise as seen; 0 where it is negative.

    The last edge is the one that closes them along the horizon, counter-clockwise whatever float32 makes of it where
    the receiver is next to the light's plane.
    """
    turns = turn(*edges, jnp.broadcast_to(n, edges[0].shape))
    total = turns[:-1].sum(axis=0) + jnp.abs(turns[-1])
    return jnp.where(total > 0, total, 0.0) / (2.0 * jnp.pi)
