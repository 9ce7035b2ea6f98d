"""Exposure: how much light the picture's white stands for, in photographic stops (EV)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Number = float | Float[Array, ""]


def exposure(hdr: Float[Array, "*b"], ev: Number) -> Float[Array, "*b"]:
    """hdr · 2^ev: +1 EV doubles the light, whole stops are exact.

    `ev` is held to ±126, the exponents that a normal float32 can have, so that the factor is never 0 or infinite;
    the product may still overflow to infinity, which `tonemap` shows as white. NaN passes.
    Gradient: exact in both; 0 in `ev` beyond ±126.
    """
    ev = jnp.clip(jnp.asarray(ev, hdr.dtype), -126.0, 126.0)
    # Put whole stops into the exponent: XLA's exp2 of an integer is mostly an ulp off a power of two.
    whole = jax.lax.stop_gradient(jnp.round(ev))
    return hdr * (jnp.exp2(ev - whole) * jnp.ldexp(jnp.ones_like(ev), whole.astype(jnp.int32)))


def camera_ev(aperture: Number, seconds: Number, iso: Number) -> Float[Array, ""]:
    """The `ev` that a camera with f-number `aperture`, shutter time `seconds` and sensitivity `iso` applies to cd/m².

    EV100 = log2(N²/t · 100/S) and white is the saturating luminance 1.2 · 2^EV100, hence ev = -EV100 - log2(1.2).

    Source: Lagarde and de Rousiers 2014, "Moving Frostbite to PBR", section 5.1 (ISO 12232, lens factor q = 0.65).
    Gradient: exact for positive arguments.
    """
    aperture, seconds, iso = (jnp.asarray(x, jnp.result_type(float)) for x in (aperture, seconds, iso))
    return -jnp.log2(1.2 * aperture * aperture / seconds * (100.0 / iso))
