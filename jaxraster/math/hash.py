"""Random-looking numbers from integers: no state, the same on every machine, about thirty times cheaper than threefry.

Nest calls to hash several coordinates, with `+` or `^` between them: `uniform(pcg(pcg(pixel) + sample) + dimension)`.
Not for cryptography.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float32, UInt32


def pcg(x: UInt32[Array, "*b"]) -> UInt32[Array, "*b"]:
    """A permutation of the 2³² integers: one step of a linear congruence, then O'Neill's RXS-M-XS output.

    Source: Jarzynski and Olano 2020, "Hash Functions for GPU Rendering", `pcg`; O'Neill 2014, "PCG".
    Gradient: none, integers have no tangent.
    """
    state = x * jnp.uint32(747796405) + jnp.uint32(2891336453)
    word = ((state >> ((state >> 28) + 4)) ^ state) * jnp.uint32(277803737)
    return (word >> 22) ^ word


def uniform(key: UInt32[Array, "*b"]) -> Float32[Array, "*b"]:
    """The hash of `key` as a number in [0, 1): its upper 24 bits, all that float32 can hold without rounding up to 1.

    Gradient: none.
    """
    return (pcg(key) >> 8).astype(jnp.float32) * 2.0**-24
