"""The assembled metallic-roughness BRDF: GGX over Lambert.

f = (1 - F) colour/π + D V F, both times n·l. Space: world, all vectors unit.

Metal loses light to missing multiple scattering (69 % head on at roughness 1) and never gains any. The weight 1 - F is
that of the light's own half vector: a white dielectric seen at grazing angles returns more than it gets, up to 1.86
when polished, 1.24 at roughness 0.4 and 1.01 at 1 (at n·v = 0.01, in uniform light).

Gradient: exact in all arguments where n·l > 0 and 0 elsewhere, finite at n·l = 0, n·v = 0, h = n and l = -v.
Source: glTF 2.0 specification, appendix B, in its final form of one lobe, whose F takes the mixed f0. Between metal and
dielectric this is darker than a mix of the two results: its diffuse is weighed by 1 - F of the mix.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from .diffuse import lambert
from .distribution import ggx
from .fresnel import schlick
from .masking import smith_correlated

# Normals of `render` face the viewer by more than this; it bounds V for those who call with normals that do not.
MIN_N_DOT_V = 1e-4


def standard(surface: Surface, l: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular reflectance times n·l, per unit irradiance at normal incidence."""
    n, v = surface.normal, surface.view
    h = safe.normalize(v + l)
    n_dot_l = safe.dot(n, l)
    lit = n_dot_l > 0
    n_dot_l = jnp.where(lit, n_dot_l, 0.0)
    n_dot_v = safe.dot(n, v)
    n_dot_v = jnp.where(n_dot_v < MIN_N_DOT_V, MIN_N_DOT_V, n_dot_v)

    fresnel = schlick(surface.f0, safe.dot(v, h), surface.f90)
    lobe = ggx(n, h, surface.alpha) * smith_correlated(n_dot_v, n_dot_l, surface.alpha) * n_dot_l
    diffuse = lambert(surface.diffuse_color) * (1.0 - fresnel) * n_dot_l[..., None]
    return diffuse, jnp.where(lit, lobe, 0.0)[..., None] * fresnel
