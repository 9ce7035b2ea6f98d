"""How much of the hemisphere a disc fills, weighed by the cosine, also where the horizon cuts it.

form factor = 1/(2π) ∮ n·(r × dr)/|r|² around what is above the horizon: an arc of the disc's rim and the chord that
closes it. On the rim r = c + R (cos φ, sin φ), in the disc's plane, |r|² = ½ (A + W) |1 + z|² with z = b̄ exp(iφ) and

A = |c|² + R²,  W² = (|c|² - R²)² + 4 h² R²,  b = 2 R q / (A + W),

where c is h in front of the plane and q beside the axis, as a complex number. From φ₁ to φ₂, with log(1 + z) = l + iθ,

∫ exp(iφ)/|r|² dφ = [-i exp(iφ) log(1 + z)/z - b φ + b (θ + i l)] / W,
∫ (R² + R q·exp(iφ))/|r|² dφ = ½ [ε φ + 2 (1 - ε) θ],  ε = 1 - (|c|² - R²)/W.

Exact: float32 loses 1e-7 of the ratio of distance to radius. Whole discs cost it nothing.
Gradient: exact in centre, axis, radius and normal. Where the horizon cuts, its derivative is left out, because light
that comes along it counts nothing; second derivatives at the horizon are not exact.
Source: Lambert's integral over the rim; the antiderivatives are ours.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..math import safe
from ..math.transform import frame
from .area_polygon import turn

Vector = Float[Array, "*b 3"]
Number = Float[Array, "*b"]
SMALL = 0.1  # Below this |z| log(1 + z)/z is a series of TERMS, right to 1e-7.
TERMS = 6
# Tangents of tilts below this, squared, are none: the horizon then runs along the disc, if anywhere.
LEAST_TILT = 1e-12


def _axes(m: Vector, n: Vector) -> tuple[Vector, Vector]:
    """Axes of the disc's plane, the first along n where n is tilted to m. They turn with m, and not with n."""
    along = n - safe.dot(n, m)[..., None] * m
    tilted = (safe.dot(along, along) > LEAST_TILT)[..., None]
    x = lax.stop_gradient(jnp.where(tilted, safe.normalize(along), frame(m)[0]))
    x = safe.normalize(x - safe.dot(x, m)[..., None] * m)
    return x, jnp.cross(m, x)


def _logarithm(zx: Number, zy: Number, square: Number) -> tuple[Number, Number, Number, Number]:
    """(l, θ) of log(1 + z) and the parts of log(1 + z)/z, for |z| < 1."""
    small = square < SMALL * SMALL
    # On the rim itself, at z = -1, there is no logarithm; a rounding beside it is the least that there is.
    apart = (1.0 + zx) ** 2 + zy * zy > safe.TINY
    l = 0.5 * jnp.log1p(jnp.where(apart, jnp.maximum(2.0 * zx + square, -1.0 + 2.0**-23), 0.0))
    angle = jnp.arctan2(zy, jnp.where(apart, 1.0 + zx, 1.0))
    divisor = jnp.where(small, 1.0, square)
    x, y = jnp.where(small, zx, 0.0), jnp.where(small, zy, 0.0)
    real, imaginary = jnp.full_like(x, 1.0 / TERMS), jnp.zeros_like(x)
    for term in range(TERMS - 1, 0, -1):
        real, imaginary = 1.0 / term - (x * real - y * imaginary), -(x * imaginary + y * real)
    real = jnp.where(small, real, (l * zx + angle * zy) / divisor)
    return l, angle, real, jnp.where(small, imaginary, (angle * zx - l * zy) / divisor)


def disc_factor(center: Vector, axis: Vector, radius: Number, n: Vector) -> Number:
    """Of a disc with that centre, unit axis (to either side) and radius, relative to the receiver."""
    # Measure in the light's distance and size together, so that no square is too large or small.
    scale = lax.stop_gradient(jnp.sqrt(safe.dot(center, center) + radius * radius))
    scale = jnp.where(scale > safe.TINY, scale, 1.0)
    c, big = center / scale[..., None], radius / scale
    m = jnp.where((safe.dot(c, axis) < 0)[..., None], -axis, axis)
    x, y = _axes(m, n)
    cc, h, qx, qy = safe.dot(c, c), safe.dot(c, m), safe.dot(c, x), safe.dot(c, y)
    nx, ny, nz = safe.dot(n, x), safe.dot(n, y), safe.dot(n, m)

    excess = cc - big * big
    w = safe.sqrt(excess * excess + 4.0 * h * h * big * big)
    bx, by = (safe.divide(2.0 * big * q, cc + big * big + w) for q in (qx, qy))
    far = excess > 0
    epsilon = safe.divide(4.0 * h * h * big * big, w * jnp.where(far, w + excess, 1.0))
    epsilon = jnp.where(far, epsilon, 1.0 - safe.divide(excess, w))

    # The rim is above the horizon from -ψ to ψ.
    high, reach = lax.stop_gradient((safe.dot(c, n), big * nx))
    cosine = jnp.clip(-safe.divide(high, reach), -1.0, 1.0)
    cosine = jnp.where(jnp.abs(high) >= reach, -jnp.sign(high), cosine)
    sine, psi = jnp.sqrt(1.0 - cosine * cosine), jnp.arccos(cosine)

    # Take both ends of the arc side by side.
    sin, phi = jnp.stack([sine, -sine]), jnp.stack([psi, -psi])
    x, y, c = (jnp.broadcast_to(a, (2, *a.shape)) for a in (x, y, c))
    bx, by, cos, big2, rest = (jnp.broadcast_to(a, phi.shape) for a in (bx, by, cosine, big, epsilon))
    l, angle, real, imaginary = _logarithm(bx * cos + by * sin, bx * sin - by * cos, bx * bx + by * by)
    vx = sin * real + cos * imaginary + bx * (angle - phi) - by * l
    vy = sin * imaginary - cos * real + by * (angle - phi) + bx * l
    rim = rest * phi + 2.0 * (1.0 - rest) * angle
    end, start = c + (big2 * cos)[..., None] * x + (big2 * sin)[..., None] * y
    along = nx * (vx[0] - vx[1]) + ny * (vy[0] - vy[1])
    total = 0.5 * nz * (rim[0] - rim[1]) - safe.divide(h * big * along, w) + turn(end, start, n)
    return jnp.where(total > 0, total, 0.0) / (2.0 * jnp.pi)
