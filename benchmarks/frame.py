"""What a frame costs, stage by stage: `python -m benchmarks.frame [SCENE] [--width W] [--height H]`.

Prints compile seconds, and the fastest of several runs in milliseconds, of each stage compiled alone on the previous
one's results and of the whole frame. A stage alone writes all its outputs to memory; the frame need not.
"""

import argparse
import time
import warnings

import jax

import jaxraster as jr
from jaxraster.light.punctual import punctual
from jaxraster.light.shadow_map import shadow_map
from jaxraster.render import BRDFS
from jaxraster.surface.gather import gather
from jaxraster.surface.material import material
from jaxraster.visibility.project import project


def measure(name, function, *inputs, runs=5):
    """Compile, run, print; returns the result."""
    start = time.perf_counter()
    compiled = jax.jit(function).lower(*inputs).compile()
    compile_seconds = time.perf_counter() - start
    seconds = []
    for _ in range(1 + runs):
        start = time.perf_counter()
        result = jax.block_until_ready(compiled(*inputs))
        seconds.append(time.perf_counter() - start)
    memory = compiled.memory_analysis().temp_size_in_bytes / 2**20
    print(
        f"{name:<12} compile {compile_seconds:6.2f} s   run {1e3 * min(seconds[1:]):8.1f} ms   memory {memory:7.1f} MiB"
    )
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="stage")
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=480)
    options = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        built_in = jr.scenes.SCENES.get(options.scene)
        scene, camera = built_in() if built_in else jr.load(options.scene)
    plan, _ = jr.plan_for(scene, camera, width=options.width, height=options.height)
    size = {"width": plan.width, "height": plan.height}
    device = jax.devices()[0].device_kind
    print(f"{options.scene}: {scene.mesh.faces.shape[0]} faces, {plan.width}x{plan.height}, {device}")

    clip = measure("project", lambda s, c: project(s.mesh.vertices, c, **size), scene, camera)
    visibility = measure("rasterize", lambda p, s: jr.rasterize(p, s.mesh.faces, **size), clip, scene)
    fragment = measure("gather", gather, scene, visibility, clip, camera)
    surface = measure(
        "material", lambda f, s: material(f, s.materials, s.textures, plan.texture_slots), fragment, scene
    )
    if plan.shadow_map is not None:
        settings = plan.shadow_map
        measure("shadow_map", lambda f, s, c: shadow_map(f, s.mesh, s.lights, c, settings), surface, scene, camera)
    measure("punctual", lambda f, s: punctual(f, s.lights, plan.light_kinds, BRDFS[plan.shading]), surface, scene)
    measure("frame", lambda s, c, p: jr.render(s, c, p).image, scene, camera, plan)


if __name__ == "__main__":
    main()
