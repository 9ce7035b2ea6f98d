"""Tone curves: scene light of any strength to display light in [0, 1].

Linear Rec.709 in, display-linear Rec.709 out, 1 being the display's white; encode it with `srgb_encode`. Whatever the
curve: negative light acts as 0, infinite light as white, and NaN stays NaN (in all channels where a curve mixes them).
"""

import difflib
from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.polynomial import Polynomial

from ..math.safe import TINY
from .transfer import luminance

RGB = Float[Array, "*b 3"]

# Light beyond 2³⁰ times white counts as 2³⁰. Every curve is flat to float32 by then, and products of four such numbers
# (a rational curve's derivative divides by the square of a square) stay below float32's 2¹²⁸.
BRIGHTEST = 2.0**30


def _clamp(x: RGB, low: float, high: float) -> RGB:
    """x held to [low, high]. Gradient: 1 on the closed interval, where jnp.clip has ½ at its ends; 0 outside."""
    return jnp.where(x < low, low, jnp.where(x > high, high, x))


def _mix(matrix: tuple[tuple[float, float, float], ...], rgb: RGB) -> RGB:
    """matrix · rgb, written out: a matrix unit would round the colours to 10 bits."""
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    return jnp.stack([x * r + y * g + z * b for x, y, z in matrix], axis=-1)


def _clip(rgb: RGB) -> RGB:
    """x: exact up to white, and everything brighter is lost."""
    return rgb


def _reinhard(rgb: RGB) -> RGB:
    """x / (1 + x) in each channel. Source: Reinhard et al. 2002, "Photographic Tone Reproduction", equation 3."""
    return 1.0 - 1.0 / (1.0 + rgb)


def _reinhard_luminance(rgb: RGB) -> RGB:
    """c · L'/L with L' = L / (1 + L), that is c / (1 + L), which black does not divide by 0.

    Keeps the ratio of the channels until one of them passes white. Source: Reinhard et al. 2002, equation 3.
    """
    return rgb / (1.0 + luminance(rgb)[..., None])


def _aces_narkowicz(rgb: RGB) -> RGB:
    """x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14) in each channel.

    Source: Narkowicz 2016, "ACES Filmic Tone Mapping Curve"; a fit by eye that is brighter than ACES.
    """
    return rgb * (2.51 * rgb + 0.03) / (rgb * (2.43 * rgb + 0.59) + 0.14)


# Rec.709 to ACES AP1 (Bradford D65 to D60) with the RRT's desaturation, and back with the ODT's.
_ACES_IN = ((0.59719, 0.35458, 0.04823), (0.07600, 0.90834, 0.01566), (0.02840, 0.13383, 0.83777))
_ACES_OUT = ((1.60475, -0.53108, -0.07367), (-0.10208, 1.10813, -0.00605), (-0.00327, -0.07276, 1.07602))


def _aces_hill(rgb: RGB) -> RGB:
    """A rational fit of ACES 1.0's RRT and sRGB ODT in its own primaries; grey below 0.0033 is black.

    As published: without the factor 1/0.6 by which three.js and glTF viewers brighten their input (here: +0.737 EV).
    Source: Hill, in Pettineo and Neubelt's "BakingLab" (ACES.hlsl).
    """
    v = _mix(_ACES_IN, rgb)
    return _mix(_ACES_OUT, (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081))


def _pbr_neutral(rgb: RGB) -> RGB:
    """Base colours from 0.08 to 0.8 shown as they are (less 0.04, the reflection on top), highlights towards white.

    Source: Khronos 2024, "PBR Neutral Tone Mapper": F90 0.04, knee Ks = 0.8 - F90, desaturation Kd 0.15.
    Gradient: exact; where channels tie for least or greatest it is shared between them.
    """
    f90, knee, desaturation = 0.04, 0.8 - 0.04, 0.15
    low = jnp.min(rgb, axis=-1, keepdims=True)
    color = rgb - jnp.where(low <= 2.0 * f90, low - low * low / (4.0 * f90), f90)
    peak = jnp.max(color, axis=-1, keepdims=True)
    # Give the compressed branch a harmless peak where it is not taken: its divisor has a zero below the knee.
    compressed = peak > knee
    p = jnp.where(compressed, peak, 1.0)
    new_peak = 1.0 - (1.0 - knee) ** 2 / (p + 1.0 - 2.0 * knee)
    keep = 1.0 / (desaturation * (p - new_peak) + 1.0)
    return jnp.where(compressed, color * (new_peak / p) * keep + new_peak * (1.0 - keep), color)


_AGX_IN = (
    (0.842479062253094, 0.0784335999999992, 0.0792237451477643),
    (0.0423282422610123, 0.878468636469772, 0.0791661274605434),
    (0.0423756549057051, 0.0784336, 0.879142973793104),
)
_AGX_OUT = (
    (1.19687900512017, -0.0980208811401368, -0.0990297440797205),
    (-0.0528968517574562, 1.15190312990417, -0.0989611768448433),
    (-0.0529716355144438, -0.0980434501171241, 1.15107367264116),
)
_AGX_LOG2 = (-12.47393, 4.026069)
_AGX_SIGMOID = (-0.00232, 0.1191, 0.4298, -6.868, 31.96, -40.14, 15.5)
# The same polynomial about ½: about 0, terms of up to 40 cancel, and float32 would keep 5 digits of its 7.
_AGX_CENTRED = Polynomial(_AGX_SIGMOID)(Polynomial((0.5, 1.0))).coef.tolist()


def _agx(rgb: RGB) -> RGB:
    """Primaries drawn towards grey, a sigmoid in log2 of the light, drawn back; saturated light fades to white.

    The sigmoid's output is display-encoded: the power 2.2 makes it linear again. Grey below 2.2e-4 is black, white
    is 0.9965 (code 255), and the published matrices leave a grey within 0.06 of an 8-bit code of neutral.

    Source: Sobotka's AgX, in Wrensch's 2023 "Minimal AgX Implementation" (polynomial of 6th order, no look applied).
    """
    low, high = _AGX_LOG2
    x = (jnp.log2(_clamp(_mix(_AGX_IN, rgb), 2.0**low, 2.0**high)) - low) / (high - low)
    y = jnp.zeros_like(x)
    for coefficient in reversed(_AGX_CENTRED):
        y = y * (x - 0.5) + coefficient
    # Start the power just above 0, where its logarithm has a pole; the power itself underflows to 0 there.
    return jnp.exp2(2.2 * jnp.log2(_clamp(_mix(_AGX_OUT, y), TINY, 1.0)))


# The bare curves, for light from 0 to BRIGHTEST; `tonemap` clamps before and after.
TONEMAPS: dict[str, Callable[[RGB], RGB]] = {
    "clip": _clip,
    "reinhard": _reinhard,
    "reinhard_luminance": _reinhard_luminance,
    "aces_narkowicz": _aces_narkowicz,
    "aces_hill": _aces_hill,
    "pbr_neutral": _pbr_neutral,
    "agx": _agx,
}


def tonemap(rgb: RGB, name: str) -> RGB:
    """Show scene light with the curve `name` of `TONEMAPS`.

    Gradient: the curve's, one-sided at 0; 0 where light is below 0 or above BRIGHTEST, and where the curve leaves
    [0, 1]: near black (aces_hill, agx), beyond white (clip, both aces), in a channel outside the display's gamut.

    Example:
        >>> tonemap(jnp.array([1.0, 3.0, 7.0]), "reinhard").tolist()
        [0.5, 0.75, 0.875]
    """
    if name not in TONEMAPS:
        close = difflib.get_close_matches(name, TONEMAPS, n=1, cutoff=0.5)
        hint = f", did you mean {close[0]!r}" if close else ""
        raise ValueError(f"tonemap: no curve is named {name!r}{hint}; choose one of {', '.join(TONEMAPS)}")
    return _clamp(TONEMAPS[name](_clamp(rgb, 0.0, BRIGHTEST)), 0.0, 1.0)
