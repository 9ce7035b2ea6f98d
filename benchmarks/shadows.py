"""Every cure of a shadow map against exact shadows: `python -m benchmarks.shadows [--width W] [--height H] [--runs N]`.

On the built-in stage under a sun, a spot and a lamp: the mean difference from exact shadows, over what is seen, in
thousandths; the share of pixels that are wrong by more than a tenth; and the fastest of several runs of the
shadow alone, in milliseconds, all taking turns. "Rays" are one any-hit ray per pixel, their tree included.
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np

import jaxraster as jr
from jaxraster.geometry.bvh import build_morton
from jaxraster.light.shadow_map import shadow_map
from jaxraster.surface.gather import gather
from jaxraster.surface.material import material

from .measure import turns

LIGHTS = {
    "directional": jr.stack_lights(directional=[((-0.78, -0.52, -0.50), (3, 3, 3))]),
    "spot": jr.stack_lights(spot=[((1.2, 1.6, 1.2), (-0.6, -0.8, -0.6), (9, 9, 9), np.inf, 0.3, 0.6)]),
    "point": jr.stack_lights(point=[((0.9, 1.2, 1.0), (6, 6, 6), np.inf)]),
}
BARE = {"filter": "single", "constant_bias": 0.0, "slope_bias": 0.0, "receiver_plane": 0.0}
CURES = {
    "no bias": BARE,
    "constant bias of 4 texels": {**BARE, "constant_bias": 4.0},
    "slope bias of 1 texel": {**BARE, "constant_bias": 0.5, "slope_bias": 1.0},
    "normal offset of 2 texels": {**BARE, "normal_offset": 2.0},
    "back faces alone": {**BARE, "casters": "back"},
    "front faces alone": {"casters": "front"},
    "receiver plane, one texel": {"filter": "single"},
    "receiver plane, 3 × 3": {},
    "5 × 5": {"width": 5},
    "moments, 3 × 3": {"filter": "moments"},
    "moments, 5 × 5": {"filter": "moments", "width": 5},
    "disc of 5, 16 taps": {"filter": "disc", "width": 5, "taps": 16},
    "256 texels": {"resolution": 256},
    "2048 texels": {"resolution": 2048},
    "2 cascades": {"cascades": 2},
    "4 cascades": {"cascades": 4},
    "penumbra, 16 taps": {"filter": "penumbra", "taps": 16, "radius": 0.02},
    "exact": {"filter": "exact"},
}
AHEAD = 1e-5  # metres off the surface on the light's side, and of the way to a lamp: rays begin and end there


def seen(scene: jr.Scene, camera: jr.Camera, width: int, height: int) -> jr.Surface:
    """The surface that every shadow below falls on."""

    def draw(scene, camera):
        size = {"width": width, "height": height}
        clip = jr.project(scene.mesh.vertices, camera, **size)
        visibility = jr.rasterize(clip, scene.mesh.faces, **size)
        return material(gather(scene, visibility, clip, camera), scene.materials, scene.textures, ())

    return jax.block_until_ready(jax.jit(draw)(scene, camera))


def cured(kind: str, settings: dict, inputs: tuple):
    """A call that makes the shadow of the one light, compiled and called once."""
    made = jr.ShadowMap(**settings)
    call = jax.jit(lambda *parts: shadow_map(*parts, settings=made)[kind][0])
    jax.block_until_ready(call(*inputs))
    return lambda: jax.block_until_ready(call(*inputs))


def rays(kind: str, surface: jr.Surface, mesh: jr.Mesh, lights: jr.Lights):
    """A call that asks a ray from each pixel to the one light, compiled and called once."""
    light = jax.tree.map(lambda leaf: leaf[0], getattr(lights, kind))

    @jax.jit
    def call(surface, mesh, light):
        if kind == "directional":
            towards = jnp.broadcast_to(-light.direction, surface.position.shape)
        else:
            towards = (1.0 - AHEAD) * (jnp.broadcast_to(light.position, surface.position.shape) - surface.position)
        end = jnp.where(surface.mask, jnp.inf if kind == "directional" else 1.0, -1.0)
        side = jnp.sign(jnp.sum(surface.geometric_normal * towards, axis=-1, keepdims=True))
        origin = surface.position + AHEAD * side * surface.geometric_normal
        return ~jr.occluded(
            jr.Rays(origin=origin, direction=towards, t_max=end), build_morton(mesh.vertices, mesh.faces)
        )

    jax.block_until_ready(call(surface, mesh, light))
    return lambda: jax.block_until_ready(call(surface, mesh, light))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.shadows", description=__doc__.splitlines()[0].split(":")[0]
    )
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=480)
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="the fastest of so many is quoted")
    options = parser.parse_args(arguments)
    scene, camera = jr.scenes.stage()
    surface = seen(scene, camera, options.width, options.height)
    print("| cure | " + " | ".join(f"{kind}: error, wrong, ms" for kind in LIGHTS) + " |\n|---|" + "---|" * len(LIGHTS))
    cells: dict[str, list[str]] = {name: [] for name in (*CURES, "rays")}
    for kind, lights in LIGHTS.items():
        calls = {name: cured(kind, settings, (surface, scene.mesh, lights, camera)) for name, settings in CURES.items()}
        calls["rays"] = rays(kind, surface, scene.mesh, lights)
        lit = {name: np.asarray(call())[np.asarray(surface.mask)] for name, call in calls.items()}
        best = turns(calls, options.runs)
        for name, share in lit.items():
            off = np.abs(share - lit["exact"])
            cells[name].append(f"{1e3 * off.mean():.1f}, {100 * (off > 0.1).mean():.1f} %, {best[name]:.0f}")
    for name, row in cells.items():
        print(f"| {name} | {' | '.join(row)} |")


if __name__ == "__main__":
    main()
