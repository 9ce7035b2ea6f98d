"""The path of large triangles: pairs of a triangle and a tile, sorted by tile; each tile then draws its own.

The pairs of many triangles are numbered in one row and taken in windows of a fixed length, so that nothing overflows
however many there are: a window may end in the middle of a triangle, and the next one resumes there.
Gradient: none.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ..math.pair import pair, unpair
from ..math.scan import running_sum
from ..math.table import apart, fetch
from .tiles import PIXELS, TILE, grid, in_front, span
from .triangle import Triangle, edges_at, nearness

TILES = 128  # tiles drawn side by side
UNROLL = 2  # triangles of a tile drawn in one step: their tile is read and written once
_COLUMNS = 16


def pack(triangle: Triangle, ids: Int[Array, " n"]) -> Int[Array, "n 16"]:
    """All of a triangle in one row, so that one access fetches it."""
    floats = (triangle.depth, triangle.slope_x, triangle.slope_y)
    columns = [
        *(triangle.x[0], triangle.y[0], triangle.x[1], triangle.y[1], triangle.x[2], triangle.y[2]),
        (triangle.left << 16) | triangle.right,
        (triangle.top << 16) | triangle.bottom,
        *(lax.bitcast_convert_type(value, jnp.int32) for value in floats),
        triangle.least,
        triangle.most,
        ids,
    ]
    return jnp.stack(columns + [jnp.zeros_like(ids)] * (_COLUMNS - len(columns)), axis=-1)


def _unpack(row: Int[Array, "n 16"]) -> tuple[Triangle, Int[Array, " n"]]:
    c = [row[:, k] for k in range(14)]
    depth, slope_x, slope_y = (lax.bitcast_convert_type(value, jnp.float32) for value in c[8:11])
    return Triangle(
        x=(c[0], c[2], c[4]),
        y=(c[1], c[3], c[5]),
        left=c[6] >> 16,
        right=c[6] & 0xFFFF,
        top=c[7] >> 16,
        bottom=c[7] & 0xFFFF,
        depth=depth,
        slope_x=slope_x,
        slope_y=slope_y,
        least=c[11],
        most=c[12],
    ), c[13]


def _pairs(rows, ends, before, window, height, width):
    """The pairs numbered `window`: their tiles, -1 where they are none, and what their tiles need to draw them."""
    across = grid(height, width)[1]
    # Count the triangles that end at or before each pair.
    place = ends - window[0]
    counted = (place >= 0) & (place < window.shape[0])
    marks = jnp.zeros_like(window).at[jnp.where(counted, place, window.shape[0])].add(1, mode="drop")
    index = jnp.minimum(running_sum(marks) + jnp.sum(place < 0, dtype=jnp.int32), rows.shape[0] - 1)
    triangle, ids = _unpack(fetch(rows, index))

    def tile_of(triangle, before):
        tiles_across, within = span(triangle.left, triangle.right), window - before
        line = within // tiles_across
        return triangle.left // TILE + (within - line * tiles_across), triangle.top // TILE + line

    # Divide once: XLA would do it again for each of the numbers below.
    column, line = apart(window[0] < ends[-1], tile_of, triangle, fetch(before, index))
    edges = edges_at(triangle, column * TILE, line * TILE, height, width)
    # Leave out tiles that lie outside of an edge even where it is farthest inside.
    touched = window < ends[-1]
    for value, right, down in edges:
        touched = touched & (value + (TILE - 1) * (jnp.maximum(right, 0) + jnp.maximum(down, 0)) >= 0)
    middle_x, middle_y = triangle.middle
    offset = ((column * TILE - middle_x) << 16) | ((line * TILE - middle_y) & 0xFFFF)
    floats = (triangle.depth, triangle.slope_x, triangle.slope_y)
    bits = (lax.bitcast_convert_type(value, jnp.int32) for value in floats)
    flat = [part for edge in edges for part in edge]
    row = jnp.stack([*flat, offset, *bits, triangle.least, triangle.most, ids], axis=-1)
    return jnp.where(touched, line * across + column, -1), row


def _draw_pair(pixels, ahead, row):
    """Pixels (depth bits, id) of tiles `[t, 16, 16]` after one triangle each, given by its pair's row `[t, 16]`."""
    c = [row[:, k, None, None] for k in range(_COLUMNS)]
    i = jnp.arange(TILE, dtype=jnp.int32)[None, None, :]
    j = jnp.arange(TILE, dtype=jnp.int32)[None, :, None]
    e = [(c[3 * k] + c[3 * k + 2] * j) + c[3 * k + 1] * i for k in range(3)]
    depth, slope_x, slope_y = (lax.bitcast_convert_type(value, jnp.float32) for value in c[10:13])
    right, down = (c[9] >> 16) + i, ((c[9] << 16) >> 16) + j
    near = nearness(depth, slope_x, slope_y, c[13], c[14], right.astype(jnp.float32), down.astype(jnp.float32))
    near = jnp.where((e[0] | e[1] | e[2]) >= 0, near, -1)
    here, id = unpair(pixels)
    wins = in_front(near, c[15], here, id)
    if ahead is not None:
        wins = wins & in_front(*unpair(ahead), near, c[15])
    return jnp.where(wins, pair(near, c[15]), pixels)


def draw_large(pixels, ahead, rows, tiles, *, window: int, height: int, width: int):
    """Draw packed triangles `rows`, each of which has `tiles` tiles in its box, into `pixels` `[t, 256]`.

    Only what lies behind the pixels `ahead` is drawn, unless they are None. `window` pairs are sorted at a time.
    """
    down, across = grid(height, width)
    num_tiles = down * across
    slot_bits, tile_bits = (window - 1).bit_length(), (num_tiles - 1).bit_length()
    assert slot_bits + num_tiles.bit_length() <= 31 and slot_bits + 1 + tile_bits <= 31, "keys need 31 bits"
    ends = running_sum(tiles)
    before = ends - tiles
    # No pair: a row that has every pixel outside of an edge.
    nothing = jnp.array([[-1, 0, 0] + [0] * (_COLUMNS - 3)], jnp.int32)
    batch = min(TILES, num_tiles)

    def draw_window(state):
        start, pixels = state
        slot = jnp.arange(window, dtype=jnp.int32)
        tile, pair_rows = _pairs(rows, ends, before, start + slot, height, width)
        tile = jnp.where(tile < 0, num_tiles, tile)
        keys = lax.sort((tile << slot_bits) | slot)
        pair_rows = jnp.concatenate([fetch(pair_rows, keys & (2**slot_bits - 1)), nothing])

        # Order the tiles by their number of pairs, so that those drawn together have about as many.
        count = jnp.zeros(num_tiles + 1, jnp.int32).at[tile].add(1, mode="promise_in_bounds").at[num_tiles].set(0)
        first = running_sum(count) - count
        ranked = lax.sort(((window - count[:-1]) << tile_bits) | jnp.arange(num_tiles, dtype=jnp.int32))
        ranked = jnp.pad(ranked & (2**tile_bits - 1), (0, batch - 1), constant_values=num_tiles)
        busy = jnp.sum(count > 0, dtype=jnp.int32)

        def draw_tiles(state):
            place, pixels = state
            tile = lax.dynamic_slice_in_dim(ranked, place, batch)
            begin, number = fetch(first, tile), fetch(count, tile)
            end, most = begin + number, number[0]

            def pairs_at(rank):
                rows = [begin + (rank + r) for r in range(UNROLL)]
                return [jnp.where(row < end, row, window) for row in rows]

            # Carry the places of the next rows: found while fetching, they would be found again for each number.
            def draw(state):
                rank, drawn, places = state
                for place in places:
                    drawn = _draw_pair(drawn, hidden, fetch(pair_rows, place))
                return rank + UNROLL, drawn, pairs_at(rank + UNROLL)

            drawn, hidden = (
                None if source is None else fetch(source, tile).reshape(batch, TILE, TILE) for source in (pixels, ahead)
            )
            state = (most * 0, drawn, pairs_at(most * 0))
            drawn = lax.while_loop(lambda state: state[0] < most, draw, state)[1]
            return place + batch, pixels.at[tile].set(drawn.reshape(batch, PIXELS), mode="promise_in_bounds")

        return start + window, lax.while_loop(lambda s: s[0] < busy, draw_tiles, (start * 0, pixels))[1]

    return lax.while_loop(lambda s: s[0] < ends[-1], draw_window, (ends[-1] * 0, pixels))[1]
