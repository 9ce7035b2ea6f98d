"""Metallic-roughness materials, from what is authored to what the BRDF wants.

base, metallic m and roughness r, each its factor times its texture, become diffuse colour (1 - m)·base, f0 and f90
mixed by m between a dielectric's and (base, 1), and alpha = r². A dielectric of index n mirrors ((n - 1)/(n + 1))² head
on, 0.04 for n = 1.5, times its specular colour, at most 1, and weight; at grazing angles it mirrors the weight.
Linear Rec.709.

Gradient: exact in factors and texels, halved where a specular colour reaches 1; roughness below 0.045 is raised to it
and has none.
Source: glTF 2.0 specification, appendix B; KHR_materials_ior, _specular, _unlit, _clearcoat, _sheen and
KHR_texture_transform.
"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Coat, Surface
from ..math import safe
from ..math.table import fetch
from ..scene import Materials, Textures
from .gather import Fragment
from .normal_map import normal_map
from .opacity import blended_opacity
from .slots import fetch_textures

DIELECTRIC_F0 = 0.04  # ((n - 1) / (n + 1))² of n = 1.5
# Below this a highlight is narrower than float32's unit vectors resolve (D(0) = 8e4); Filament's floor as well.
MIN_ROUGHNESS = 0.045
# The cosine of the last sixteenth of a degree before grazing: below, V and the mirror direction say nothing any more.
MIN_N_DOT_V = 1e-3


def metallic_roughness(
    base: Float[Array, "*b 3"],
    metallic: Float[Array, "*b"],
    roughness: Float[Array, "*b"],
    ior: Float[Array, "*b"] | None = None,
    specular: Float[Array, "*b 4"] | None = None,
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"], Float[Array, "*b"], Float[Array, "*b"]]:
    """(diffuse colour, f0, alpha, f90)."""
    dielectric, weight = DIELECTRIC_F0, jnp.ones_like(metallic)
    if ior is not None:
        dielectric = (((ior - 1.0) / (ior + 1.0)) ** 2)[..., None]
    if specular is not None:
        weight = specular[..., 3]
        dielectric = jnp.minimum(dielectric * specular[..., :3], 1.0) * weight[..., None]
    f90 = weight + metallic * (1.0 - weight)
    metallic = metallic[..., None]
    roughness = jnp.where(roughness < MIN_ROUGHNESS, MIN_ROUGHNESS, roughness)
    return base * (1.0 - metallic), dielectric + metallic * (base - dielectric), roughness * roughness, f90


def face_viewer(normal: Float[Array, "*b 3"], view: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The unit normal, bent towards the viewer until n·v is at least 1e-3.

    Interpolation and normal maps turn the normals of visible pixels away from the viewer; their mirror directions
    would point into the surface. Gradient: exact.
    """
    missing = MIN_N_DOT_V - safe.dot(normal, view)
    return jnp.where((missing > 0)[..., None], safe.unit(normal + missing[..., None] * view), normal)


def material(
    fragment: Fragment, materials: Materials, textures: Textures, slots: tuple[str, ...], layered: bool = False
) -> Surface:
    """The surface at every pixel, and how opaque it is where it is one of several that are `layered`.

    `slots` names the textures that are fetched; the others count as white or flat.
    """

    def factor(name) -> Any:
        values = getattr(materials, name)
        return None if values is None else fetch(values, fragment.material)

    fetched = fetch_textures(fragment, materials, textures, slots)
    base, metallic, roughness = factor("base_color")[..., :3], factor("metallic"), factor("roughness")
    emissive, occlusion, normal = factor("emissive"), jnp.ones_like(metallic), fragment.normal
    if fragment.color is not None:
        base = base * fragment.color[..., :3]
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

    # A coat is smooth over the bumps of what it covers.
    clearcoat, coat, sheen = factor("clearcoat"), None, factor("sheen")
    if clearcoat is not None:
        rough = jnp.maximum(clearcoat[..., 1], MIN_ROUGHNESS)
        smooth = face_viewer(fragment.normal, fragment.view)
        coat = Coat(weight=clearcoat[..., 0], alpha=rough * rough, normal=smooth)
    if sheen is not None:
        sheen = jnp.concatenate([sheen[..., :3], sheen[..., 3:] ** 2], axis=-1)

    normal = face_viewer(normal, fragment.view)
    diffuse_color, f0, alpha, f90 = metallic_roughness(base, metallic, roughness, factor("ior"), factor("specular"))
    if materials.unlit is not None:
        unlit = factor("unlit")
        emissive = jnp.where(unlit[..., None], base, emissive)
        diffuse_color, f0 = (jnp.where(unlit[..., None], 0.0, each) for each in (diffuse_color, f0))
        f90 = jnp.where(unlit, 0.0, f90)
        sheen = None if sheen is None else jnp.where(unlit[..., None], 0.0, sheen)
        coat = None if coat is None else replace(coat, weight=jnp.where(unlit, 0.0, coat.weight))
    return Surface(
        mask=fragment.mask,
        position=fragment.position,
        normal=normal,
        geometric_normal=fragment.geometric_normal,
        view=fragment.view,
        uv=fragment.uv,
        diffuse_color=diffuse_color,
        f0=f0,
        f90=f90,
        alpha=alpha,
        emissive=emissive,
        occlusion=occlusion,
        opacity=blended_opacity(fragment, materials, fetched) if layered else None,
        coat=coat,
        sheen=sheen,
    )
