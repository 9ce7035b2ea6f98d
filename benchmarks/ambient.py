"""Light of an environment map: `python -m benchmarks.ambient [--size PX] [--runs N] [--samples N] [--map FILE]`.

What it costs: a picture made ready, and a sphere that fills a picture lit by it in several ways, in milliseconds,
taking turns. How exact it is: spheres of every metallic and roughness beside the same light drawn at random, from the
full picture and by the whole BRDF, without shadows. The root of the mean squared difference over the mean light, and
the difference of the means, in per cent; suns are cut out of the picture first, on both sides.
"""

import argparse
import functools
import pathlib
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import jaxraster as jr
from jaxraster.brdf.compensation import compensation
from jaxraster.brdf.fresnel import schlick
from jaxraster.brdf.sampling import reflection_weight, visible_normal
from jaxraster.brdf.standard import standard
from jaxraster.environment.equirect import lookup
from jaxraster.environment.prepare import prepare
from jaxraster.environment.sky import sky
from jaxraster.environment.sun import cut_suns
from jaxraster.io.radiance import read_hdr
from jaxraster.light.ambient import Ambient, ambient
from jaxraster.math import safe
from jaxraster.math.hash import keyed
from jaxraster.math.sampling import cosine_hemisphere
from jaxraster.math.sobol import sobol
from jaxraster.math.transform import frame
from jaxraster.surface.material import metallic_roughness

from .measure import turns

ROUGHNESS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
METALLIC = (0.0, 0.5, 1.0)
COLOR = (0.9, 0.6, 0.3)
ACROSS = 18  # points across a sphere whose light is compared


def sphere(size: int, metallic: float, roughness: float) -> jr.Surface:
    """The points of a sphere seen from +Z from afar; those beside it count as its rim, and are masked."""
    at = jnp.linspace(-1.0, 1.0, 2 * size + 1)[1::2]
    x, y = jnp.meshgrid(at, -at)
    radius = jnp.sqrt(x * x + y * y)
    scale = jnp.minimum(1.0, 0.999 / radius)
    x, y = x * scale, y * scale
    n = jnp.stack([x, y, jnp.sqrt(1.0 - x * x - y * y)], axis=-1)
    one = jnp.ones_like(x)
    color = jnp.broadcast_to(jnp.array(COLOR), n.shape)
    diffuse, f0, alpha, *_ = metallic_roughness(color, metallic * one, roughness * one)
    return jr.Surface(
        mask=radius < 1.0, position=n, normal=n, geometric_normal=n, view=jnp.zeros_like(n).at[..., 2].set(1.0),
        uv=n[..., :2], diffuse_color=diffuse, f0=f0, f90=one, alpha=alpha, emissive=0.0 * n, occlusion=one,
    )  # fmt: skip


@functools.partial(jax.jit, static_argnames="samples")
def drawn(surface: jr.Surface, texels: jax.Array, samples: int) -> jax.Array:
    """The light of every point, the mean of as many directions of each kind: of the cosine, and of what is mirrored."""
    n, v, one = surface.normal, surface.view, jnp.ones_like(surface.alpha)
    right, up = frame(n)
    axes = right, up, n
    local = jnp.stack([safe.dot(v, axis) for axis in axes], axis=-1)
    alpha = jnp.stack([surface.alpha] * 2, axis=-1)
    pixel = jnp.arange(surface.alpha.size, dtype=jnp.uint32).reshape(surface.alpha.shape)
    factor = compensation(surface.f0, local[..., 2], surface.alpha)

    def add(total, index):
        u, w = (sobol(index, keyed(pixel, kind)) for kind in (0, 1))
        aside, density = cosine_hemisphere(u)
        l = sum(aside[..., i, None] * axis for i, axis in enumerate(axes))
        diffuse = standard(surface, l)[0] / density[..., None] * lookup(texels, l)
        h, _ = visible_normal(w, local, alpha)
        v_dot_h = safe.dot(local, h)
        bounced = 2.0 * v_dot_h[..., None] * h - local
        weight = (
            schlick(surface.f0, v_dot_h, surface.f90) * factor * reflection_weight(local, bounced, alpha)[..., None]
        )
        l = sum(bounced[..., i, None] * axis for i, axis in enumerate(axes))
        return total + diffuse + weight * lookup(texels, l), None

    return lax.scan(add, 0.0 * n * one[..., None], jnp.arange(samples, dtype=jnp.uint32))[0] / samples


def ways(texels: jax.Array) -> dict[str, tuple[jr.Environment, Ambient]]:
    """How surfaces may be lit by a picture of all directions, or by what stands for it."""
    dark = jnp.zeros(3)
    full = jr.Environment(up=jnp.array([0.0, 1.0, 0.0]), sky=dark, ground=dark, map=prepare(texels))
    mean = full.map.harmonics[0] * 0.5 / np.sqrt(np.pi)
    return {
        "one tone, the mean": (replace(full, sky=mean, ground=mean, map=None), Ambient()),
        "harmonics alone": (full, Ambient(specular=False)),
        "map of irradiance alone": (full, Ambient(diffuse="map", specular=False)),
        "harmonics and mirrored picture, the default": (full, Ambient()),
        "map of irradiance and mirrored picture": (full, Ambient(diffuse="map")),
    }


def shade(surface: jr.Surface, environment: jr.Environment, settings: Ambient) -> jax.Array:
    """Ambient light of every point."""
    return jnp.add(*ambient(surface, environment, settings))


def errors(texels: jax.Array, samples: int) -> dict[str, dict[tuple[float, float], tuple[float, float]]]:
    """Of each way, by metallic and roughness: the root mean square, and the difference of the means."""
    found = {name: {} for name in ways(texels)}
    lit = jax.jit(shade)
    for metallic in METALLIC:
        for roughness in ROUGHNESS:
            surface = sphere(ACROSS, metallic, roughness)
            mask = np.asarray(surface.mask)
            truth = np.asarray(drawn(surface, texels, samples), np.float64)[mask]
            for name, way in ways(texels).items():
                off = np.asarray(lit(surface, *way), np.float64)[mask] - truth
                found[name][metallic, roughness] = np.sqrt((off**2).mean()) / truth.mean(), off.mean() / truth.mean()
    return found


def costs(texels: jax.Array, size: int, runs: int) -> dict[str, float]:
    """Milliseconds of each way, and of making the picture ready."""
    surface, lit = sphere(size, 0.5, 0.3), jax.jit(shade)
    calls = {"prepare": lambda: jax.block_until_ready(prepare(texels))}
    calls |= {
        name: functools.partial(lambda *way: jax.block_until_ready(lit(surface, *way)), *way)
        for name, way in ways(texels).items()
    }
    for call in calls.values():
        call()
    return turns(calls, runs)


def rms(found: dict, metallic: float) -> float:
    """Over all roughnesses, in per cent."""
    return 100 * np.sqrt(np.mean([found[metallic, roughness][0] ** 2 for roughness in ROUGHNESS]))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ambient", description=__doc__.splitlines()[0].split(":")[0]
    )
    parser.add_argument("--size", type=int, default=512, metavar="PX", help="a side of the sphere's picture")
    parser.add_argument("--height", type=int, default=512, metavar="PX", help="lines of the sky's picture")
    parser.add_argument("--runs", type=int, default=7, metavar="N", help="the fastest of so many is quoted")
    parser.add_argument("--samples", type=int, default=1024, metavar="N", help="random directions of each kind")
    parser.add_argument(
        "--map", type=pathlib.Path, metavar="FILE", help="a picture of all directions (.hdr) in place of the clear sky"
    )
    options = parser.parse_args(arguments)
    size = {"height": options.height, "width": 2 * options.height}
    texels = jnp.asarray(cut_suns(read_hdr(options.map))[0]) if options.map else sky((1.0, 1.0, 0.5), **size)[0]
    found, best = errors(texels, options.samples), costs(texels, options.size, options.runs)
    height, width, _ = texels.shape
    print(f"{width} x {height} texels made ready in {best['prepare']:.0f} ms\n")
    print("| setting | ms | plastic: error, % | metal: error, % | means, % |\n|---|--:|--:|--:|--:|")
    for name, of in found.items():
        means = 100 * max(abs(bias) for _, bias in of.values())
        print(f"| {name} | {best[name]:.1f} | {rms(of, 0.0):.1f} | {rms(of, 1.0):.1f} | {means:.1f} |")
    print("\n| metallic | " + " | ".join(f"r = {r:g}" for r in ROUGHNESS) + " |\n|---|" + "--:|" * len(ROUGHNESS))
    for metallic in METALLIC:
        cells = (found["harmonics and mirrored picture, the default"][metallic, r] for r in ROUGHNESS)
        print(f"| {metallic:g} | " + " | ".join(f"{100 * off:.1f} ({100 * bias:+.1f})" for off, bias in cells) + " |")


if __name__ == "__main__":
    main()
