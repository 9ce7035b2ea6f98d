"""Random directions and points: maps from the unit square, each with its density beside it.

All take u `[*b 2]` in [0, 1), of 24 bits as `hash.uniform` and `sobol` make it, and keep what is spread well in the
square spread well where they lead. A density is per unit of what is drawn from: solid angle, area, or weight.

Disc, hemisphere and the sphere's axis take a number for the middle of its step of 2⁻²⁴: no rim, pole or centre is ever
drawn, where densities are 0 or gradients are not finite. Gradient: exact in u except across seams, and finite in the
whole square.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from . import safe

Square = Float[Array, "*b 2"]
Density = Float[Array, "*b"]

MIDDLE = 2.0**-25  # half of a step of u; u + MIDDLE would be rounded, 2 u - 1 + 2 MIDDLE is exact


def _signed(u: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """u from [0, 1) to (-1, 1), never 0 nor ±1, the steps' middles at odd multiples of 2⁻²⁴."""
    return (2.0 * u - 1.0) + 2.0 * MIDDLE


def _round(u: Square) -> tuple[Float[Array, "*b 2"], Float[Array, "*b"]]:
    """A point of the unit disc and its distance from the centre: squares around the centre become circles.

    r = a and φ = π/4 · b/a where |a| > |b|, the larger of both coordinates, and mirrored at the diagonals.
    Source: Shirley and Chiu 1997, "A Low Distortion Map Between Disk and Square".
    """
    a, b = _signed(u[..., 0]), _signed(u[..., 1])
    wide = jnp.abs(a) > jnp.abs(b)
    radius, other = jnp.where(wide, a, b), jnp.where(wide, b, a)
    angle = (jnp.pi / 4.0) * safe.divide(other, radius)
    along, across = radius * jnp.cos(angle), radius * jnp.sin(angle)
    point = jnp.stack([jnp.where(wide, along, across), jnp.where(wide, across, along)], axis=-1)
    return point, jnp.abs(radius)


def disc(u: Square) -> tuple[Float[Array, "*b 2"], Density]:
    """A point of the unit disc, of density 1/π per area."""
    point, radius = _round(u)
    return point, jnp.full_like(radius, 1.0 / jnp.pi)


def cosine_hemisphere(u: Square) -> tuple[Float[Array, "*b 3"], Density]:
    """A direction above z = 0, of density cos θ/π per solid angle: a point of the disc, raised to the sphere.

    Source: Malley's method, as in Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", A.5.3.

    Example:
        >>> direction, density = cosine_hemisphere(jnp.array([0.5, 0.5]))
        >>> direction.round(3).tolist(), round(float(density * jnp.pi), 3)
        ([0.0, 0.0, 1.0], 1.0)
    """
    point, radius = _round(u)
    # (1 - r)(1 + r) is exact to the rim, where 1 - x² - y² would cancel.
    height = safe.sqrt((1.0 - radius) * (1.0 + radius))
    return jnp.concatenate([point, height[..., None]], axis=-1), height / jnp.pi


def sphere(u: Square) -> tuple[Float[Array, "*b 3"], Density]:
    """A direction, of density 1/(4π) per solid angle: u's second number around, its first along the axis z.

    Source: Archimedes; a slice of the sphere has the area of the slice of its cylinder.
    """
    z, angle = _signed(u[..., 0]), 2.0 * jnp.pi * u[..., 1]
    radius = safe.sqrt((1.0 - z) * (1.0 + z))
    direction = jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle), z], axis=-1)
    return direction, jnp.full_like(z, 0.25 / jnp.pi)


def triangle(u: Square) -> tuple[Float[Array, "*b 3"], Density]:
    """Weights of a triangle's corners, of density 2 per area in the first two of them: divide it by |e₁ × e₂|, twice
    the triangle's area, for the density per area of that triangle.

    Half of the square is folded onto the other along the diagonal.
    Source: Heitz 2019, "A Low-Distortion Map Between Triangle and Square".
    """
    x, y = u[..., 0], u[..., 1]
    steep = y > x
    first, second = jnp.where(steep, 0.5 * x, x - 0.5 * y), jnp.where(steep, y - 0.5 * x, 0.5 * y)
    return jnp.stack([first, second, 1.0 - (first + second)], axis=-1), jnp.full_like(x, 2.0)
