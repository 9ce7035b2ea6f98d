"""Functions that stay finite, in value and in gradient, where the plain ones do not.

Every one guards its input before the dangerous operation, not its output after it: a `where` on the output alone
still multiplies the masked branch's infinite derivative by zero, which is NaN.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Lengths and divisors below this count as zero: its reciprocal, 1e30, is still far from float32's overflow at 3e38,
# so that a gradient which multiplies two of them by ordinary numbers stays finite in all but absurd chains.
TINY = 1e-30


def sqrt(x: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """√x for x > 0, else 0.

    Gradient: exact for x > TINY; 0 elsewhere, where the plain one is infinite (x = 0) or NaN.
    """
    positive = x > TINY
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def divide(a: Float[Array, "*b"], b: Float[Array, "*b"], otherwise: float = 0.0) -> Float[Array, "*b"]:
    """a / b, and `otherwise` where |b| is at most TINY.

    Gradient: exact where divided; 0 elsewhere.
    """
    nonzero = jnp.abs(b) > TINY
    return jnp.where(nonzero, a / jnp.where(nonzero, b, 1.0), otherwise)


def dot(a: Float[Array, "*b n"], b: Float[Array, "*b n"]) -> Float[Array, "*b"]:
    """a · b along the last axis in full float precision (a matrix unit would round the factors to 10 bits)."""
    return jnp.sum(a * b, axis=-1)


def normalize(v: Float[Array, "*b n"]) -> Float[Array, "*b n"]:
    """v / |v|, and 0 where |v| is at most TINY or not finite.

    Scaling by the largest component first keeps the square inside float32's range from 1e-30 to 1e38.
    Gradient: exact where normalized; 0 elsewhere.
    """
    scale = jax.lax.stop_gradient(jnp.max(jnp.abs(v), axis=-1, keepdims=True))
    usable = (scale > TINY) & (scale < jnp.inf)
    unit = jnp.where(usable, v, 1.0) / jnp.where(usable, scale, 1.0)
    return jnp.where(usable, unit * jax.lax.rsqrt(jnp.sum(unit * unit, axis=-1, keepdims=True)), 0.0)


def length(v: Float[Array, "*b n"]) -> Float[Array, "*b"]:
    """|v|. Gradient: exact for v ≠ 0; 0 at v = 0, where the plain one is NaN."""
    return dot(v, normalize(v))
