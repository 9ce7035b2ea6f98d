"""Exact hard shadows: the scene's triangles drawn into the light's view, where its samples are the pixels themselves.

An irregular z-buffer. What a pixel shows has one place in the view (`shadow_samples` sorts these into tiles), and lies
in shadow where a triangle covers that place and is nearer to the light. Corners (x, y, z, w) are homogeneous, so that
nothing is clipped: with e_0 = (x_1, y_1, w_1) × (x_2, y_2, w_2) and so on and D their determinant, the triangle covers
(X, Y) where all E_i = e_i · (X, Y, 1) have the sign of D, and there

    depth = Σ E_i z_i / D,   1 at the view's near plane: what is nearer than that throws no shadow.

Pairs of a triangle and a tile are taken as by the rasterizer's path for large triangles, but a pixel does not look for
the nearest one, and what a pair finds, all its tile's samples ask at once.
Places leave their surface on the light's side by a bound on their rounding, 2⁻²⁰ of the scene's largest coordinate.
Edges are widened by their rounding: light never comes through between neighbours.

Gradient: none, on purpose: occlusion is a step.
Source: Johnson et al. 2005, "The Irregular Z-Buffer: Hardware Acceleration for Irregular Data Structures"; Aila & Laine
2004, "Alias-Free Shadow Maps"; the formulas are Olano & Greer's of 1997, "Triangle Scan Conversion using 2D Homogeneous
Coordinates".
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..buffers import Surface
from ..geometry.intersect import OFFSET
from ..math import safe
from ..math.scan import running_sum
from ..math.table import fetch
from ..scene import Mesh
from .shadow_frame import LightView, Receiver, local
from .shadow_samples import Samples, binned

TILES = 32, 64  # of a view on a side: setting up a pair shall cost about as much as what its samples ask
MANY = 2**15  # triangles from which on the tiles are the smaller ones
BAND = 2**18  # pixels sorted together: their keys need 31 bits
FACES = 2**18  # triangles whose pairs are counted together, in 31 bits
WINDOW = 2**14  # pairs sorted together
BATCH = 128  # blocks of samples asked side by side
UNROLL = 2  # triangles that a block asks in one step
SLACK = 2.0**-22  # of the terms of an edge function: four roundings
_COLUMNS = 16


def tiles(num_faces: int) -> int:
    """How many tiles on a side a view of so many triangles shall have."""
    return TILES[num_faces >= MANY]


def leave(surface: Surface, view: LightView, mesh: Mesh) -> Float[Array, "*b 3"]:
    """Positions off their surface on the light's side."""
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    offset = OFFSET * jnp.max(jnp.where(jnp.isfinite(corners), jnp.abs(corners), 0.0))
    towards = jnp.broadcast_to(view.axes[2], surface.position.shape)
    if view.central:
        towards = jnp.broadcast_to(view.origin, surface.position.shape) - surface.position
    side = jnp.where(safe.dot(surface.geometric_normal, towards) < 0, -offset, offset)
    return surface.position + side[..., None] * surface.geometric_normal


def _corners(view: LightView, vertices: Float[Array, "v 3"]) -> Float[Array, "v 4"]:
    """x and y in tiles, z and w; divided by w where that leaves the near plane behind."""
    (column, line, height), w = local(view, vertices)
    x, y = ((place - low * w) / texel for place, low, texel in zip((column, line), view.low, view.texel))
    z = jnp.broadcast_to(view.depth[0], w.shape) if view.central else (height - view.depth[0]) / view.depth[1]
    divisor = jnp.where(w > view.depth[0], w, 1.0) if view.central else w
    return jnp.stack([x / divisor, y / divisor, z / divisor, w / divisor], axis=-1)


def _rows(corners: Float[Array, "f 3 4"], exists: Bool[Array, " f"], side: int):
    """Triangles `[f, 16]`: three corners, the box of tiles (left, width, top), and pairs before; and pairs up to each.

    One that reaches behind the near plane may lie anywhere.
    """
    x, y, w = corners[..., 0], corners[..., 1], corners[..., 3]
    whole = jnp.all(w == 1.0, axis=1)
    # NaN and infinite corners fail this; a face without a corner before the light is nowhere.
    drawn = exists & jnp.all(jnp.abs(corners) < jnp.inf, axis=(1, 2)) & jnp.any(w > 0, axis=1)

    def span(values):
        first, last = (
            jnp.clip(jnp.floor(bound), -1, side).astype(jnp.int32) for bound in (values.min(1), values.max(1))
        )
        inside = (last >= 0) & (first < side)
        first, last = jnp.maximum(first, 0), jnp.minimum(last, side - 1)
        return jnp.where(whole, first, 0), jnp.where(whole, last - first + 1, side), inside | ~whole

    (left, across, within_x), (top, down, within_y) = span(x), span(y)
    pairs = jnp.where(drawn & within_x & within_y, across * down, 0)
    ends = running_sum(pairs)
    whole_numbers = lax.bitcast_convert_type(jnp.stack([left, across, top, ends - pairs], axis=1), jnp.float32)
    return jnp.concatenate([corners.reshape(-1, 12), whole_numbers], axis=1), ends


def _pairs(rows, ends, window, samples: Samples, side: int):
    """The pairs numbered `window`: their tiles, as many as there are tiles for none, and rows to ask `[p, 16]`."""
    place = ends - window[0]
    counted = (place >= 0) & (place < window.shape[0])
    marks = jnp.zeros_like(window).at[jnp.where(counted, place, window.shape[0])].add(1, mode="drop")
    index = jnp.minimum(running_sum(marks) + jnp.sum(place < 0, dtype=jnp.int32), rows.shape[0] - 1)
    row = fetch(rows, index)
    left, across, top, before = (lax.bitcast_convert_type(row[:, k], jnp.int32) for k in range(12, 16))
    line = (window - before) // jnp.maximum(across, 1)
    column, line = left + (window - before) - line * across, top + line
    tile = jnp.clip(line * side + column, 0, side * side)

    # Count places from the tile's middle, and depths from the first corner's.
    x, y, z, w = ([row[:, 4 * k + i] for k in range(3)] for i in range(4))
    middle_x, middle_y = column.astype(row.dtype) + 0.5, line.astype(row.dtype) + 0.5
    x, y = ([v - middle * one for v, one in zip(values, w)] for values, middle in ((x, middle_x), (y, middle_y)))
    from_depth = jnp.where((w[0] == 1.0) & (w[1] == 1.0) & (w[2] == 1.0), z[0], 0.0)
    z = [value - from_depth * one for value, one in zip(z, w)]
    turns = (1, 2), (2, 0), (0, 1)
    a, b, c = ([p[i] * q[j] - q[i] * p[j] for i, j in turns] for p, q in ((y, w), (w, x), (x, y)))
    determinant = a[0] * x[0] + b[0] * y[0] + c[0] * w[0]
    sign = jnp.where(determinant < 0, -1.0, 1.0)
    terms = [0.5 * (abs(y[i] * w[j]) + abs(w[i] * y[j]) + abs(w[i] * x[j]) + abs(x[i] * w[j])) for i, j in turns]
    slack = [SLACK * (t + abs(x[i] * y[j]) + abs(y[i] * x[j])) for t, (i, j) in zip(terms, turns)]
    rise = [sign * sum(z[k] * part[k] for k in range(3)) for part in (a, b, c)]
    a, b, c = ([sign * value for value in part] for part in (a, b, c))
    c = [value + more for value, more in zip(c, slack)]

    # Leave out tiles outside of an edge, and those whose samples are all nearer to the light.
    touched = (window < ends[-1]) & (determinant != 0)
    for k in range(3):
        touched = touched & (c[k] + 0.5 * (abs(a[k]) + abs(b[k])) >= 0)
    highest = rise[2] + 0.5 * (abs(rise[0]) + abs(rise[1]))
    touched = touched & (highest > (fetch(samples.lowest, tile) - from_depth) * jnp.abs(determinant))
    parts = [*a, *b, *c, *rise, jnp.abs(determinant), from_depth]
    asked = jnp.stack(parts + [jnp.zeros_like(sign)] * (_COLUMNS - len(parts)), axis=-1)
    return jnp.where(touched, tile, side * side), asked


def _ask(dark, x, y, depth, row):
    """Which samples `[t, n]` are in shadow after one triangle each, given by its pair's row `[t, 16]`."""
    c = [row[:, k, None] for k in range(14)]
    e = [c[6 + k] + c[k] * x + c[3 + k] * y for k in range(3)]
    rise = c[11] + c[9] * x + c[10] * y
    before = (rise > (depth - c[13]) * c[12]) & (rise <= (1.0 - c[13]) * c[12])
    return jnp.where((e[0] >= 0) & (e[1] >= 0) & (e[2] >= 0) & before, 1, dark)


def _draw(samples: Samples, rows, ends, dark, side: int):
    """Which samples `[k + 1, n]` are in shadow after these triangles; the last row is nobody's."""
    tiles, blocks = side * side, samples.depth.shape[0]
    slot_bits, block_bits = (WINDOW - 1).bit_length(), (blocks - 1).bit_length()
    slot = jnp.arange(WINDOW, dtype=jnp.int32)
    # No pair: all is outside of an edge.
    nothing = jnp.zeros((1, _COLUMNS)).at[0, 6].set(-1.0)
    owner = jnp.append(samples.tile, tiles)

    def draw_window(state):
        start, dark = state
        tile, asked = _pairs(rows, ends, start + slot, samples, side)
        keys = lax.sort((tile << slot_bits) | slot)
        asked = jnp.concatenate([fetch(asked, keys & (WINDOW - 1)), nothing.astype(asked.dtype)])
        count = jnp.zeros(tiles + 1, jnp.int32).at[tile].add(1, mode="promise_in_bounds").at[tiles].set(0)
        first = running_sum(count) - count

        # Order the blocks by how much they ask, so that those side by side ask about as much.
        number = fetch(count, owner)
        ranked = lax.sort(((WINDOW - number[:-1]) << block_bits) | jnp.arange(blocks, dtype=jnp.int32))
        ranked = jnp.pad(ranked & (2**block_bits - 1), (0, BATCH - 1), constant_values=blocks)

        def ask_blocks(state):
            place, dark = state
            block = lax.dynamic_slice_in_dim(ranked, place, BATCH)
            begin, most = fetch(first, fetch(owner, block)), fetch(number, block)
            own = jnp.minimum(block, blocks - 1)
            x, y, depth = (fetch(part, own) for part in (samples.x, samples.y, samples.depth))

            def ask(state):
                rank, here = state
                for k in range(UNROLL):
                    here = _ask(here, x, y, depth, fetch(asked, jnp.where(rank + k < most, begin + rank + k, WINDOW)))
                return rank + UNROLL, here

            here = lax.while_loop(lambda s: s[0] < most[0], ask, (most[0] * 0, fetch(dark, block)))[1]
            return place + BATCH, dark.at[block].set(here, mode="promise_in_bounds")

        busy = jnp.sum(number > 0, dtype=jnp.int32)
        return start + WINDOW, lax.while_loop(lambda s: s[0] < busy, ask_blocks, (start * 0, dark))[1]

    return lax.while_loop(lambda s: s[0] < ends[-1], draw_window, (ends[-1] * 0, dark))[1]


def _band(x, y, depth, used, corners, faces: Int[Array, "f 3"], side: int) -> Float[Array, " n"]:
    """1 where a pixel of a band sees the light, else 0."""
    samples = binned(x, y, depth, used, side)
    num = faces.shape[0]
    group = min(num, FACES)

    def draw_group(index, dark):
        # The last group begins earlier, so that it ends with the faces: what is asked twice answers the same.
        some = lax.dynamic_slice_in_dim(faces, jnp.minimum(index * group, num - group), group)
        exists = jnp.all((some >= 0) & (some < corners.shape[0]), axis=1)
        rows, ends = _rows(corners[jnp.where(exists[:, None], some, 0)], exists, side)
        return _draw(samples, rows, ends, dark, side)

    # Derive the first answers from the input, so that a device-varying input makes device-varying loops.
    blocks, block = samples.depth.shape
    dark = jnp.zeros((blocks + 1, block), jnp.int8) + (samples.tile[0] * 0).astype(jnp.int8)
    dark = lax.fori_loop(0, -(-num // group), draw_group, dark)
    return 1.0 - fetch(dark.reshape(-1), samples.slot).astype(corners.dtype)


@functools.cache
def _core(side: int):
    """The compiled shadow in a view of so many tiles on a side; batches run one after the other."""

    def lit(x, y, depth, used, corners, faces):
        num = x.shape[0]
        bands = -(-num // BAND)
        width = -(-num // bands)
        parts = [jnp.pad(part, (0, bands * width - num)).reshape(bands, width) for part in (x, y, depth, used)]

        def band(parts):
            x, y, depth, used = parts
            return _band(x, y, depth, used, corners, faces, side)

        return lax.map(band, tuple(parts)).reshape(-1)[:num]

    return jax.custom_batching.sequential_vmap(jax.jit(lit))


def exact(view: LightView, place: Receiver, used: Bool[Array, "*b"], mesh: Mesh) -> Float[Array, "*b"]:
    """1 where a place sees the light of this view, whose texels are tiles, else 0; what is not `used` costs nothing."""
    parts = [part.reshape(-1).astype(jnp.float32) for part in (place.x, place.y, place.depth)]
    corners = _corners(view, mesh.vertices).astype(jnp.float32)
    lit = _core(view.size)(*parts, used.reshape(-1), corners, mesh.faces.astype(jnp.int32))
    return lit.reshape(used.shape).astype(place.depth.dtype)
