"""How much of the hemisphere a round light fills, weighed by the cosine: spheres and ellipses.

A sphere of angular radius σ at the angle ω from the normal: sin²σ cos ω above the horizon, 0 below, and between

(1/π) (sin²σ cos ω atan2(q, -cos ω cot σ) - q sin σ cos σ + atan2(q sin σ, cos σ)), q = √(1 - cos²ω / sin²σ).

An ellipse with centre c and half axes a, b, all relative to the receiver, fills, as a vector along a unit u,

D / √(D² + λ² (T + 2λ)),  T = |a|² + |b|² - |c|²,  D = |det(a, b, c)|,  (a aᵀ + b bᵀ - c cᵀ) u = -λ u,

exactly; a and b need be neither perpendicular nor equal. At the horizon it is cut as the sphere would be that fills as
much along u, which is exact for spheres alone: `docs/guide/lights.md` has the error.
Gradient: exact in all arguments. q's is left out, because the derivative in it is 0, and so second derivatives at the
horizon are not.
Source: Snyder 1996, "Area Light Sources for Real-Time Graphics"; Lagarde & de Rousiers 2014, "Moving Frostbite to
Physically Based Rendering", eq. 30; Heitz 2017, "Analytical Calculation of the Solid Angle Subtended by an Arbitrarily
Positioned Ellipsoid to a Point Source"; the formula in λ is ours, from its dual cone.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..math import safe

Vector = Float[Array, "*b 3"]
Number = Float[Array, "*b"]
ROUNDS = 4  # of Laguerre's method, whose error shrinks by its cube: three leave 1e-5, and Newton's step follows


def sphere_factor(square_sine: Number, cosine: Number) -> Number:
    """The sphere's, of sin²σ and cos ω in [0, 1] and [-1, 1]."""
    rest = square_sine - cosine * cosine
    crosses = rest > safe.TINY
    s2 = jnp.where(crosses, square_sine, 0.5)
    c = jnp.where(crosses, cosine, 0.0)
    sine, cosine_of_radius = safe.sqrt(s2), safe.sqrt(1.0 - s2)
    q = lax.stop_gradient(safe.sqrt(jnp.where(crosses, rest, 0.5) / s2))
    cut = s2 * c * jnp.arctan2(q, -c * cosine_of_radius / sine) - q * sine * cosine_of_radius
    cut = (cut + jnp.arctan2(q * sine, cosine_of_radius)) / jnp.pi
    whole = square_sine * jnp.where(cosine > 0, cosine, 0.0)
    # Rounding leaves about 1e-8 on either side of 0 where next to nothing rises above the horizon.
    return jnp.where(crosses, jnp.maximum(cut, 0.0), whole)


def _largest_root(t: Number, s: Number, d2: Number, start: Number) -> Number:
    """λ > 0 of λ³ + T λ² + S λ = D², whose other roots are negative, from a start above it.

    Found by Laguerre's method, which cannot overshoot where all roots are real; the last step, Newton's, has the
    derivative of the root.
    """
    p, q, r = lax.stop_gradient((t, s, d2))

    def step(_, x):
        value, slope, bend = ((x + p) * x + q) * x - r, (3.0 * x + 2.0 * p) * x + q, 6.0 * x + 2.0 * p
        change = safe.divide(3.0 * value, slope + safe.sqrt(4.0 * slope * slope - 6.0 * value * bend))
        return jnp.maximum(x - change, 0.0)

    x = lax.stop_gradient(lax.fori_loop(0, ROUNDS, step, lax.stop_gradient(start)))
    slope = (3.0 * x + 2.0 * p) * x + q
    return x - safe.divide(((x + t) * x + s) * x - d2, slope)


def ellipse_factor(c: Vector, a: Vector, b: Vector, n: Vector) -> Number:
    """The ellipse's."""
    # Measure in the light's distance and size together: what follows has their sixth powers.
    scale = lax.stop_gradient(sum(safe.dot(x, x) for x in (a, b, c)))
    scale = jnp.sqrt(jnp.where(scale > safe.TINY, scale, 1.0))[..., None]
    a, b, c = a / scale, b / scale, c / scale
    normal = jnp.cross(a, b)
    aa, bb, ab, ac, bc = safe.dot(a, a), safe.dot(b, b), safe.dot(a, b), safe.dot(a, c), safe.dot(b, c)
    cc, ca, cb = safe.dot(c, c), jnp.cross(c, a), jnp.cross(c, b)
    d, t = jnp.abs(safe.dot(c, normal)), aa + bb - cc
    s = safe.dot(normal, normal) - safe.dot(ca, ca) - safe.dot(cb, cb)
    root = _largest_root(t, s, d * d, cc)
    filled = safe.divide(d, safe.sqrt(d * d + root * root * (t + 2.0 * root)))

    # u ∝ (λ + a aᵀ + b bᵀ)⁻¹ c: the point of the ellipse's plane that the cone's axis meets.
    minor = (root + aa) * (root + bb) - ab * ab
    x, y = safe.divide((root + bb) * ac - ab * bc, minor), safe.divide((root + aa) * bc - ab * ac, minor)
    axis = safe.normalize(c - x[..., None] * a - y[..., None] * b)
    return sphere_factor(jnp.minimum(filled, 1.0), jnp.clip(safe.dot(axis, n), -1.0, 1.0))


def cut(c: Vector, a: Vector, b: Vector, n: Vector) -> tuple[Vector, Vector, Vector]:
    """About what of an ellipse is above the horizon: an ellipse from there to its top, nearly as large as what is left.

    As it is where all of it is above, and without size where nothing is. With its centre at t from -1 to 1 of its reach
    upwards, it becomes lower by (1 + t)/2 and wider by (1 + t) (2 - t)/2: together the share ½ + ¾ t - ¼ t³, at most
    0.02 off that of a circle.
    """
    x, y = safe.dot(a, n), safe.dot(b, n)
    high, reach = safe.dot(c, n), safe.sqrt(x * x + y * y)
    crosses = jnp.abs(high) < reach
    divisor = jnp.where(crosses, reach, 1.0)
    t = jnp.where(crosses, high / divisor, jnp.sign(high))[..., None]
    # Take half axes that run up and along the horizon.
    x, y = jnp.where(crosses, x / divisor, 1.0)[..., None], jnp.where(crosses, y / divisor, 0.0)[..., None]
    rise, level = x * a + y * b, x * b - y * a
    return c + 0.5 * (1.0 - t) * rise, 0.5 * (1.0 + t) * rise, 0.5 * (1.0 + t) * (2.0 - t) * level
