"""Many small pictures of one scene: `python -m benchmarks.batch`.

A batch of cameras by `jax.vmap` beside a loop of single pictures, and frames per second on one and on two devices of
the host, of the visibility alone and of the whole shaded frame.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

import jaxraster as jr
from jaxraster.geometry import shapes
from jaxraster.scenes import parts

from .calibration import INPUTS, calibration
from .measure import turns

SIZES = 64, 84  # px, what agents that learn from pictures look at
BATCH, CAMERAS, DEVICES, RUNS = 8, 64, 2, 5
TARGET = 1.15  # times as long as the loop may a batch take: what is mapped must not cost what single pictures do not


def scene() -> jr.Scene:
    """Four spheres before a wall, 5,122 faces."""
    balls = [parts.at(shapes.icosphere(0.42, 3), i % 2 - 0.5, i // 2 - 0.5, 0.0, i) for i in range(4)]
    wall = parts.at(shapes.plane(8.0, 8.0), 0.0, 0.0, -0.5, 4, pitch=90.0)
    room, _ = jr.scenes.material_grid(2, 2)
    return jr.Scene(
        mesh=shapes.merge([*balls, wall]),
        materials=room.materials,
        textures=room.textures,
        lights=room.lights,
        environment=room.environment,
    )


@functools.partial(jax.jit, static_argnums=0)
def cameras(count: int) -> jr.Camera:
    """So many cameras before the wall, from the left to the right."""

    def one(azimuth):
        pose = jr.orbit(azimuth, 0.2, 5.0, target=(0.0, 0.0, 0.0))
        return jr.Camera(world_from_view=pose, clip_from_view=jr.perspective(0.5, near=0.05))

    return jax.vmap(one)(jnp.linspace(-0.6, 0.6, count))


def pictures(scene: jr.Scene, size: int) -> dict:
    """What is drawn for (scene, camera), by name."""
    plan, _ = jr.plan_for(scene, cameras(CAMERAS), width=size, height=size)

    def visibility(scene, camera):
        clip = jr.project(scene.mesh.vertices, camera, height=size, width=size)
        return jr.rasterize(clip, scene.mesh.faces, height=size, width=size)

    return {"visibility": visibility, "frame": lambda scene, camera: jr.render(scene, camera, plan).image}


def batched(picture):
    """All cameras at once."""
    return jax.jit(jax.vmap(picture, in_axes=(None, 0)))


def looped(picture):
    """One camera after the other."""
    return jax.jit(lambda scene, cameras: jax.lax.map(lambda camera: picture(scene, camera), cameras))


def sharded(picture, devices: list):
    """Each device takes its share of the cameras."""
    mesh = Mesh(np.array(devices), ("camera",))
    share, whole = PartitionSpec("camera"), PartitionSpec()
    program = jax.vmap(picture, in_axes=(None, 0))
    # Do not ask which values vary: loops may begin with some that are the same everywhere.
    return jax.jit(jax.shard_map(program, mesh=mesh, in_specs=(whole, share), out_specs=share, check_vma=False))


def main() -> None:
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_num_cpu_devices", DEVICES)
    devices, room, few, many, fixed = jax.devices(), scene(), cameras(BATCH), cameras(CAMERAS), jax.device_put(INPUTS)
    print(f"{room.mesh.faces.shape[0]} faces; fastest of {RUNS}, in turns")
    for size in SIZES:
        for name, picture in pictures(room, size).items():
            calls = {"vmap": (batched(picture), room, few), "loop": (looped(picture), room, few)}
            calls |= {str(n): (sharded(picture, devices[:n]), room, many) for n in range(1, DEVICES + 1)}
            calls["calibration"] = calibration, *fixed
            # Bind each call's own function and inputs.
            functions = {
                key: lambda call=call, inputs=inputs: jax.block_until_ready(call(*inputs))
                for key, (call, *inputs) in calls.items()
            }
            for function in functions.values():
                function()
            best = turns(functions, RUNS)
            rates = ", ".join(f"{1e3 * CAMERAS / best[str(n)]:.0f} on {n}" for n in range(1, DEVICES + 1))
            ratio = best["vmap"] / best["loop"]
            print(
                f"{name:10} {size} px: {BATCH} by vmap {best['vmap']:.1f} ms, by loop {best['loop']:.1f} ms, ratio"
                f" {ratio:.2f} ({'within' if ratio <= TARGET else 'above'} {TARGET}); pictures a second of a batch of"
                f" {CAMERAS}, by number of devices: {rates}; calibration {best['calibration']:.1f} ms"
            )


if __name__ == "__main__":
    main()
