"""Diffuse reflection."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def lambert(color: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """f = colour/π, the same in all directions. Gradient: exact. Source: Lambert 1760."""
    return color / jnp.pi
