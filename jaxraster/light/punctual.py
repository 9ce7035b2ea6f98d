"""Directional, point and spot lights in glTF's units.

A light is seen from a surface as a unit direction l and an irradiance at normal incidence: lux for directional ones,
candela · window(d) · cone / d² for the others. Linear Rec.709; radiance comes out in cd/m².

window(d) = 1 - min(d/range, 1)⁴; cone = clamp((cos θ - cos outer) / (cos inner - cos outer), 0, 1)².

Gradient: exact in lights, surface and shares; 0 outside range and cone, where the light sits on the surface, and in a
range that is infinite.
Source: KHR_lights_punctual.
"""

import functools
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from ..scene import Directional, Lights, Point, Spot

# The specification leaves a cone with inner = outer to the reader; a thousandth keeps the edge's slope bounded.
MIN_CONE = 1e-3
# Within ten nanometres a light sits on the surface: the 1/d⁴ of the derivative would overflow.
MIN_SQUARE = 1e-16

Arriving = tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]


def directional(surface: Surface, light: Directional) -> Arriving:
    """(l, irradiance) of one light, without leading count."""
    shape = surface.position.shape
    return jnp.broadcast_to(-safe.normalize(light.direction), shape), jnp.broadcast_to(light.irradiance, shape)


def point(surface: Surface, light: Point | Spot) -> Arriving:
    """(l, irradiance) of one light, without leading count."""
    away = jnp.broadcast_to(light.position, surface.position.shape) - surface.position
    l = safe.unit(away)
    square = safe.dot(away, away)
    square = jnp.where(square > MIN_SQUARE, square, 0.0)
    # Divide twice: the derivative of 1/range² at infinity would be 0 · inf. A range of 0 reaches nothing.
    reach = jnp.broadcast_to(light.range, square.shape)
    window = 1.0 - jnp.minimum(safe.divide(safe.divide(square, reach, 1.0), reach, 1.0), 1.0) ** 2
    falloff = safe.divide(window, square)[..., None]
    return l, falloff * jnp.broadcast_to(light.intensity, surface.position.shape)


def spot(surface: Surface, light: Spot) -> Arriving:
    """(l, irradiance) of one light, without leading count."""
    l, irradiance = point(surface, light)
    outer = jnp.cos(light.outer)
    width = jnp.maximum(jnp.cos(light.inner) - outer, MIN_CONE)
    cosine = -safe.dot(l, jnp.broadcast_to(safe.normalize(light.direction), l.shape))
    cone = jnp.clip((cosine - outer) / width, 0.0, 1.0)
    return l, irradiance * (cone * cone)[..., None]


KINDS = {"directional": directional, "point": point, "spot": spot}


@functools.partial(jax.jit, static_argnames=("kinds", "brdf"))
def punctual(
    surface: Surface,
    lights: Lights,
    kinds: tuple[str, ...],
    brdf: Callable[[Surface, Float[Array, "*b 3"]], tuple],
    shares: Mapping[str, Float[Array, "n *b"]] | None = None,
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular radiance from all lights of the given kinds, summed one light at a time.

    `shares` of a kind say how much of each of its n lights arrives at every pixel; of the others all does.
    """
    total = (jnp.zeros_like(surface.position), jnp.zeros_like(surface.position))
    for kind in kinds:

        def add(total, one, arrive=KINDS[kind]):
            light, share = one
            l, irradiance = arrive(surface, light)
            irradiance = irradiance if share is None else irradiance * share[..., None]
            diffuse, specular = brdf(surface, l)
            return (total[0] + diffuse * irradiance, total[1] + specular * irradiance), None

        with jax.named_scope(kind):
            total, _ = lax.scan(add, total, (getattr(lights, kind), (shares or {}).get(kind)))
    return total
