"""A shaded frame beside a shader's: `python -m benchmarks.shaded [--size PX] [--runs N] [--helmet FILE]`.

GGX over Lambert, one directional light, one shadow map of 1024² with 3×3 comparisons, no textures, linear light: by
`jr.render` and by GLSL on Mesa's llvmpipe, which take turns. Prints milliseconds, their ratio, the share of pixels that
differ by more than a fiftieth of the greatest light, and the ratios' geometric mean.
"""

import argparse
import dataclasses
import math
import pathlib
import warnings

import jax
import jax.numpy as jnp
import numpy as np

import jaxraster as jr
from jaxraster.geometry import shapes
from jaxraster.io.rig import frame_camera

from . import memory
from .measure import turns
from .peers import reason
from .peers.mesa_shaded import MesaShaded

SLANT = 0.35, -0.45, -1.0  # of the light, as the camera sees it: over its shoulder, so that a box's open side is lit
GREY = jr.stack_materials([{"base_color": (0.8, 0.5, 0.3, 1.0), "metallic": 0.5, "roughness": 0.4}])
NOTHING = jr.pack_textures([])


def _lit(scene: jr.Scene, camera: jr.Camera) -> jr.Scene:
    """The scene under one light."""
    direction = np.asarray(camera.world_from_view)[:3, :3] @ np.array(SLANT)
    return dataclasses.replace(scene, lights=jr.stack_lights(directional=[(direction, (3.0, 3.0, 3.0))]))


def scenes(helmet: pathlib.Path | None) -> dict:
    """Scenes and cameras by name."""
    made = {}
    for name, subdivisions in (("W1 sphere of 1,280", 3), ("W2 sphere of 81,920", 6), ("W3 sphere of 327,680", 7)):
        mesh = shapes.icosphere(1.0, subdivisions)
        sky = jr.Environment(up=jnp.array([0.0, 1.0, 0.0]), sky=jnp.zeros(3), ground=jnp.zeros(3))
        scene = jr.Scene(mesh=mesh, materials=GREY, textures=NOTHING, lights=jr.stack_lights(), environment=sky)
        made[name] = scene, frame_camera(mesh)
    if helmet:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            made[f"W4 {helmet.stem}"] = jr.load(helmet)
    made["W5 Cornell box"] = jr.scenes.cornell_box()
    return {name: (_lit(scene, camera), camera) for name, (scene, camera) in made.items()}


def measure(scene: jr.Scene, camera: jr.Camera, size: int, runs: int) -> tuple[dict[str, float], float]:
    """Milliseconds of each, and the share of pixels that differ."""
    plan = jr.Plan(
        width=size, height=size, shading="gltf", texture_slots=(), light_kinds=("directional",), cull=False,
        shadow_map=jr.ShadowMap(), ambient=None, emission=None, background=None,
    )  # fmt: skip
    draw = jax.jit(lambda scene, camera, plan: jr.render(scene, camera, plan).hdr).lower(scene, camera, plan).compile()
    peer = MesaShaded(scene, camera, size)
    ours = np.asarray(draw(scene, camera, plan))[..., :3]
    peer.draw()
    theirs = peer.picture()
    times = turns({"ours": lambda: jax.block_until_ready(draw(scene, camera, plan)), "Mesa": peer.draw}, runs)
    peer.release()
    return times, float(np.mean(np.abs(ours - theirs).max(axis=-1) > 0.02 * theirs.max()))


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.shaded", description=__doc__.splitlines()[0].split(":")[0]
    )
    parser.add_argument("--size", type=int, default=512, metavar="PX", help="a side of the square pictures")
    parser.add_argument("--runs", type=int, default=7, metavar="N", help="the fastest of so many is quoted")
    parser.add_argument("--helmet", type=pathlib.Path, metavar="FILE", help="a large file of the field, as W4")
    options = parser.parse_args()
    memory.keep()
    print("| scene | ours, ms | Mesa, ms | ratio | differ |\n|---|--:|--:|--:|--:|")
    ratios = []
    for name, (scene, camera) in scenes(options.helmet).items():
        try:
            times, differ = measure(scene, camera, options.size, options.runs)
        except Exception as error:
            print(f"Mesa does not draw {name}: {reason(error)}")
            continue
        ratios.append(times["Mesa"] / times["ours"])
        cells = f"{times['ours']:.1f} | {times['Mesa']:.1f} | {ratios[-1]:.2f} | {100 * differ:.2f} %"
        print(f"| {name} | {cells} |", flush=True)
    if ratios:
        print(f"geometric mean of Mesa's time over ours: {math.exp(np.mean(np.log(ratios))):.2f}")


if __name__ == "__main__":
    main()
