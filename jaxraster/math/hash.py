"""Random-looking numbers from integers: no state, the same on every machine, a tenth of the cost of threefry.

What a number is for is its key, `keyed(pixel, sample, dimension)`, and `uniform` makes it: the number of a pixel's
sample is the same in whatever tile, batch or device it is asked for. Number pixels over the whole picture. Not for
cryptography.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float32, Integer, UInt32


def bits(number: int | Integer[Array, "*b"]) -> UInt32[Array, "*b"]:
    """Whole numbers as 32 bits: of signed ones a shift would draw in the sign. Raises for others."""
    if not jnp.issubdtype(jnp.result_type(number), jnp.integer):
        raise TypeError(f"a key is made of whole numbers, got {jnp.result_type(number)}; take the index, not its share")
    return jnp.asarray(number).astype(jnp.uint32)


def pcg(x: Integer[Array, "*b"]) -> UInt32[Array, "*b"]:
    """A permutation of the 2³² integers: one step of a linear congruence, then O'Neill's RXS-M-XS output.

    Source: Jarzynski and Olano 2020, "Hash Functions for GPU Rendering", `pcg`; O'Neill 2014, "PCG".
    Gradient: none, integers have no tangent.
    """
    state = bits(x) * jnp.uint32(747796405) + jnp.uint32(2891336453)
    word = ((state >> ((state >> 28) + 4)) ^ state) * jnp.uint32(277803737)
    return (word >> 22) ^ word


def keyed(*coordinates: int | Integer[Array, "*#b"]) -> UInt32[Array, "*b"]:
    """One key of several whole numbers, such as pixel, sample and dimension: the hash of each is added to the next.

    pcg(pcg(pixel) + sample) + dimension, without the last hash, which `uniform` and `sobol` do. Their order matters.
    Gradient: none.

    Example:
        >>> pixel, sample = jnp.arange(6, dtype=jnp.uint32).reshape(2, 3), 4
        >>> numbers = uniform(keyed(pixel, sample, 0))
        >>> bool((numbers[1] == uniform(keyed(pixel[1], sample, 0))).all())
        True
    """
    key = bits(coordinates[0])
    for coordinate in coordinates[1:]:
        key = pcg(key) + bits(coordinate)
    return key


def unit(word: UInt32[Array, "*b"]) -> Float32[Array, "*b"]:
    """Integers as numbers in [0, 1): their upper 24 bits, all that float32 can hold without rounding up to 1."""
    return (word >> 8).astype(jnp.float32) * 2.0**-24


def uniform(key: Integer[Array, "*b"]) -> Float32[Array, "*b"]:
    """The hash of `key` as a number in [0, 1).

    Gradient: none.
    """
    return unit(pcg(key))
