"""The assembled metallic-roughness BRDF: GGX with all of its bounces over what it leaves to Lambert.

f = colour/π · (1 - E(l)) (1 - E(v)) / (1 - Ē) + D V F · (1 + f0 (1/E₁ - 1)), both times n·l, with E the albedo of the
specular part, Ē its mean and E₁ that of a perfect mirror. Space: world, all vectors unit.

In uniform light the diffuse part returns colour · (1 - E(v)), so that a white dielectric and a white metal return all
of it, and nothing returns more, at every angle, roughness and mix, within the table's error of 0.003. The diffuse part
is reciprocal, the specular but for its factor of v.

Gradient: that of `specular` and `energy`, finite at n·l = 0, n·v = 0, h = n and l = -v.
Source: materials as in glTF 2.0, appendix B; the diffuse is that of Kelemen and Szirmay-Kalos 2001, "A Microfacet Based
Coupled Specular-Matte BRDF Model with Importance Sampling", over the lobe of `compensation`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Surface
from .compensation import compensated_albedo, compensation, mean_compensated_albedo
from .diffuse import lambert
from .over import over
from .specular import specular

# What mirrors all but so little has no diffuse: its share would be a rounding over another, of either sign.
MIN_LEFT = 1e-5


def standard(surface: Surface, l: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular reflectance times n·l, per unit irradiance at normal incidence."""
    f0, f90, alpha = surface.f0, surface.f90, surface.alpha
    mirrored, _, n_dot_v, n_dot_l = specular(surface, l)
    left_v, left_l = (1.0 - compensated_albedo(f0, cosine, alpha, f90) for cosine in (n_dot_v, n_dot_l))
    left = 1.0 - mean_compensated_albedo(f0, alpha, f90)
    some = left > MIN_LEFT
    share = jnp.where(some, left_v * left_l / jnp.where(some, left, 1.0), 0.0)
    diffuse = lambert(surface.diffuse_color) * share * n_dot_l[..., None]
    return over(surface, l, diffuse, mirrored * compensation(f0, n_dot_v, alpha))
