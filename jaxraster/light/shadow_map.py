"""Shadow maps: what the light sees, drawn once, and every pixel compared with it.

One map of the whole scene or several cascades of what is in view for a directional light, one for a spot, six for a
point. What lies outside of a map is lit. `shadow_frame` has the projections, `shadow_bias` what keeps a surface from
shadowing itself, `shadow_filter`, `shadow_penumbra` and `shadow_moments` what is made of the texels about a place,
`shadow_cascades` the cascades, and `shadow_exact` asks the triangles themselves instead of a map.
World units; 1 is lit, exactly so on any plane that nothing is above, up to 89.9° of incidence at the default biases (by
moments to 0.001), which let in light at the foot of a wall for half a texel (measured by the tests). Does not affect:
ambient light, emission, lights without a map.

Gradient: none but by the filter "moments", on purpose: occlusion is a depth test, whose derivative is 0 almost
everywhere, and the width of the filter's ramp belongs to the map's texels, not to the scene.
Source: Williams 1978, "Casting curved shadows on curved surfaces".
"""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ..buffers import Surface
from ..math import safe
from ..math.table import kept
from ..record import Scalar, record, static
from ..scene import Camera, Lights, Mesh
from ..visibility.raster import rasterize_depth
from .shadow_bias import base_bias, offset_along_normal, plane_bias
from .shadow_exact import exact, leave, tiles
from .shadow_filter import box, disc, lookup, lookup_line, single
from .shadow_frame import LightView, Receiver, inside, light_clip, receiver
from .shadow_moments import moments, texels
from .shadow_penumbra import penumbra
from .shadow_views import VIEWS

FILTERS = "single", "box", "disc", "penumbra", "moments", "exact"
CASTERS = "all", "front", "back"
MOST_TAPS = 1024  # a program of as many fetches; more hardly differ, and take minutes to compile


@record
class ShadowMap:
    """`resolution` is a map's side in texels; each of a point light's six maps has half of it.

    `directional`, `point` and `spot` are the rows of those lights that throw shadows, None for all of them.
    `filter` is "single" (one texel), "box" (`width` texels on a side), "disc" (`taps` of them over a disc `width`
    texels wide), "penumbra" (as wide as the light is large: twice `taps`), "moments" (a box, with a gradient) or
    "exact" (hard, without a map: neither `resolution` nor `casters` nor a bias matters).
    `casters` draws "all" faces into the map, or those alone that face towards the light ("front", the same picture in
    half the time where meshes are closed) or away from it ("back"). `cascades` is how many maps share what is in view
    of a directional light, 0 for one map of the whole scene; `split` lies between 0, cascades of even depths, and 1, of
    even ratios of them.

    Biases are in texels: constant, per texel of slope, per unit of the receiver's own plane, and along the normal.
    `angle` is the tangent of a directional light's angular radius, the sun's, and `radius` a lamp's, in metres.
    """

    resolution: int = static(default=1024)
    directional: tuple | None = static(default=None)
    point: tuple | None = static(default=None)
    spot: tuple | None = static(default=None)
    filter: str = static(default="box")
    width: int = static(default=3)
    taps: int = static(default=64)
    casters: str = static(default="all")
    cascades: int = static(default=0)
    split: Scalar = 0.5
    constant_bias: Scalar = 0.25
    slope_bias: Scalar = 0.0078125
    receiver_plane: Scalar = 1.0
    normal_offset: Scalar = 0.0
    angle: Scalar = 0.00465
    radius: Scalar = 0.05

    @property
    def margin(self) -> int:
        """Texels around a map that only filters reach, which taps must not leave."""
        box = (self.width + 2) // 2
        reach = {"single": 1, "box": box, "moments": box, "disc": (self.width + 3) // 2, "exact": 0}
        return reach.get(self.filter, 2 + self.resolution // 32)

    def validate(self):
        """Raise one clear line for a map without texels, a name that means nothing, or lights that cannot be."""
        for name, known in (("filter", FILTERS), ("casters", CASTERS)):
            if getattr(self, name) not in known:
                raise ValueError(f"ShadowMap.{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        for name, least, most in (("width", 1, 64), ("taps", 1, MOST_TAPS), ("cascades", 0, 16)):
            value = getattr(self, name)
            if type(value) is not int or not least <= value <= most:
                raise ValueError(f"ShadowMap.{name} must be a whole number from {least} to {most}, got {value!r}")
        least = 4 * self.margin
        if type(self.resolution) is not int or self.resolution <= least:
            raise ValueError(
                f"ShadowMap.resolution must be a whole number above {least} for this filter, got {self.resolution!r}"
            )
        for kind in VIEWS:
            rows = getattr(self, kind)
            if rows is None:
                continue
            if not isinstance(rows, tuple) or any(type(row) is not int or row < 0 for row in rows):
                raise ValueError(f"ShadowMap.{kind} must be None or a tuple of rows of lights, got {rows!r}")
            if len({*rows}) < len(rows):
                raise ValueError(f"ShadowMap.{kind} must name each light once, got {rows}")


def _rows(settings: ShadowMap, kind: str, count: int) -> tuple[int, ...]:
    """Which lights of a kind, of which there are `count`, have a map."""
    rows = getattr(settings, kind)
    rows = tuple(range(count)) if rows is None else rows
    if count == 0:
        return ()
    if any(row >= count for row in rows):
        raise ValueError(f"ShadowMap.{kind} names light {max(rows)}, but the scene has {count} of that kind, from 0")
    return rows


def _kept(mesh: Mesh, view: LightView, casters: str) -> Int[Array, "f 3"]:
    """The faces of one side, the others drawn in to a point."""
    if casters == "all":
        return mesh.faces
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    towards = jnp.broadcast_to(view.axes[2], a.shape)
    if view.central:
        towards = jnp.broadcast_to(view.origin, a.shape) - a
    # Make a unit of each: products of four lengths would leave float32.
    facing = safe.dot(jnp.cross(safe.normalize(b - a), safe.normalize(c - a)), safe.normalize(towards))
    kept = facing > 0 if casters == "front" else facing < 0
    return jnp.where(kept[:, None], mesh.faces, mesh.faces[:, :1])


def _drawn(view: LightView, mesh: Mesh, settings: ShadowMap):
    """The map of one view: depths, and of moments variances."""
    faces = _kept(mesh, view, settings.casters)
    if settings.filter == "moments":
        return texels(view, mesh.vertices, faces)
    occluders = rasterize_depth(light_clip(view, mesh.vertices), faces, height=view.size, width=view.size)
    return occluders.astype(mesh.vertices.dtype)


def _filtered(view: LightView, drawn, place: Receiver, settings: ShadowMap) -> Float[Array, "*b"]:
    """The share of a map's texels about each place that leave it lit."""
    bias = base_bias(place, settings.constant_bias, settings.slope_bias)
    if settings.filter == "moments":
        return moments(place, drawn, bias, settings.width)
    occluders = drawn.reshape(-1)

    def threshold(column, line):
        rise = plane_bias(place, column + 0.5, line + 0.5, settings.receiver_plane)
        # Depth 0 means nothing, also to a receiver below all that the map was fitted to.
        return jnp.maximum(place.depth + bias + rise, 0.0)

    def depth(column, line):
        return lookup(occluders, view.size, column, line)

    def test(column, line):
        return jnp.where(depth(column, line) > threshold(column, line), 0.0, 1.0)

    def tests(column, line, count):
        found = lookup_line(occluders, view.size, column, line, count)
        return [jnp.where(one > threshold(column + i, line), 0.0, 1.0) for i, one in enumerate(found)]

    if settings.filter == "single":
        return single(place.x, place.y, test)
    if settings.filter == "box":
        return box(place.x, place.y, tests, settings.width)
    if settings.filter == "disc":
        return disc(place.x, place.y, test, 0.5 * settings.width, 0.5 * settings.width, settings.taps)
    size = settings.radius / view.depth[0] if view.central else settings.angle * view.depth[1]
    return penumbra(place, view, jnp.max(occluders), depth, threshold, size, settings.taps)


def _lit(view: LightView, weight: Array, surface: Surface, mesh: Mesh, settings: ShadowMap) -> Float[Array, "*b"]:
    """The share of the light that pixels see in one view, 1 outside of it."""
    if settings.filter == "exact":
        place = receiver(view, leave(surface, view, mesh), surface.geometric_normal)
        return exact(view, place, surface.mask & (weight * inside(view, place) > 0), mesh)
    drawn, normal = _drawn(view, mesh, settings), surface.geometric_normal
    place = receiver(view, offset_along_normal(view, surface.position, normal, settings.normal_offset), normal)
    return 1.0 - inside(view, place) * (1.0 - _filtered(view, drawn, place, settings))


def _share(kind, light, surface, mesh, camera, settings):
    """How much of one light each pixel sees."""
    views, weights = VIEWS[kind](light, surface, mesh, camera, settings)

    def subtract(share, one):
        view, weight = one
        return share - weight * (1.0 - _lit(view, weight, surface, mesh, settings)), None

    share, _ = lax.scan(subtract, jnp.ones_like(surface.alpha), (views, weights))
    return kept(jnp.clip(share, 0.0, 1.0), surface.mask)


@functools.partial(jax.jit, static_argnames="kind")
def _shares(kind, lights, surface, mesh, camera, settings):
    """The same for each of several lights of a kind."""
    if settings.filter == "exact":
        # Tiles in place of texels, and laid about what is seen.
        resolution = tiles(mesh.faces.shape[0]) * (2 if kind == "point" else 1)
        settings = replace(settings, resolution=resolution, cascades=max(1, settings.cascades))
    # One light after the other: side by side they would need the memory of several pictures each.
    return lax.map(lambda light: _share(kind, light, surface, mesh, camera, settings), lights)


def shadow_map(
    surface: Surface, mesh: Mesh, lights: Lights, camera: Camera, settings: ShadowMap
) -> dict[str, Float[Array, "n *b"]]:
    """The share in [0, 1] of each light that reaches every pixel, for all kinds of which a light has a map."""
    # Which lights have a map shall not key the compilation of how they are drawn.
    any_light = replace(settings, directional=None, point=None, spot=None)
    hold = (lambda leaf: leaf) if settings.filter == "moments" else lax.stop_gradient
    lights, *inputs = jax.tree.map(hold, (lights, surface, mesh, camera, any_light))
    shares = {}
    for kind in VIEWS:
        every = getattr(lights, kind)
        count = jax.tree.leaves(every)[0].shape[0]
        rows = _rows(settings, kind, count)
        if not rows or mesh.faces.shape[0] == 0:
            continue
        some = jnp.array(rows)
        lit = _shares(kind, jax.tree.map(lambda leaf, some=some: leaf[some], every), *inputs)
        shares[kind] = jnp.ones((count, *lit.shape[1:]), lit.dtype).at[some].set(lit)
    return shares
