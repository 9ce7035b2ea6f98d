"""The first lesson's reflectance: Blinn–Phong over Lambert, for `Plan.shading = "local"`.

f = colour/π + f0 (s + 8)/(8π) (n·h)^s, both times n·l, with s = 2/α² - 2, the cosine power whose lobe has the width of
Beckmann's of the same alpha: it falls to a half 0.83 α from the peak, GGX 0.64 α but with a longer tail.
Without Fresnel and masking: what the standard model is compared against. Reciprocal, but not energy conserving: of
white light f0 = 1 returns up to 1.07 head on, and when polished next to nothing at grazing angles.

Gradient: exact where n·l > 0 and n·h > 0; 0 elsewhere.
Source: Blinn 1977; the normalization is Hoffman's in "Real-Time Rendering", 3rd ed., eq. 7.46; the exponent is that of
Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces".
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from .diffuse import lambert


def blinn_phong(surface: Surface, l: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular reflectance times n·l, per unit irradiance at normal incidence."""
    n_dot_l = jnp.maximum(safe.dot(surface.normal, l), 0.0)
    n_dot_h = safe.dot(surface.normal, safe.normalize(surface.view + l))
    shininess = 2.0 / (surface.alpha * surface.alpha) - 2.0
    facing = n_dot_h > safe.TINY
    # exp2(s log2 x) costs a third of pow, and x is at most 1 + one rounding.
    power = jnp.exp2(shininess * jnp.log2(jnp.where(facing, jnp.minimum(n_dot_h, 1.0), 1.0)))
    lobe = jnp.where(facing, (shininess + 8.0) / (8.0 * jnp.pi) * power, 0.0)
    return lambert(surface.diffuse_color) * n_dot_l[..., None], surface.f0 * (lobe * n_dot_l)[..., None]
