"""F: the share of light a microfacet mirrors, by the cosine between its normal and the direction of the light.

Cosines are clamped to [0, 1], as a rounded product of unit vectors may pass 1: gradients are exact inside, and halved
at the clamp's two ends. The light is unpolarised; what is not mirrored is refracted or absorbed.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe

F82 = 1.0 / 7.0  # the cosine of 81.8°, where c (1 - c)⁶ is largest: there `schlick_f82` meets its second colour


def schlick(
    f0: Float[Array, "*b 3"], cosine: Float[Array, "*b"], f90: float | Float[Array, "*b"] = 1.0
) -> Float[Array, "*b 3"]:
    """F = f0 + (f90 - f0)(1 - cos)⁵; the cosine is clamped to [0, 1], as a rounded product of unit vectors may pass 1.

    f90, the share at grazing angles, is 1 in nature; an authored weight of the reflection scales it as it does f0.

    Gradient: exact inside (0, 1), halved at the clamp's two ends.
    Source: Schlick 1994, "An Inexpensive BRDF Model for Physically-based Rendering", eq. 15.
    """
    x = 1.0 - jnp.clip(cosine, 0.0, 1.0)
    x2 = x * x
    weight = (x2 * x2 * x)[..., None]
    return f0 + (jnp.broadcast_to(f90, cosine.shape)[..., None] - f0) * weight


def schlick_f82(
    f0: Float[Array, "*b 3"], tint: Float[Array, "*b 3"], cosine: Float[Array, "*b"]
) -> Float[Array, "*b 3"]:
    """F = S(c) - (1 - tint) S(1/7) · c (1 - c)⁶ / (1/7 (6/7)⁶), S `schlick`'s: f0 head on, tint · S at 81.8°, 1 at 90°.

    The dip before grazing angles that metals have and Schlick lacks, by two more products. Of the `metals` it is off
    the exact F by at most 0.025, where Schlick is by 0.2. f0 and tint in [0, 1]; never below 0, nor above S.

    Gradient: exact; 0 where F would be below 0, as around 70° with a dark f0 and a black tint.
    Source: Kutz, Hašan and Edmondson 2021, "Novel Aspects of the Adobe Standard Material", and OpenPBR 1.1; after
    Hoffman 2019, "Fresnel Equations Considered Harmful", and Lazányi and Szirmay-Kalos 2005.
    """
    c = jnp.clip(cosine, 0.0, 1.0)
    x2 = (1.0 - c) * (1.0 - c)
    dip = (c * x2 * x2 * x2 / (F82 * (1.0 - F82) ** 6))[..., None]
    f = schlick(f0, cosine) - dip * (1.0 - tint) * (f0 + (1.0 - f0) * (1.0 - F82) ** 5)
    return jnp.where(f > 0, f, 0.0)


def dielectric(cosine: Float[Array, "*b"], ior: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """F = ½ (((c - g)/(c + g))² + ((η² c - g)/(η² c + g))²) with g = √(η² - 1 + c²) = η cos of the refracted ray.

    `ior` η > 0 is the index behind the surface over that before it: 1.5 into glass, 1/1.5 out of it, where F is 1
    beyond the critical angle (total internal reflection). η = 1 mirrors nothing, at no angle. Right to 2e-6 in float32
    but near the critical angle: both differences are written as products with η² - 1, which cancels none.

    Gradient: exact; 0 beyond the critical angle, and growing without bound towards it.
    Source: Fresnel 1823, in the form of Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", 9.3.5.

    Example:
        >>> f"{dielectric(jnp.array(1.0), jnp.array(1.5)):.4f} {dielectric(jnp.array(0.5), jnp.array(1 / 1.5)):.4f}"
        '0.0400 1.0000'
    """
    c = jnp.clip(cosine, 0.0, 1.0)
    c2, step = c * c, (ior - 1.0) * (ior + 1.0)
    g = safe.sqrt(step + c2)
    across = safe.divide(step, (c + g) ** 2)
    along = safe.divide(step * ((step + 2.0) * c2 - 1.0), ((step + 1.0) * c + g) ** 2)
    total = (step < 0) & (step + c2 <= 0)
    return jnp.where(total, 1.0, 0.5 * (across * across + along * along))


def conductor(cosine: Float[Array, "*b"], n: Float[Array, "*b 3"], k: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """F of a metal of index n + ik, each channel's own: `dielectric` with a complex η, in real numbers.

    a + ib = √((n + ik)² - sin²) in the place of g, and squares of absolute values in the place of squares. The smaller
    of a and b is nk over the larger, which has no difference to cancel: right to 2e-6 in float32. n > 0 and k of 0 to
    100; n and k are those of three wavelengths, or of narrow bands that are then summed: see `metals`.

    Gradient: exact; 0 in k at k = 0 for n > 1.
    Source: Born and Wolf, "Principles of Optics", 7th ed., 14.2; in real numbers as in Lagarde 2013, "Memo on Fresnel
    equations".

    Example:
        >>> gold = [jnp.array(x) for x in ((0.18, 0.42, 1.4), (3.4, 2.5, 1.9))]  # at 630, 550 and 450 nm
        >>> [f"{x:.2f}" for x in conductor(jnp.array(1.0), *gold).tolist()]
        ['0.94', '0.80', '0.40']
    """
    c = jnp.clip(cosine, 0.0, 1.0)[..., None]
    c2, s2 = c * c, (1.0 - c) * (1.0 + c)
    real, half_imaginary = (n - 1.0) * (n + 1.0) - k * k + c2, n * k
    modulus = safe.sqrt(real * real + 4.0 * half_imaginary * half_imaginary)
    larger = safe.sqrt(0.5 * (modulus + jnp.abs(real)))
    smaller = safe.divide(half_imaginary, larger)
    a, b = jnp.where(real < 0, smaller, larger), jnp.where(real < 0, larger, smaller)
    across = safe.divide((a - c) ** 2 + b * b, (a + c) ** 2 + b * b)
    along = safe.divide((a * c - s2) ** 2 + b * b * c2, (a * c + s2) ** 2 + b * b * c2)
    return 0.5 * across * (1.0 + along)
