"""Ambient occlusion on the screen against rays: `python -m benchmarks.occlusion [--helmet FILE] [--pictures FOLDER]`.

On two built-in scenes and a file of the field: the mean difference from any-hit rays of the same reach, spread as the
cosine about the shading normal above the face itself, over what is seen; and the fastest of several runs of the
occlusion alone, in milliseconds, all taking turns. Pictures show none, the classic, horizons and rays side by side.
"""

import argparse
import pathlib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import jaxraster as jr
from jaxraster.math import safe
from jaxraster.math.hash import keyed
from jaxraster.math.sampling import cosine_hemisphere
from jaxraster.math.sobol import sobol
from jaxraster.math.transform import frame
from jaxraster.screen.horizon import HorizonAO, horizon
from jaxraster.screen.ssao import SSAO, ssao
from jaxraster.surface.gather import gather
from jaxraster.surface.material import material

from .__main__ import _file
from .measure import turns
from .workloads import _load

SETTINGS = {
    "horizon, default": HorizonAO(),
    "horizon, falloff 0.25": HorizonAO(falloff=0.25),
    "horizon, 4 steps": HorizonAO(steps=4),
    "horizon, 1 slice of 16 steps": HorizonAO(slices=1, steps=16),
    "horizon, 4 slices of 16 steps": HorizonAO(slices=4, steps=16),
    "horizon, thickness 0.1": HorizonAO(thickness=0.1),
    "horizon, edge 0.1": HorizonAO(edge=0.1),
    "SSAO, default": SSAO(),
    "SSAO, 64 samples": SSAO(samples=64),
}
METHODS = {HorizonAO: jax.jit(horizon), SSAO: jax.jit(ssao)}


def seen(scene: jr.Scene, camera: jr.Camera, size: int) -> tuple[jr.Visibility, jr.Surface]:
    """What is occluded, with the normals of normal maps."""

    @jax.jit
    def draw(scene, camera):
        sizes = {"width": size, "height": size}
        clip = jr.project(scene.mesh.vertices, camera, **sizes)
        visibility = jr.rasterize(clip, scene.mesh.faces, **sizes)
        fragment = gather(scene, visibility, clip, camera)
        return visibility, material(fragment, scene.materials, scene.textures, ("normal",))

    return jax.block_until_ready(draw(scene, camera))


def traced(scene: jr.Scene, tree: jr.Tree, visibility: jr.Visibility, surface: jr.Surface, radius: float, rays: int):
    """The share of so many rays from each pixel, of those above its face, that meet nothing."""
    pixel = jnp.arange(surface.mask.size, dtype=jnp.uint32).reshape(surface.mask.shape)

    def add(sample, totals):
        local, _ = cosine_hemisphere(sobol(jnp.full_like(pixel, sample), keyed(pixel, 0)))
        axes = (*frame(surface.normal), surface.normal)
        direction = sum(local[..., k, None] * axis for k, axis in enumerate(axes))
        away = jr.spawn(scene.mesh.vertices, scene.mesh.faces, visibility.face, visibility.barycentric, direction)
        above = jnp.sum(direction * surface.geometric_normal, axis=-1) > 0
        free = above & ~jr.occluded(replace(away, t_max=radius), tree)
        return totals[0] + jnp.where(free, 1.0, 0.0), totals[1] + jnp.where(above, 1.0, 0.0)

    free, above = jax.lax.fori_loop(0, rays, add, (jnp.zeros(surface.mask.shape),) * 2)
    return safe.divide(free, above, 1.0)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.occlusion", description=__doc__.splitlines()[0].split(":")[0]
    )
    parser.add_argument("--helmet", type=_file, metavar="FILE", help="a large file of the field")
    parser.add_argument("--size", type=int, default=512, metavar="PX", help="a side of the square pictures")
    parser.add_argument("--rays", type=int, default=64, metavar="N", help="of each pixel, for what is held to be true")
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="the fastest of so many is quoted")
    parser.add_argument("--pictures", type=pathlib.Path, metavar="FOLDER", help="where to write pictures, too")
    options = parser.parse_args(arguments)
    scenes = {"stage": jr.scenes.stage(), "cornell-box": jr.scenes.cornell_box()}
    scenes |= {options.helmet.stem: _load(options.helmet)} if options.helmet else {}
    rays = f"{options.rays} rays"
    cells: dict[str, list[str]] = {name: [] for name in ("none", *SETTINGS, rays)}
    for file, (scene, camera) in scenes.items():
        visibility, surface = seen(scene, camera, options.size)
        tree, mask = jr.build(scene.mesh.vertices, scene.mesh.faces), np.asarray(surface.mask)
        truth = jax.jit(lambda *parts: traced(*parts, radius=HorizonAO().radius, rays=options.rays))
        inputs = scene, tree, visibility, surface
        calls = {
            name: lambda made=made, surface=surface, camera=camera: jax.block_until_ready(
                METHODS[type(made)](surface, camera, made)
            )
            for name, made in SETTINGS.items()
        }
        shown = {name: np.asarray(call().visibility) for name, call in calls.items()} | {"none": np.ones(mask.shape)}
        calls[rays] = lambda truth=truth, inputs=inputs: jax.block_until_ready(truth(*inputs))
        shown[rays] = np.where(mask, calls[rays](), 1.0)
        times = {"none": 0.0} | turns(calls, options.runs)
        for name, best in times.items():
            cells[name].append(f"{np.abs(shown[name] - shown[rays])[mask].mean():.4f}, {best:.1f}")
        if options.pictures:
            beside = [shown[name] for name in ("none", "SSAO, default", "horizon, default", rays)]
            jr.save(options.pictures / f"{file}.png", np.concatenate(beside, axis=1)[..., None].repeat(3, axis=-1))
    print("| setting | " + " | ".join(f"{name}: error, ms" for name in scenes) + " |\n|---|" + "---|" * len(scenes))
    for name, row in cells.items():
        print(f"| {name} | {' | '.join(row)} |")


if __name__ == "__main__":
    main()
