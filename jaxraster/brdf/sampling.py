"""Microfacet normals as the viewer sees them, to be mirrored at: what draws GGX reflection with the least noise.

Space: the surface's own, z along n, x and y along the axes of its two `alpha`, equal ones for isotropic surfaces.
Directions are unit and above the surface, z > 0.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe
from .distribution import ggx_anisotropic
from .masking import stretched_length

Vector = Float[Array, "*b 3"]
Alpha = Float[Array, "*b 2"]


def visible_normal(u: Float[Array, "*b 2"], v: Vector, alpha: Alpha) -> tuple[Float[Array, "*b 3"], Float[Array, "*b"]]:
    """A normal h drawn as v sees it, and its `visible_density`. For a mirror, α = 0, these are n and 0.

    Where the ellipsoid is a sphere, and v is w there: h ∝ c + w, with c uniform on the sphere's cap z > -w_z. u in
    [0, 1)²; nothing is divided by a cosine, and h_z > 0 for all u < 1.

    Gradient: exact in all for α > `distribution.MIRROR`; finite at u = 0, at u → 1, at v = n and grazing, and at α = 0.
    Source: Heitz 2018, "Sampling the GGX Distribution of Visible Normals"; Dupuy and Benyoub 2023, "Sampling Visible
    GGX Normals with Spherical Caps".

    Example:
        >>> v, alpha = jnp.array([0.6, 0.0, 0.8]), jnp.full(2, 0.3)
        >>> h, density = visible_normal(jnp.array([0.0, 0.0]), v, alpha)
        >>> [f"{x:.3f}" for x in h.tolist()], f"{density:.3f}"
        (['0.033', '0.000', '0.999'], '3.499')
    """
    w = safe.normalize(jnp.stack([alpha[..., 0] * v[..., 0], alpha[..., 1] * v[..., 1], v[..., 2]], axis=-1))
    # With t = u (1 + w_z) the cap's height is 1 - t and its radius √(t (2 - t)), without cancellation at its top.
    angle, t = 2.0 * jnp.pi * u[..., 0], u[..., 1] * (1.0 + w[..., 2])
    radius = safe.sqrt(t * (2.0 - t))
    x, y = radius * jnp.cos(angle) + w[..., 0], radius * jnp.sin(angle) + w[..., 1]
    z = (1.0 - u[..., 1]) * (1.0 + w[..., 2])
    h = safe.normalize(jnp.stack([alpha[..., 0] * x, alpha[..., 1] * y, z], axis=-1))
    return h, visible_density(v, h, alpha)


def visible_density(v: Vector, h: Vector, alpha: Alpha) -> Float[Array, "*b"]:
    """D_v = G₁(v) (v·h)₊ D(h) / (n·v) per solid angle of h; 0 where h is below the surface or turned
    away from v, and for a mirror, α up to `distribution.MIRROR`.

    Of l, v mirrored at h, the density is D_v / (4 v·h). D is that of `ggx_anisotropic`; G₁/(n·v) = 2 / (n·v + |αv|) has
    no cosine to divide by.

    Gradient: exact; 0 where the density is 0.
    Source: Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", eqs. 2 and 87.
    """
    v_dot_h = safe.dot(v, h)
    density = 2.0 * ggx_anisotropic(h, alpha) * safe.divide(v_dot_h, v[..., 2] + stretched_length(v, alpha))
    return jnp.where(v_dot_h > 0, density, 0.0)


def reflection_weight(v: Vector, l: Vector, alpha: Alpha) -> Float[Array, "*b"]:
    """G₂(v, l) / G₁(v), from 0 to 1: D V (n·l) over the density of l, for l mirrored at a `visible_normal`. Times F it
    is what a drawn reflection counts; 0 for l below the surface, 1 for a mirror.

    = (n·l) (n·v + |αv|) / ((n·l) |αv| + (n·v) |αl|) with the height-correlated G₂ of `smith_correlated`: neither D nor
    a cosine is divided by, so that it is finite for every α and at every angle.

    Gradient: exact above the surface, 0 below.
    Source: Heitz 2018, eq. 19, and 2014, eq. 99.
    """
    n_dot_v, n_dot_l = v[..., 2], l[..., 2]
    long_v, long_l = stretched_length(v, alpha), stretched_length(l, alpha)
    weight = safe.divide(n_dot_l * (n_dot_v + long_v), n_dot_l * long_v + n_dot_v * long_l)
    return jnp.where(n_dot_l > 0, weight, 0.0)
