"""The surfaces of each pixel one behind the other: blended ones, up to the first that hides the rest.

The nearest opaque triangle is found first, by drawing those alone. Then the others are peeled, nearest first, until
every pixel has reached it, or nothing: a masked fragment where its material is cut out is passed by; elsewhere it is
solid and ends the pixel, as opaque ones do. A blended one takes the pixel's next layer; without a free one it is left
out and counted. However many fragments lie in front of each other, masks are exact. One loop draws all of this, so that
there is one rasterizer in the program; another round draws only what is not opaque, and sorts out all faces.
Shadows: masked triangles cast whole ones, as if nothing were cut out, and blended ones none.

Gradient: none through the choice of fragments; exact through barycentrics and depth of each layer.
Source: Everitt 2001, "Interactive Order-Independent Transparency"; alpha modes as in the glTF 2.0 specification, 3.9.4.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..buffers import Stats, Visibility
from ..math.table import fetch
from ..record import record, static
from ..scene import BLEND, MASK, OPAQUE
from .barycentric import barycentric
from .raster import peel, rasterize
from .tiles import in_front

NEAREST = 2**31 - 1  # a nearness that everything lies behind


@record
class Layers:
    """`blended` fragments are kept at most at each pixel, in front of the solid one; each layer takes the memory of a
    picture, and the time of its light. `masked` says whether masked materials are cut out, which looks up textures
    while peeling."""

    blended: int = static(default=4)
    masked: bool = static(default=True)

    def validate(self):
        """Raise one clear line for a number of layers that cannot be."""
        if type(self.blended) is not int or self.blended < 0:
            raise ValueError(f"Layers.blended must be a whole number, 0 or more, got {self.blended!r}")
        if type(self.masked) is not bool:
            raise ValueError(f"Layers.masked must be True or False, got {self.masked!r}")


@record
class _State:
    """What the loop carries: whole numbers only. `ahead`, `solid` and `kept` are (nearness, face)."""

    turn: Int[Array, ""]
    ahead: tuple
    solid: tuple
    kept: tuple
    count: Int[Array, "h w"]
    stats: Stats


def _choose(condition, some, others):
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), some, others)


def _put(slots, number, values):
    """The slots `[n, h, w]`, in that of each pixel's `number` its value instead; in none where it is -1."""
    chosen = jnp.arange(slots[0].shape[0], dtype=jnp.int32)[:, None, None] == number[None]
    return jax.tree.map(lambda old, new: jnp.where(chosen, new[None], old), slots, values)


def _start(clip, settings, height, width):
    """Nothing seen, and everything still to be drawn."""
    # Derive it from the data: under `shard_map` what a loop carries must vary over devices like what it makes of it.
    zero = jnp.sum(clip > 0, dtype=jnp.int32) * 0
    here = jnp.zeros((height, width), jnp.int32) + zero
    slots = jnp.zeros((settings.blended + 1, height, width), jnp.int32) + zero
    return _State(
        turn=zero,
        ahead=(here + NEAREST, here - 1),
        solid=(here, here - 1),
        kept=(slots, slots - 1),
        count=here,
        stats=Stats(non_finite=zero, degenerate=zero, out_of_range=zero, beyond_layers=zero),
    )


def _add(stats, found, beyond, turn, num_faces):
    """Count what is left out: every triangle is drawn in the first turn or in the second, and counts as out of range in
    the other."""
    new = turn < 2
    return Stats(
        non_finite=stats.non_finite + jnp.where(new, found.non_finite, 0),
        degenerate=stats.degenerate + jnp.where(new, found.degenerate, 0),
        out_of_range=stats.out_of_range + jnp.where(new, found.out_of_range - turn * num_faces, 0),
        beyond_layers=stats.beyond_layers + jnp.sum(beyond, dtype=jnp.int32),
    )


@functools.partial(jax.jit, static_argnames=("height", "width"))
def _find(clip, faces, modes, holes, cull, settings, *, height, width):
    """(nearness, face) of each layer, and what was left out."""

    def draw(state):
        first = state.turn == 0
        drawn = jnp.where(((modes == OPAQUE) == first)[:, None], faces, -1)
        nearness, face = state.ahead
        blank = jnp.zeros((height, width, 3), clip.dtype)
        ahead = Visibility(face=face, barycentric=blank, depth=blank[..., 0], nearness=nearness, stats=state.stats)
        seen = peel(clip, drawn, ahead, cull=cull)
        found, mode = (seen.nearness, seen.face), fetch(modes, jnp.maximum(seen.face, 0))

        # Sort out the fragments in front of the nearest solid one.
        reached = ~first & (seen.face >= 0) & in_front(*found, *state.solid)
        blended = reached & (mode == BLEND)
        hole = reached & (mode == MASK) & holes(seen) if settings.masked else reached & False
        keep = blended & (state.count < settings.blended)
        nothing = (jnp.zeros_like(face), jnp.full_like(face, -1))
        return _State(
            turn=state.turn + 1,
            ahead=_choose(first, state.ahead, _choose(blended | hole, found, nothing)),
            solid=_choose(first | (reached & ~blended & ~hole), found, state.solid),
            kept=_put(state.kept, jnp.where(keep, state.count, -1), found),
            count=state.count + keep.astype(jnp.int32),
            stats=_add(state.stats, seen.stats, blended & ~keep, state.turn, faces.shape[0]),
        )

    state = _start(clip, settings, height, width)
    state = lax.while_loop(lambda state: jnp.any(state.ahead[0] > 0), draw, state)
    # Put the solid one behind the last blended one.
    return *_put(state.kept, state.count, state.solid), state.stats


@jax.jit
def _see(clip, faces, nearness, face, stats):
    """Layers as the rest of the package reads them, from their (nearness, face)."""

    def see(nearness, face):
        weights, depth = barycentric(clip, faces, face)
        return Visibility(face=face, barycentric=weights, depth=depth, nearness=nearness, stats=stats)

    return jax.vmap(see)(nearness, face)


def layers(
    clip: Float[Array, "v 4"],
    faces: Int[Array, "f 3"],
    modes: Int[Array, " f"],
    holes: Callable[[Visibility], Bool[Array, "h w"]],
    cull: Bool[Array, " f"] | None,
    settings: Layers,
    *,
    height: int,
    width: int,
) -> Visibility:
    """Layers `[blended + 1, h, w]` front to back: at each pixel the first ones are used, up to the solid one.

    `modes` holds OPAQUE, MASK or BLEND for each face; `holes`, a pytree, says where a masked material is cut out.
    `stats.beyond_layers` counts blended fragments that had no layer.
    """
    if 0 in (faces.shape[0], clip.shape[0]):
        # Without triangles there is one layer of nothing.
        return jax.tree.map(lambda leaf: leaf[None], rasterize(clip, faces, height=height, width=width))
    still = lax.stop_gradient((clip, faces.astype(jnp.int32), modes, holes, cull))
    nearness, face, stats = _find(*still, settings, height=height, width=width)
    return _see(clip, faces, nearness, face, stats)
