"""Well-spread points of the unit square: the first two Sobol' dimensions, scrambled as by Owen, without a table.

Any aligned run of 2^k of them, such as the first 2^k, has exactly one point in each of the 2^k boxes 2^-i by 2^(i - k)
of every shape i: errors of means fall almost like 1/n instead of 1/√n. Scrambling keeps that, and makes means unbiased.

Source: Sobol' 1967; Owen 1995, "Randomly Permuted (t,m,s)-Nets"; Burley 2020, "Practical Hash-based Owen Scrambling".
"""

import jax.numpy as jnp
from jaxtyping import Array, Float32, Integer, UInt32

from .hash import bits, pcg, unit

Bits = UInt32[Array, "*#b"]


def _swap(x: Bits, mask: int, shift: int) -> Bits:
    """Exchange the bits of a mask with those `shift` above."""
    low = jnp.uint32(mask)
    return ((x >> shift) & low) | ((x & low) << shift)


def _reverse(x: Bits) -> Bits:
    """The 32 bits in reverse order."""
    for mask, shift in ((0x55555555, 1), (0x33333333, 2), (0x0F0F0F0F, 4), (0x00FF00FF, 8), (0x0000FFFF, 16)):
        x = _swap(x, mask, shift)
    return x


def _pascal(x: Bits) -> Bits:
    """Pascal's triangle modulo 2 times the bits: the second dimension's digits, lowest first.

    Of size 2^k it is [[P, P], [0, P]] of the one half as large, so that a step for each k does. Source: of the
    factors, Sobol's direction numbers v ^ (v >> 1), which make up the same matrix; the test holds them against these.
    """
    for mask, shift in ((0xAAAAAAAA, 1), (0xCCCCCCCC, 2), (0xF0F0F0F0, 4), (0xFF00FF00, 8), (0xFFFF0000, 16)):
        x = x ^ ((x & jnp.uint32(mask)) >> shift)
    return x


def _scramble(x: Bits, seed: Bits) -> Bits:
    """Flip each bit by a hash of the seed and the bits below it: Owen's nested scrambling of reversed digits.

    Every step lets bits influence higher ones only: products with even numbers, sums, products with odd numbers.
    Source: Laine and Karras 2011, "Stratified Sampling for Stochastic Transparency", in Vegdahl's 2021 form.
    """
    x = x ^ (x * jnp.uint32(0x3D20ADEA))
    x = x + seed
    x = x * ((seed >> 16) | jnp.uint32(1))
    x = x ^ (x * jnp.uint32(0x05526C56))
    return x ^ (x * jnp.uint32(0x53A22864))


def sobol(index: Integer[Array, "*#b"], key: Integer[Array, "*#b"]) -> Float32[Array, "*b 2"]:
    """The `index`-th of 2³² points in [0, 1)², of the sequence that belongs to `key`.

    A path needs more than two numbers: take a pair of each key, `sobol(sample, keyed(pixel, pair))`. The order of the
    points is scrambled, too, so that pairs with the same index are as independent as if shuffled.

    Gradient: none.

    Example:
        >>> from jaxraster.math.hash import keyed
        >>> points = sobol(jnp.arange(4, dtype=jnp.uint32), keyed(7, 0))
        >>> sorted((4 * points[:, 0]).astype(int).tolist()), sorted((4 * points[:, 1]).astype(int).tolist())
        ([0, 1, 2, 3], [0, 1, 2, 3])
    """
    index, key = bits(index), bits(key)
    order, first = pcg(key), pcg(key + jnp.uint32(0x9E3779B9))
    second = pcg(first)
    shuffled = _reverse(_scramble(_reverse(index), order))
    digits = _scramble(shuffled, first), _scramble(_pascal(shuffled), second)
    return jnp.stack([unit(_reverse(x)) for x in digits], axis=-1)
