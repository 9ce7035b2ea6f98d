"""The table of contents: scene -> visibility -> surface -> light -> linear HDR -> image."""

from contextlib import nullcontext
from typing import Any

import jax
import jax.numpy as jnp

from .brdf.blinn_phong import blinn_phong
from .brdf.standard import standard
from .buffers import Frame, Radiance
from .display.dither import dither
from .display.exposure import exposure
from .display.tonemap import tonemap
from .display.transfer import srgb_encode
from .light.ambient import ambient
from .light.background import background
from .light.emission import emission
from .light.punctual import punctual
from .light.shadow_map import shadow_map
from .plan import Plan, as_arrays
from .resolve import resolve
from .scene import Camera, Scene
from .surface.gather import gather
from .surface.material import material
from .visibility.project import project
from .visibility.raster import rasterize

BRDFS = {"standard": standard, "local": blinn_phong}


def render(scene: Scene, camera: Camera, plan: Plan) -> Frame:
    """Draw `scene` from `camera` as `plan` says.

    Under jit return what is needed: the rest is dead code. Map over batches: `vmap(render, in_axes=(None, 0, None))`.

    Gradient: exact in everything that shades a visible point; 0 through coverage, the depth test and shadows."""
    scene, camera = as_arrays(scene, camera, plan)
    size = {"height": plan.height * plan.supersample, "width": plan.width * plan.supersample}

    def effect(function, settings, *inputs, otherwise=None, **sizes) -> Any:
        with jax.named_scope(function.__name__) if settings is not None else nullcontext():
            return otherwise if settings is None else function(*inputs, settings, **sizes)

    # Find the triangle that each pixel sees.
    mesh, single_sided = scene.mesh, ~scene.materials.double_sided[scene.mesh.material]
    with jax.named_scope("visibility"):
        clip = project(mesh.vertices, camera, **size)
        visibility = rasterize(clip, mesh.faces, cull=single_sided if plan.cull else None, **size)

    # Look up what lies there.
    with jax.named_scope("surface"):
        fragment = gather(scene, visibility, clip, camera)
        surface = material(fragment, scene.materials, scene.textures, plan.texture_slots)

    # Light it, keeping the paths apart.
    share = effect(shadow_map, plan.shadow_map, surface, mesh, scene.lights.directional)
    shadow = None if plan.shadow_map is None else (plan.shadow_map.light, share)
    with jax.named_scope("direct"):
        direct = punctual(surface, scene.lights, plan.light_kinds, BRDFS[plan.shading], shadow)
    dark = jnp.zeros_like(surface.position)
    indirect = effect(ambient, plan.ambient, surface, scene.environment, otherwise=(dark, dark))
    emitted = effect(emission, plan.emission, surface, otherwise=dark)
    radiance = Radiance(
        direct_diffuse=direct[0],
        direct_specular=direct[1],
        indirect_diffuse=indirect[0],
        indirect_specular=indirect[1],
        emitted=emitted,
    )

    # Add it up in linear light, and only then make a picture of it.
    behind = effect(background, plan.background, camera, scene.environment, **size)
    hdr = resolve(radiance, surface.mask, behind, plan.supersample)
    with jax.named_scope("display"):
        image = srgb_encode(tonemap(exposure(hdr, plan.exposure), plan.tonemap))
    image = effect(dither, plan.dither, image, otherwise=image)
    return Frame(image=image, hdr=hdr, radiance=radiance, surface=surface, visibility=visibility)
