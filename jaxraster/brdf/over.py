"""What lies over a material: sheen on it, and clear coat over both.

coated = (1 - share) (sheen + base · scaling) + share · lobe, each times n·l; the terms are those of `sheen` and
`clearcoat`. Without either nothing is computed. What fibres and coat reflect counts as specular.

Gradient: that of `sheen` and `clearcoat`.
Source: glTF 2.0, KHR_materials_sheen and KHR_materials_clearcoat, in the order of the latter's layers.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from .clearcoat import clearcoat_lobe, clearcoat_share
from .sheen import sheen, sheen_scaling

Color = Float[Array, "*b 3"]


def over(
    surface: Surface, l: Color, diffuse: Color, specular: Color
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular reflectance times n·l of the whole, of those of the base."""
    v = surface.view
    if surface.sheen is not None:
        color, alpha, n = surface.sheen[..., :3], surface.sheen[..., 3], surface.normal
        n_dot_v, n_dot_l = (jnp.clip(safe.dot(n, w), 0.0, 1.0) for w in (v, l))
        under = sheen_scaling(color, n_dot_v, n_dot_l, alpha)[..., None]
        diffuse, specular = under * diffuse, under * specular + sheen(n, v, l, color, alpha)
    if surface.coat is not None:
        share = clearcoat_share(safe.dot(surface.coat.normal, v), surface.coat.weight)
        lobe = (share * clearcoat_lobe(surface.coat.normal, v, l, surface.coat.alpha))[..., None]
        left = 1.0 - share[..., None]
        diffuse, specular = left * diffuse, left * specular + lobe
    return diffuse, specular
