"""Screen positions as integers, and the exact sign of an edge function in 32 bits.

Positions are snapped to 1/256 of a pixel and counted from the picture's centre, x to the right and y down, so that a
pixel's centre is an odd or even multiple of 128. Inside the guard band of 2¹⁴ pixels they need 23 bits, their
products 46: those are kept as three limbs, because neither 64-bit integers nor an unfused float product are at hand
(XLA contracts `a*b - c*d` into a fused multiply-add, which breaks the antisymmetry that makes edges watertight).

Gradient: none, everything here is an integer.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

SUBPIXELS = 256
GUARD = 2**14  # pixels from the centre; beyond it triangles are clipped
_LIMB = 14  # bits of a limb: differences of 2²⁴ leave 10 bits above, and sums of four limb products fit in 31
_MASK = 2**_LIMB - 1

Ints = Int[Array, "*n"]


def snap(offset: Float[Array, "*n"]) -> Ints:
    """The nearest multiple of 1/256 pixel; the argument is clamped to the guard band, NaN gives 0."""
    limit = float(GUARD * SUBPIXELS)
    return jnp.clip(jnp.round(offset * SUBPIXELS), -limit, limit).astype(jnp.int32)


def difference_of_products(a: Ints, b: Ints, c: Ints, d: Ints) -> tuple[Ints, Ints, Ints]:
    """a·b - c·d exactly, as limbs (high, middle, low): high·2²⁸ + middle·2¹⁴ + low, middle and low in [0, 2¹⁴).

    Arguments are below 2²⁵ in magnitude.
    """
    (ah, al), (bh, bl), (ch, cl), (dh, dl) = ((v >> _LIMB, v & _MASK) for v in (a, b, c, d))
    low = al * bl - cl * dl
    middle = ah * bl + al * bh - ch * dl - cl * dh + (low >> _LIMB)
    high = ah * bh - ch * dh + (middle >> _LIMB)
    return high, middle & _MASK, low & _MASK


def to_float(limbs: tuple[Ints, Ints, Ints]) -> Float[Array, "*n"]:
    """The limbs' value to within a few roundings of itself.

    Carries first centre the lower limbs about 0: as they are, a small negative number is -2²⁸ plus nearly as much.
    """
    high, middle, low = limbs
    half = 1 << (_LIMB - 1)
    carry = (low + half) >> _LIMB
    low, middle = low - (carry << _LIMB), middle + carry
    carry = (middle + half) >> _LIMB
    middle, high = middle - (carry << _LIMB), high + carry
    high, middle, low = (limb.astype(jnp.float32) for limb in (high, middle, low))
    return high * 2.0 ** (2 * _LIMB) + (middle * 2.0**_LIMB + low)


def sign(limbs: tuple[Ints, Ints, Ints]) -> Ints:
    """-1, 0 or 1."""
    high, middle, low = limbs
    return jnp.where(high != 0, jnp.sign(high), jnp.sign(middle | low))


def edge(ax: Ints, ay: Ints, bx: Ints, by: Ints, px: Ints, py: Ints) -> tuple[Ints, Ints, Ints]:
    """E(a, b, p) = (b - a) × (p - a), positive where p lies clockwise of a→b on the screen (y down)."""
    return difference_of_products(bx - ax, py - ay, by - ay, px - ax)


def pixels_inside(limbs: tuple[Ints, Ints, Ints], dx: Ints, dy: Ints) -> Ints:
    """floor((E + t - 1) / 256), saturated at ±2³⁰: E in whole pixel steps, with the top-left rule folded in.

    t is 1 for a top or left edge and 0 for others, so that a sample on the edge counts only for the former. A sample
    i pixels right and j down of this one is inside iff `this - dy·i + dx·j >= 0`: x + 256k >= 0 exactly where
    floor(x / 256) + k >= 0.
    """
    high, middle, low = limbs
    top_left = (dy < 0) | ((dy == 0) & (dx > 0))
    low = low + jnp.where(top_left, 0, -1)
    # Saturate the high limb: within a tile the steps add less than 2²⁹, so that the sign of what is cut stands.
    high = jnp.clip(high, -1023, 1023)
    return (high << 20) + (middle << 6) + (low >> 8)
