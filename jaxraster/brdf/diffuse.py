"""Diffuse reflection: the same in all directions, or by two fits. The energy-preserving one is `oren_nayar`."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def lambert(color: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """f = colour/π, the same in all directions. Gradient: exact. Source: Lambert 1760."""
    return color / jnp.pi


def burley(
    color: Float[Array, "*b 3"],
    roughness: Float[Array, "*b"],
    n_dot_v: Float[Array, "*b"],
    n_dot_l: Float[Array, "*b"],
    l_dot_h: Float[Array, "*b"],
) -> Float[Array, "*b 3"]:
    """f = colour/π (1 + (F - 1)(1 - n·v)⁵) (1 + (F - 1)(1 - n·l)⁵) with F = ½ + 2 roughness (l·h)².

    A fit of measured materials: smooth ones darken at grazing angles, rough ones brighten against the light. Roughness
    in [0, 1] is the authored one, not alpha; cosines in [0, 1]. It does not conserve energy: white returns 0.98 when
    smooth to 1.04 when rough head on, and 0.51 to 1.54 at n·v = 0.01 (measured by the tests). Reciprocal.

    Gradient: exact. Source: Burley 2012, "Physically-Based Shading at Disney", 5.3.
    """
    bend = 2.0 * roughness * l_dot_h * l_dot_h - 0.5
    x, y = 1.0 - n_dot_v, 1.0 - n_dot_l
    x2, y2 = x * x, y * y
    return color * ((1.0 + bend * x2 * x2 * x) * (1.0 + bend * y2 * y2 * y) / jnp.pi)[..., None]
