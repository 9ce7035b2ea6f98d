"""Metallic-roughness materials, from what is authored to what the BRDF wants.

base, metallic m and roughness r, each its factor times its texture, become diffuse colour (1 - m)·base,
f0 = 0.04 + m (base - 0.04), and alpha = r². Linear Rec.709.

Gradient: exact in factors and texels; roughness below 0.045 is raised to it and has none.
Source: glTF 2.0 specification, appendix B.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from ..scene import Materials, Textures
from .gather import Fragment
from .normal_map import normal_map
from .texture import texture

DIELECTRIC_F0 = 0.04  # ((n - 1) / (n + 1))² of n = 1.5
# Below this a highlight is narrower than float32's unit vectors resolve (D(0) = 8e4); Filament's floor as well.
MIN_ROUGHNESS = 0.045
# The cosine of the last sixteenth of a degree before grazing: below, V and the mirror direction say nothing any more.
MIN_N_DOT_V = 1e-3


def metallic_roughness(
    base: Float[Array, "*b 3"], metallic: Float[Array, "*b"], roughness: Float[Array, "*b"]
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"], Float[Array, "*b"]]:
    """(diffuse colour, f0, alpha)."""
    metallic = metallic[..., None]
    roughness = jnp.where(roughness < MIN_ROUGHNESS, MIN_ROUGHNESS, roughness)
    return base * (1.0 - metallic), DIELECTRIC_F0 + metallic * (base - DIELECTRIC_F0), roughness * roughness


def face_viewer(normal: Float[Array, "*b 3"], view: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The unit normal, bent the least that makes n·v at least 1e-3.

    Interpolation and normal maps turn the normals of visible pixels away from the viewer; their mirror directions
    would point into the surface. Gradient: exact.
    """
    missing = MIN_N_DOT_V - safe.dot(normal, view)
    return jnp.where((missing > 0)[..., None], safe.normalize(normal + missing[..., None] * view), normal)


def material(fragment: Fragment, materials: Materials, textures: Textures, slots: tuple[str, ...]) -> Surface:
    """The surface at every pixel. `slots` names the textures that are fetched; the others count as white or flat."""

    def factor(name):
        return getattr(materials, name).at[fragment.material].get(mode="promise_in_bounds")

    # Map over the slots, so that the lookup is compiled once and its indices are computed once.
    fetched = {}
    if slots:
        indices = jnp.stack([factor(f"{slot}_texture") for slot in slots])
        values = lax.map(lambda index: texture(textures, index, fragment.uv, fragment.footprint), indices)
        fetched = dict(zip(slots, values))

    base, metallic, roughness = factor("base_color")[..., :3], factor("metallic"), factor("roughness")
    emissive, occlusion, normal = factor("emissive"), jnp.ones_like(metallic), fragment.normal
    if "base_color" in slots:
        base = base * fetched["base_color"][..., :3]
    if "metallic_roughness" in slots:
        texel = fetched["metallic_roughness"]
        metallic, roughness = metallic * texel[..., 2], roughness * texel[..., 1]
    if "emissive" in slots:
        emissive = emissive * fetched["emissive"][..., :3]
    if "occlusion" in slots:
        occlusion = 1.0 + factor("occlusion_strength") * (fetched["occlusion"][..., 0] - 1.0)
    if "normal" in slots:
        mapped = normal_map(fetched["normal"][..., :3], factor("normal_scale"), normal, fragment.tangent)
        normal = jnp.where((factor("normal_texture") >= 0)[..., None], mapped, normal)

    normal = face_viewer(normal, fragment.view)
    diffuse_color, f0, alpha = metallic_roughness(base, metallic, roughness)
    return Surface(
        mask=fragment.mask,
        position=fragment.position,
        normal=normal,
        geometric_normal=fragment.geometric_normal,
        view=fragment.view,
        uv=fragment.uv,
        diffuse_color=diffuse_color,
        f0=f0,
        alpha=alpha,
        emissive=emissive,
        occlusion=occlusion,
    )
