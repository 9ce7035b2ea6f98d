"""Lights with an area: spheres, discs and rectangles, without shadows.

Diffuse: E = π L times the light's form factor, which is the integral of the cosine over what of it is above the
horizon, exact for all three; what the BRDF makes of E is taken in the middle of what is above. Specular: `area_lobe`
bends GGX into a cosine, and the bent light's form factor is its share of the lobe; its error: `docs/guide/lights.md`.
Radiance in cd/m². Does not affect: what the camera sees of the lights themselves, which are not drawn.

Gradient: exact of these formulas, in lights, surface and gain; one-sided in a light's own plane, 0 in a sphere's middle
and on the side to which a light does not shine.
Source: Heitz, Dupuy, Hill & Neubelt 2016, "Real-Time Polygonal-Light Shading with Linearly Transformed Cosines".
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from ..math.transform import frame
from ..record import Scalar, record, static
from ..scene import AREA_KINDS, Disc, Lights, Rectangle, Sphere
from .area_cone import cut, ellipse_factor, sphere_factor
from .area_disc import disc_factor
from .area_lobe import Lobe, bend, reflection
from .area_polygon import clip, edges, form_factor

Color = Float[Array, "*b 3"]
Number = Float[Array, "*b"]
Factors = tuple[Color, Number, Number]
# The lobe sees a sphere as the disc that its outline encloses; from the sphere itself on, that would be infinite.
MIN_COSINE = 1e-3


@record
class Area:
    """`kinds` of lights that are evaluated; `gain` multiplies their radiance."""

    kinds: tuple = static(default=AREA_KINDS)
    gain: Scalar = 1.0

    def validate(self):
        """Raise one clear line for a kind that is none."""
        if not isinstance(self.kinds, tuple) or set(self.kinds) - set(AREA_KINDS):
            raise ValueError(f"Area.kinds must be a tuple of {', '.join(AREA_KINDS)}, got {self.kinds!r}")


def _shining(towards, direction, two_sided, diffuse: Number, specular: Number) -> tuple[Number, Number]:
    """The factors where a flat light that is `towards` there shines, and 0 elsewhere."""
    side = safe.dot(towards, direction)
    shines = (side < 0) | (two_sided & (side > 0))
    return jnp.where(shines, diffuse, 0.0), jnp.where(shines, specular, 0.0)


def _round(surface: Surface, lobe: Lobe, center: Color, right: Color, up: Color) -> tuple[Color, Number]:
    """The middle of what is above the horizon of a round light, and its form factor as the lobe sees it."""
    middle, right, up = cut(center, right, up, surface.normal)
    bent = bend(lobe, surface.normal, jnp.stack([middle, right, up]))
    return middle, ellipse_factor(bent[0], bent[1], bent[2], lobe.mirror)


def sphere(surface: Surface, lobe: Lobe, light: Sphere) -> Factors:
    """(towards its middle, form factor, form factor as the lobe sees it) of one light."""
    towards, radius2 = light.position - surface.position, light.radius * light.radius
    l, square = safe.unit(towards), safe.dot(towards, towards)
    # Inside of it, light comes as it does on the surface.
    outside = square > radius2
    square_sine = jnp.where(outside, safe.divide(radius2, square), jnp.where(radius2 > 0, 1.0, 0.0))
    cosine = safe.sqrt(jnp.maximum(1.0 - square_sine, MIN_COSINE**2))[..., None]
    sine, (right, up) = safe.sqrt(square_sine)[..., None], frame(l)
    middle, specular = _round(surface, lobe, cosine * l, sine * right, sine * up)
    return middle, sphere_factor(square_sine, jnp.clip(safe.dot(l, surface.normal), -1.0, 1.0)), specular


def disc(surface: Surface, lobe: Lobe, light: Disc) -> Factors:
    """(towards its middle, form factor, form factor as the lobe sees it) of one light."""
    towards, direction = light.position - surface.position, safe.normalize(light.direction)
    diffuse = disc_factor(towards, direction, light.radius, surface.normal)
    size, (right, up) = light.radius[..., None], frame(direction)
    middle, specular = _round(surface, lobe, towards, size * right, size * up)
    diffuse, specular = _shining(towards, direction, light.two_sided, diffuse, specular)
    return middle, diffuse, specular


def rectangle(surface: Surface, lobe: Lobe, light: Rectangle) -> Factors:
    """(towards its middle, form factor, form factor as the lobe sees it) of one light."""
    n, towards, direction = surface.normal, light.position - surface.position, jnp.cross(light.right, light.up)
    # Go around it counter-clockwise as seen, from either side.
    right, up = light.right, jnp.where((safe.dot(towards, direction) > 0)[..., None], light.up, -light.up)
    corners = [towards + i * right + j * up for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    above = clip(edges(jnp.stack(corners)), n)
    bent = clip((bend(lobe, n, above[0]), bend(lobe, n, above[1])), lobe.mirror)
    diffuse, specular = _shining(
        towards, direction, light.two_sided, form_factor(above, n), form_factor(bent, lobe.mirror)
    )
    # Half way up to its top where its middle is below that.
    reach = jnp.abs(safe.dot(right, n)) + jnp.abs(safe.dot(up, n))
    middle = towards + (0.5 * jnp.maximum(reach - safe.dot(towards, n), 0.0))[..., None] * n
    return middle, diffuse, specular


KINDS = {"sphere": sphere, "disc": disc, "rectangle": rectangle}


@functools.partial(jax.jit, static_argnames=("kinds", "brdf", "albedo"))
def _sum(surface, lights, gain, kinds, brdf, albedo):
    n, lobe = surface.normal, reflection(surface)
    cosine = jnp.clip(safe.dot(n, surface.view), 0.0, 1.0)
    mirrored = lobe.gain[..., None] * albedo(surface.f0, cosine, surface.alpha, surface.f90)
    total = (jnp.zeros_like(surface.position), jnp.zeros_like(surface.position))
    for kind in kinds:

        def add(total, light, factors=KINDS[kind]):
            light = jax.tree.map(lambda x: jnp.broadcast_to(x, (*surface.alpha.shape, *x.shape)), light)
            middle, diffuse, specular = factors(surface, lobe, light)
            l = safe.unit(middle)
            reflected = brdf(surface, l)[0] * safe.divide(jnp.pi * diffuse, safe.dot(n, l))[..., None]
            radiance = gain * light.radiance
            return (total[0] + reflected * radiance, total[1] + mirrored * specular[..., None] * radiance), None

        with jax.named_scope(kind):
            total, _ = lax.scan(add, total, getattr(lights, kind))
    return total


def area(
    surface: Surface,
    lights: Lights,
    brdf: Callable[[Surface, Color], tuple[Color, Color]],
    albedo: Callable[..., Color],
    settings: Area,
) -> tuple[Color, Color]:
    """Diffuse and specular radiance from all lights of the given kinds, summed one light at a time.

    `brdf` says what becomes of diffuse light, and `albedo`, of f0, n·v, alpha and f90, how much its specular part, a
    GGX lobe, returns of uniform light.
    """
    kinds = tuple(kind for kind in settings.kinds if getattr(lights, kind) is not None)
    if not kinds:
        return jnp.zeros_like(surface.position), jnp.zeros_like(surface.position)
    return _sum(surface, lights, settings.gain, kinds, brdf, albedo)
