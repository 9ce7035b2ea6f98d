"""The table of contents: scene -> visibility -> surface -> light -> linear HDR -> image."""

from contextlib import nullcontext
from typing import Any

import jax
import jax.numpy as jnp

from .brdf.blinn_phong import blinn_phong
from .brdf.compensation import compensated_albedo
from .brdf.energy import directional_albedo
from .brdf.gltf import gltf
from .brdf.standard import standard
from .buffers import Frame, Occlusion, Radiance, Surface
from .display.dither import dither
from .display.exposure import exposure
from .display.tonemap import tonemap
from .display.transfer import srgb_encode
from .light.ambient import ambient
from .light.area import area
from .light.background import background
from .light.emission import emission
from .light.punctual import punctual
from .light.shadow_map import shadow_map
from .light.sunlit import sunlit
from .plan import Plan, as_arrays
from .resolve import resolve
from .scene import Camera, Scene
from .screen.horizon import HorizonAO, horizon
from .screen.ssao import SSAO, ssao
from .surface.gather import gather
from .surface.layered import layered
from .surface.material import material
from .surface.opacity import Holes, alpha_modes, casters
from .visibility.layers import layers
from .visibility.project import project
from .visibility.raster import rasterize

BRDFS = {"standard": standard, "gltf": gltf, "local": blinn_phong}
ALBEDOS = {"standard": compensated_albedo, "gltf": directional_albedo}


def occlusion(surface: Surface, camera: Camera, settings: HorizonAO | SSAO) -> Occlusion:
    """What hides the sky, by the method that the settings are for."""
    return (horizon if isinstance(settings, HorizonAO) else ssao)(surface, camera, settings)


def render(scene: Scene, camera: Camera, plan: Plan) -> Frame:
    """Draw `scene` from `camera` as `plan` says.

    Under jit return what is needed: the rest is dead code. Map over batches: `vmap(render, in_axes=(None, 0, None))`.

    Gradient: exact in everything that shades a visible point, and in how much of it is seen through what is blended; 0
    through coverage, the depth test, holes in masked materials, what hides the sky, and shadows but for "moments"."""
    scene, camera = as_arrays(scene, camera, plan)
    size = {"height": plan.height * plan.supersample, "width": plan.width * plan.supersample}

    def effect(function, settings, *inputs, otherwise=None, **sizes) -> Any:
        with jax.named_scope(function.__name__) if settings is not None else nullcontext():
            return otherwise if settings is None else function(*inputs, settings, **sizes)

    # Find the triangle that each pixel sees, or those that it sees through each other, and look up what lies there.
    mesh, single_sided = scene.mesh, ~scene.materials.double_sided[scene.mesh.material]
    cull = single_sided if plan.cull else None
    with jax.named_scope("visibility"):
        clip = project(mesh.vertices, camera, **size)
    if plan.layers is None:
        with jax.named_scope("visibility"):
            visibility = rasterize(clip, mesh.faces, cull=cull, **size)
        with jax.named_scope("surface"):
            fragment = gather(scene, visibility, clip, camera)
            surface = material(fragment, scene.materials, scene.textures, plan.texture_slots)
    else:
        modes, cut_out = alpha_modes(scene), Holes(scene=scene, camera=camera, clip=clip, slots=plan.texture_slots)
        visibility = effect(layers, plan.layers, clip, mesh.faces, modes, cut_out, cull, **size)
        with jax.named_scope("surface"):
            surface = layered(scene, visibility, clip, camera, plan.texture_slots)
        mesh = casters(mesh, modes)

    # Light it, keeping the paths apart.
    lights = sunlit(scene.lights, scene.environment)
    shares = effect(shadow_map, plan.shadow_map, surface, mesh, lights, camera, otherwise={})
    with jax.named_scope("direct"):
        direct = punctual(surface, lights, plan.light_kinds, BRDFS[plan.shading], shares)
    dark = jnp.zeros_like(surface.position)
    brdf, albedo = BRDFS[plan.shading], ALBEDOS.get(plan.shading)
    glow = effect(area, plan.area, surface, lights, brdf, albedo, otherwise=(dark, dark))
    hidden = effect(occlusion, plan.occlusion, surface, camera)
    indirect = effect(ambient, plan.ambient, surface, scene.environment, otherwise=(dark, dark), occlusion=hidden)
    emitted = effect(emission, plan.emission, surface, otherwise=dark)
    radiance = Radiance(
        direct_diffuse=direct[0] + glow[0],
        direct_specular=direct[1] + glow[1],
        indirect_diffuse=indirect[0],
        indirect_specular=indirect[1],
        emitted=emitted,
    )

    # Add it up in linear light, and only then make a picture of it.
    behind = effect(background, plan.background, camera, scene.environment, **size)
    hdr = resolve(radiance, surface.mask, behind, plan.supersample, surface.opacity)
    with jax.named_scope("display"):
        image = srgb_encode(tonemap(exposure(hdr, plan.exposure), plan.tonemap))
    image = effect(dither, plan.dither, image, otherwise=image)
    if plan.layers is not None:
        radiance, surface, visibility = jax.tree.map(lambda leaf: leaf[0], (radiance, surface, visibility))
    return Frame(image=image, hdr=hdr, radiance=radiance, surface=surface, visibility=visibility)
