"""Diffuse reflection of rough matter that keeps its energy: white reflects all light, at every roughness and angle.

Deep grooves lit from the viewer's side look flat and bright, as the moon does; `lambert` has its edge fall off.
Reciprocal. Cosines in [0, 1]; roughness in [0, 1], 0 being `lambert`.

With A = 1/(1 + c₁ r), E(μ) = A (1 + r G(μ)/π) is the albedo of one reflection and E' its mean:
f = colour A (1 + r s/t)/π + m (1 - E(n·v)) (1 - E(n·l)) / (π (1 - E')), the light of further ones, where
m = colour² E' / (1 - colour (1 - E')). The factor r that all three differences from 1 contain is divided out.

Gradient: exact; 0 in s/t where both cosines are 0, where the true one has no bound.
Source: Portsmouth, Kutz and Hill 2025, "EON: A Practical Energy-Preserving Rough Diffuse BRDF", JCGT 14(1), listing 1,
with its exact albedo; after Oren and Nayar 1994, and Fujii's "A tiny improvement of Oren-Nayar reflectance model".
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe

AT_GRAZING = 0.5 - 2.0 / (3.0 * math.pi)  # c₁ = G(0)/π
MEAN = 2.0 / 3.0 - 28.0 / (15.0 * math.pi)  # the cosine-weighted mean of G/π


def _missing(cosine: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """c₁ - G(μ)/π = (1 - E)/(A r), with G = sin (θ - sin μ) + ⅔ (tan (1 - sin³) - sin), μ = cos θ.

    tan (1 - sin³) = sin μ (1 + sin + sin²)/(1 + sin) has no cosine to divide by, and the angle by its sine and cosine
    no pole above.
    """
    sine = safe.sqrt((1.0 - cosine) * (1.0 + cosine))
    tangent_part = cosine * (1.0 + sine + sine * sine) / (1.0 + sine)
    g = sine * (jnp.arctan2(sine, cosine) - sine * cosine + 2.0 / 3.0 * (tangent_part - 1.0))
    return AT_GRAZING - g / jnp.pi


def oren_nayar(
    color: Float[Array, "*b 3"],
    roughness: Float[Array, "*b"],
    n_dot_v: Float[Array, "*b"],
    n_dot_l: Float[Array, "*b"],
    v_dot_l: Float[Array, "*b"],
) -> Float[Array, "*b 3"]:
    """f, with s = v·l - (n·v)(n·l) and t = max(n·v, n·l) where s > 0, else 1.

    Example:
        >>> cosines = [jnp.array(x) for x in (0.5, 0.5, 1.0)]  # lit from the viewer, both at 60°
        >>> f"{oren_nayar(jnp.ones(3), jnp.array(1.0), *cosines)[0]:.4f}, {1 / jnp.pi:.4f} by Lambert"
        '0.6525, 0.3183 by Lambert'
    """
    a = 1.0 / (1.0 + AT_GRAZING * roughness)
    s = v_dot_l - n_dot_v * n_dot_l
    towards = safe.divide(s, jnp.maximum(n_dot_v, n_dot_l))
    once = a * (1.0 + roughness * jnp.where(s > 0, towards, s))
    lost = a * roughness * _missing(n_dot_v) * _missing(n_dot_l) / (AT_GRAZING - MEAN)
    mean = (a * (1.0 + MEAN * roughness))[..., None]
    again = color * color * mean / (1.0 - color * (1.0 - mean))
    return (color * once[..., None] + again * lost[..., None]) / jnp.pi
