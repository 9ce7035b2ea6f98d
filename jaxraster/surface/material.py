"""Metallic-roughness materials, from what is authored to what the BRDF wants.

base, metallic m and roughness r, each its factor times its texture, become diffuse colour (1 - m)·base, f0 and f90
mixed by m between a dielectric's and (base, 1), and alpha = r². A dielectric of index n mirrors ((n - 1)/(n + 1))² head
on, 0.04 for n = 1.5, times its specular colour, at most 1, and weight; at grazing angles it mirrors the weight.
Linear Rec.709.

Gradient: exact in factors and texels, halved where a specular colour reaches 1; roughness below 0.045 is raised to it
and has none.
Source: glTF 2.0 specification, appendix B; KHR_materials_ior, _specular, _unlit and KHR_texture_transform.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from ..math.table import fetch
from ..scene import TEXTURE_SLOTS, Materials, Textures
from .gather import Fragment
from .normal_map import normal_map
from .texture import lookup

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
    return jnp.where((missing > 0)[..., None], safe.normalize(normal + missing[..., None] * view), normal)


def _place(fragment: Fragment, materials: Materials, slot: str):
    """The uv at which a slot's texture is looked up, and its footprint: of the right set, under the map of the slot."""
    column, uv, footprint = TEXTURE_SLOTS.index(slot), fragment.uv, fragment.footprint
    if materials.uv_sets is not None and fragment.second_uv is not None and fragment.second_footprint is not None:
        second = (fetch(materials.uv_sets[:, column], fragment.material) == 1)[..., None]
        uv = jnp.where(second, fragment.second_uv, uv)
        footprint = jnp.where(second[..., None], fragment.second_footprint, footprint)
    if materials.uv_transforms is not None:
        rows = fetch(materials.uv_transforms[:, column].reshape(-1, 6), fragment.material)
        rows = rows.reshape(*rows.shape[:-1], 2, 3)
        # Written out as sums: a product of matrices would be rounded to TF32 on an accelerator.
        uv = jnp.sum(rows[..., :2] * uv[..., None, :], axis=-1) + rows[..., 2]
        footprint = jnp.sum(rows[..., :2, None] * footprint[..., None, :, :], axis=-2)
    return uv, footprint


@functools.partial(jax.jit, static_argnames="slots")
def _fetch_textures(fragment: Fragment, materials: Materials, textures: Textures, slots: tuple[str, ...]) -> dict:
    """RGBA of each slot's texture at every pixel: one loop over the slots, so that the lookup is compiled once."""
    if not slots:
        return {}
    index = [fetch(getattr(materials, f"{slot}_texture"), fragment.material).astype(jnp.int32) for slot in slots]
    if materials.uv_sets is None and materials.uv_transforms is None:
        values = lax.map(lambda row: lookup(textures, row, fragment.uv, fragment.footprint), jnp.stack(index))
    else:
        uv, footprint = (jnp.stack(each) for each in zip(*(_place(fragment, materials, slot) for slot in slots)))
        values = lax.map(lambda place: lookup(textures, *place), (jnp.stack(index), uv, footprint))
    return dict(zip(slots, values))


def material(fragment: Fragment, materials: Materials, textures: Textures, slots: tuple[str, ...]) -> Surface:
    """The surface at every pixel. `slots` names the textures that are fetched; the others count as white or flat."""

    def factor(name) -> Any:
        values = getattr(materials, name)
        return None if values is None else fetch(values, fragment.material)

    fetched = _fetch_textures(fragment, materials, textures, slots)
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

    normal = face_viewer(normal, fragment.view)
    diffuse_color, f0, alpha, f90 = metallic_roughness(base, metallic, roughness, factor("ior"), factor("specular"))
    if materials.unlit is not None:
        unlit = factor("unlit")
        emissive = jnp.where(unlit[..., None], base, emissive)
        diffuse_color, f0 = (jnp.where(unlit[..., None], 0.0, each) for each in (diffuse_color, f0))
        f90 = jnp.where(unlit, 0.0, f90)
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
    )
