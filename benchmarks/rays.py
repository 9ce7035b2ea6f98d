"""Rays a second beside other programs: `python -m benchmarks.rays [--rays N] [--runs N]`.

Closest hits of the Cornell box and of a sphere of 81,920 faces, for coherent rays (a picture's, in its order) and
incoherent ones (from anywhere on the surface, into the scene, to anywhere), in millions of rays a second. All programs
have their rays and their tree before the clock starts, take turns, and the fastest turn is quoted, with its ratio to
Mitsuba's. A row of any hits follows each. What else can be installed: pip install embreex mitsuba, and an LLVM.

`ours, 2 devices` gives each of two host devices half of the rays: a loop runs on one core, so that two of them use
both. The scene is copied to each, and nothing is exchanged.
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

import jaxraster as jr
from jaxraster.geometry import shapes

from . import memory
from .measure import turns
from .peers import reason

DEVICES = 2


def scenes() -> dict[str, tuple[jr.Camera, jax.Array, jax.Array]]:
    """Camera, vertices and faces by name."""
    box, camera = jr.scenes.cornell_box()
    sphere = shapes.icosphere(1.0, 6)
    pose = jr.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0))
    across = jr.Camera(world_from_view=pose, clip_from_view=jr.perspective(0.7, near=0.1))
    return {
        "Cornell box": (camera, box.mesh.vertices, box.mesh.faces),
        "sphere of 81,920": (across, sphere.vertices, sphere.faces),
    }


def coherent(camera: jr.Camera, vertices, faces, count: int) -> jr.Rays:
    """A square picture's rays, row by row."""
    size = int(count**0.5)
    centre = ((np.arange(count) % size + 0.5) * 2 / size - 1, 1 - (np.arange(count) // size + 0.5) * 2 / size)
    lens, pose = np.asarray(camera.clip_from_view), np.asarray(camera.world_from_view)
    view = np.stack([centre[0] / lens[0, 0], centre[1] / lens[1, 1], -np.ones(count)], axis=-1)
    return _rays(np.broadcast_to(pose[:3, 3], view.shape), view @ pose[:3, :3].T)


def incoherent(camera: jr.Camera, vertices, faces, count: int) -> jr.Rays:
    """From points of random triangles, drawn a hundredth towards the middle, into all directions."""
    rng, vertices = np.random.default_rng(0), np.asarray(vertices)
    corners = vertices[np.asarray(faces)[rng.integers(0, len(faces), count)]]
    origin = (corners * rng.dirichlet([1, 1, 1], count)[..., None]).sum(axis=1)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    return _rays(middle + 0.99 * (origin - middle), rng.normal(size=(count, 3)))


def _rays(origin, direction) -> jr.Rays:
    return jr.Rays(origin=jnp.asarray(origin, jnp.float32), direction=jnp.asarray(direction, jnp.float32))


def ours(rays, tree, vertices, faces, any_hit: bool, devices: int = 1, backend: str = "jax"):
    """A call that traces, on so many devices; what it returns has the faces, or what is occluded."""
    function = jr.occluded if any_hit else jr.trace
    mesh = Mesh(np.array(jax.devices()[:devices]), ("ray",))
    share, whole = PartitionSpec("ray"), PartitionSpec()
    where = {"mesh": mesh, "in_specs": (share, share, whole), "out_specs": share, "check_vma": False}
    call = jax.jit(jax.shard_map(lambda o, d, t: function(jr.Rays(origin=o, direction=d), t, backend=backend), **where))
    shared, copied = (NamedSharding(mesh, spec) for spec in (share, whole))
    inputs = *jax.device_put((rays.origin, rays.direction), shared), jax.device_put(tree, copied)

    def run():
        return jax.block_until_ready(call(*inputs))

    return run, lambda found: np.asarray(found) if any_hit else np.asarray(found.face)


def embree(rays, tree, vertices, faces, any_hit: bool):
    """The backend "embree", whatever the number of triangles: its call back into Python included."""
    from jaxraster.visibility.trace_embree import trace_embree

    limits = jnp.zeros(len(rays.origin)), jnp.full(len(rays.origin), jnp.inf)
    call = jax.jit(lambda *inputs: trace_embree(*inputs, any_hit))
    inputs = tree.corners, rays.origin, rays.direction, *limits
    return lambda: jax.block_until_ready(call(*inputs)), lambda hits: np.asarray(hits[0])


def mitsuba(rays, tree, vertices, faces, any_hit: bool):
    """Mitsuba 3 with LLVM, which traces with Embree on all cores."""
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    import drjit

    mesh = mitsuba.Mesh("mesh", vertex_count=len(vertices), face_count=len(faces))
    arrays = mitsuba.traverse(mesh)
    arrays["vertex_positions"] = mitsuba.Float(np.asarray(vertices).ravel())
    arrays["faces"] = mitsuba.UInt32(np.asarray(faces).ravel().astype(np.uint32))
    arrays.update()
    scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})
    columns = [
        [mitsuba.Float(np.ascontiguousarray(v[:, k])) for k in range(3)]
        for v in map(np.asarray, (rays.origin, rays.direction))
    ]
    bundle = mitsuba.Ray3f(mitsuba.Point3f(*columns[0]), mitsuba.Vector3f(*columns[1]))
    drjit.eval(bundle)

    def run():
        found = scene.ray_test(bundle) if any_hit else scene.ray_intersect_preliminary(bundle, coherent=False)
        drjit.eval(found)
        drjit.sync_thread()
        return found

    def faces_of(found):
        return (
            np.array(found) if any_hit else np.where(found.is_valid(), np.array(found.prim_index).astype(np.int32), -1)
        )

    return run, faces_of


def programs() -> dict:
    """Who traces, by name: functions of (rays, tree, vertices, faces, any_hit)."""
    return {
        "ours": ours,
        f"ours, {DEVICES} devices": lambda *inputs: ours(*inputs, devices=DEVICES),
        "embreex": embree,
        "Mitsuba": mitsuba,
    }


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.rays", description=__doc__.splitlines()[0].split(":")[0]
    )
    parser.add_argument("--rays", type=int, default=2**18, metavar="N", help="a square of an even number")
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="the fastest of so many is quoted")
    options = parser.parse_args(arguments)
    memory.keep()
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_num_cpu_devices", DEVICES)
    names = list(programs())
    print(f"| scene | rays | hits | {' | '.join(names)} | differ |\n|---|---|---|{'--:|' * (len(names) + 1)}")
    absent = {}
    for scene, (camera, vertices, faces) in scenes().items():
        tree = jr.build(vertices, faces)
        for kind, make in {"coherent": coherent, "incoherent": incoherent}.items():
            rays = make(camera, vertices, faces, options.rays)
            for any_hit in (False, True):
                ready = {}
                for name, program in programs().items():
                    try:
                        ready[name] = program(rays, tree, vertices, faces, any_hit)
                    except Exception as error:
                        absent[name] = reason(error)
                found = {name: read(run()) for name, (run, read) in ready.items()}
                best = turns({name: run for name, (run, _) in ready.items()}, options.runs)
                rate = {name: 1e-3 * options.rays / time for name, time in best.items()}
                over = rate.get("Mitsuba")
                cells = [
                    "–" if name not in rate else f"{rate[name]:.2f}" + (f" ({rate[name] / over:.2f})" if over else "")
                    for name in names
                ]
                mine = found["ours"] if any_hit else found["ours"] >= 0
                others = [f if f.dtype == bool else f >= 0 for f in found.values()]
                differ = max(float(np.mean(mine != other)) for other in others)
                hits = "any" if any_hit else "closest"
                print(f"| {scene} | {kind} | {hits} | {' | '.join(cells)} | {100 * differ:.3f} % |", flush=True)
    for name, text in absent.items():
        print(f"{name}: absent: {text}")


if __name__ == "__main__":
    main()
