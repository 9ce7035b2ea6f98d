"""The microfacet lobe: light mirrored once, D V F.

Space: world, all vectors unit. Loses what is mirrored more than once: with F = 1, 69 % head on at roughness 1.

Gradient: exact where n·l > 0 and 0 elsewhere, finite at n·l = 0, n·v = 0, h = n and l = -v.
Source: Cook and Torrance 1982, with the factors of `distribution`, `masking` and `fresnel`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from ..math.table import kept
from .distribution import ggx
from .fresnel import schlick
from .masking import smith_correlated

# Normals of `render` face the viewer by more than this; it bounds V for those who call with normals that do not.
MIN_N_DOT_V = 1e-4


def specular(
    surface: Surface, l: Float[Array, "*b 3"]
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"], Float[Array, "*b"], Float[Array, "*b"]]:
    """(D V F (n·l), F at v·h, n·v, n·l), the cosines raised to 1e-4 and 0."""
    n, v = surface.normal, surface.view
    h = safe.unit(v + l)
    n_dot_l = safe.dot(n, l)
    lit = n_dot_l > 0
    n_dot_l = jnp.where(lit, n_dot_l, 0.0)
    n_dot_v = safe.dot(n, v)
    n_dot_v = jnp.where(n_dot_v < MIN_N_DOT_V, MIN_N_DOT_V, n_dot_v)

    lobe = ggx(n, h, surface.alpha) * smith_correlated(n_dot_v, n_dot_l, surface.alpha) * n_dot_l
    # Keep what weighs the channels, or it is worked out for each of them.
    lobe, v_dot_h, n_dot_v, n_dot_l = kept((jnp.where(lit, lobe, 0.0), safe.dot(v, h), n_dot_v, n_dot_l), surface.mask)
    fresnel = schlick(surface.f0, v_dot_h, surface.f90)
    return lobe[..., None] * fresnel, fresnel, n_dot_v, n_dot_l
