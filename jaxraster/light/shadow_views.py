"""The maps of a light: one or more views, and how much each of them counts at every pixel.

A directional light has one of the whole scene, or cascades of what is in view; a spot has one of its cone; a point has
the six sides of a cube. Maps are fitted to the vertices of faces, as far as these are finite.
Gradient: of these formulas; `shadow_map` stops it.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..math import safe
from ..scene import Mesh
from .shadow_cascades import cascades
from .shadow_frame import NARROW, SIDES, WIDE, axes_towards, central_view, parallel_view, rotate


def _in_use(mesh: Mesh) -> tuple[Float[Array, "v 3"], Bool[Array, "v 1"]]:
    """Vertices, 0 for those that are not finite, and which of the others belong to a face: what a map is fitted to."""
    used = jnp.zeros(mesh.vertices.shape[0], bool).at[mesh.faces].set(True)
    finite = jnp.all(jnp.isfinite(mesh.vertices), axis=-1, keepdims=True)
    return jnp.where(finite, mesh.vertices, 0.0), used[:, None] & finite


def _bounds(points: Float[Array, "n 3"], among: Bool[Array, "n 1"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """The least and the greatest coordinates of some points, 0 where there are none."""
    low = jnp.min(jnp.where(among, points, jnp.inf), axis=0)
    high = jnp.max(jnp.where(among, points, -jnp.inf), axis=0)
    return jnp.where(jnp.isfinite(low), low, 0.0), jnp.where(jnp.isfinite(high), high, 0.0)


def _directional(light, surface, mesh, camera, settings):
    """The views of a directional light, and the weight of each at every pixel."""
    axes = axes_towards(-safe.normalize(light.direction))
    vertices, among = _in_use(mesh)
    low, high = _bounds(jnp.stack(rotate(axes, vertices), axis=-1), among)
    view = parallel_view(axes, low, high, settings.resolution, settings.margin)
    if settings.cascades:
        return cascades(view, surface, camera, settings.cascades, settings.split)
    return jax.tree.map(lambda leaf: leaf[None], view), jnp.ones_like(surface.alpha)[None]


def _far(light, mesh):
    """The distance of the farthest vertex from a lamp."""
    vertices, among = _in_use(mesh)
    away = vertices - jnp.broadcast_to(light.position, vertices.shape)
    return jnp.max(jnp.where(among, jnp.abs(away), 0.0)) * 3.0**0.5


def _spot(light, surface, mesh, camera, settings):
    """The view of a spot: its cone, up to the widest that makes a map; pixels beyond it are lit."""
    axes = axes_towards(-safe.normalize(light.direction))
    tangent = jnp.tan(jnp.clip(light.outer, NARROW, WIDE))
    view = central_view(axes, light.position, tangent, _far(light, mesh), settings.resolution, settings.margin)
    return jax.tree.map(lambda leaf: leaf[None], view), jnp.ones_like(surface.alpha)[None]


def _point(light, surface, mesh, camera, settings):
    """The six sides of a cube about a lamp; a pixel belongs to the side that its direction meets."""
    size, one = settings.resolution // 2, jnp.ones_like(light.range)
    sides = jnp.asarray(SIDES, mesh.vertices.dtype)
    make = functools.partial(central_view, size=size, margin=settings.margin)
    views = jax.vmap(make, (0, None, None, None))(sides, light.position, one, _far(light, mesh))
    away = surface.position - jnp.broadcast_to(light.position, surface.position.shape)
    x, y, z = (jnp.abs(away[..., k]) for k in range(3))
    axis = jnp.where((x >= y) & (x >= z), 0, jnp.where(y >= z, 1, 2))
    along = jnp.where(axis == 0, away[..., 0], jnp.where(axis == 1, away[..., 1], away[..., 2]))
    side = 2 * axis + jnp.where(along < 0, 1, 0)
    return views, jnp.stack([(side == k).astype(x.dtype) for k in range(6)])


VIEWS = {"directional": _directional, "point": _point, "spot": _spot}
