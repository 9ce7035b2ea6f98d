"""The metallic-roughness BRDF as glTF specifies it, for `Plan.shading = "gltf"`: what other viewers show.

f = (1 - F) colour/π + D V F, both times n·l. It does not conserve energy. Rough metal loses what is mirrored more than
once. The diffuse is weighed by 1 - F of the light's own half vector, so that a white dielectric seen at grazing angles
returns more than it gets: up to 1.86 when polished, 1.24 at roughness 0.4 and 1.01 at 1 (at n·v = 0.01, in uniform
light). `standard` does neither. Reciprocal.

Gradient: that of `specular`.
Source: glTF 2.0 specification, appendix B, in its final form of one lobe, whose F takes the mixed f0. Between metal and
dielectric this is darker than a mix of the two results: its diffuse is weighed by 1 - F of the mix.
"""

from jaxtyping import Array, Float

from ..buffers import Surface
from .diffuse import lambert
from .over import over
from .specular import specular


def gltf(surface: Surface, l: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular reflectance times n·l, per unit irradiance at normal incidence."""
    mirrored, fresnel, _, n_dot_l = specular(surface, l)
    return over(surface, l, lambert(surface.diffuse_color) * (1.0 - fresnel) * n_dot_l[..., None], mirrored)
