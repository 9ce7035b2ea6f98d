"""Two numbers of 32 bits in one complex number: one place of an array that a loop carries, and one to scatter into.

XLA evaluates a test again for each array that it selects from, and copies a loop's second array at every step.
Gradient: none.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Complex64, Float32, Int32

Number = Int32[Array, "..."] | Float32[Array, "..."]  # of shapes that broadcast


def _float(value):
    """The same bits as a float32."""
    return value if value.dtype == jnp.float32 else lax.bitcast_convert_type(value, jnp.float32)


def pair(first: Number, second: Number) -> Complex64[Array, "..."]:
    """The first as real part, the second as imaginary part; whole numbers by their bits.

    Example:
        >>> pairs = pair(jnp.array([0.5, 2.0]), jnp.int32(-1))
        >>> pairs.real.tolist(), unpair(pairs)[1].tolist()
        ([0.5, 2.0], [-1, -1])
    """
    return lax.complex(*jnp.broadcast_arrays(_float(first), _float(second)))


def unpair(pairs: Complex64[Array, "*n"]) -> tuple[Int32[Array, "*n"], Int32[Array, "*n"]]:
    """The bits of both."""
    one, two = (lax.bitcast_convert_type(part(pairs), jnp.int32) for part in (lax.real, lax.imag))
    return one, two
