"""Functions that stay finite, in value and in gradient, where the plain ones do not.

Every one guards its input before the dangerous operation, not its output after it: a `where` on the output alone
still multiplies the masked branch's infinite derivative by zero, which is NaN.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

# Lengths and divisors below this count as zero: its reciprocal, 1e30, is still far from float32's overflow at 3e38,
# so that a gradient which multiplies two of them by ordinary numbers stays finite in all but absurd chains.
TINY = 1e-30


def sqrt(x: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """√x for x > TINY, else 0, also for NaN.

    Gradient: exact for x > TINY; 0 elsewhere, where the plain one is infinite (x = 0) or NaN.
    """
    positive = x > TINY
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def divide(a: Float[Array, "*b"], b: Float[Array, "*b"], otherwise: float = 0.0) -> Float[Array, "*b"]:
    """a / b, and `otherwise` where |b| is at most TINY or b is NaN.

    Gradient: exact where divided; 0 elsewhere. It is formed as (∂a - (a/b) ∂b) / b: JAX's own rule squares b, whose
    reciprocal overflows below 1e-19.
    """
    nonzero = jnp.abs(b) > TINY
    return jnp.where(nonzero, a / jnp.where(nonzero, b, 1.0), otherwise)


@divide.defjvp
def _divide_jvp(otherwise, primals, tangents):
    (a, b), (a_dot, b_dot) = primals, tangents
    quotient = divide(a, b, otherwise)
    nonzero = jnp.abs(b) > TINY
    change = (a_dot - quotient * b_dot) / jnp.where(nonzero, b, 1.0)
    return quotient, jnp.where(nonzero, change, 0.0)


def dot(a: Float[Array, "*b n"], b: Float[Array, "*b n"]) -> Float[Array, "*b"]:
    """a · b along the last axis in full float precision (a matrix unit would round the factors to 10 bits).

    Written out: XLA's reduction over an axis of three takes ten times as long on a CPU.
    """
    total = a[..., 0] * b[..., 0]
    for i in range(1, a.shape[-1]):
        total += a[..., i] * b[..., i]
    return total


def normalize(v: Float[Array, "*b n"]) -> Float[Array, "*b n"]:
    """v / |v|, and 0 where |v| is at most TINY or not finite.

    Scaling by the largest component first keeps the square inside float32's range from 1e-30 to 1e38.
    Gradient: exact where normalized; 0 elsewhere.
    """
    components = [v[..., i] for i in range(v.shape[-1])]
    scale = jnp.abs(lax.stop_gradient(components[0]))
    for component in components[1:]:
        scale = jnp.maximum(scale, jnp.abs(lax.stop_gradient(component)))
    usable = (scale > TINY) & (scale < jnp.inf)
    # Divide: the reciprocal of 1e38 is denormal, which counts as 0.
    scale = jnp.where(usable, scale, 1.0)
    unit = [jnp.where(usable, component, 1.0) / scale for component in components]
    reciprocal = lax.rsqrt(sum(u * u for u in unit))
    return jnp.stack([jnp.where(usable, u * reciprocal, 0.0) for u in unit], axis=-1)


# Squares of lengths from 1e-15, below which those of components vanish that still count, to 1e18.
SHORT, LONG = 1e-30, 1e36


def _per_length(v: Float[Array, "*b n"]) -> Float[Array, "*b 1"]:
    """1 / |v|, and 0 where its square is not between SHORT and LONG."""
    square = dot(v, v)
    usable = (square > SHORT) & (square < LONG)
    return jnp.where(usable, lax.rsqrt(jnp.where(usable, square, 1.0)), 0.0)[..., None]


@jax.custom_jvp
def unit(v: Float[Array, "*b n"]) -> Float[Array, "*b n"]:
    """v / |v|, and 0 where |v| is below 1e-15, above 1e18 or not finite: for distances and sums of unit vectors.

    Two passes over memory where `normalize`, right at any length, takes six: half of a frame's time.
    Gradient: exact where normalized, (∂v - u u·∂v) / |v|; 0 elsewhere. JAX's own rule cubes 1 / |v|, which overflows
    below 1e-13.
    """
    shrink = _per_length(v)
    return jnp.where(shrink > 0.0, shrink * v, 0.0)


@unit.defjvp
def _unit_jvp(primals, tangents):
    (v,), (v_dot,) = primals, tangents
    u, shrink = unit(v), _per_length(v)
    return u, jnp.where(shrink > 0.0, shrink * (v_dot - dot(u, v_dot)[..., None] * u), 0.0)


def length(v: Float[Array, "*b n"]) -> Float[Array, "*b"]:
    """|v|, and NaN where v is not finite. Gradient: exact for |v| > TINY; 0 below, where the plain one is NaN at 0."""
    return dot(v, normalize(v))
