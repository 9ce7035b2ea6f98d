"""The hard rasterizer: one sample at each pixel's centre, the nearest triangle wins.

Coverage is decided by integers (`fixed_point`) under the top-left rule, so that every sample on a shared edge belongs
to exactly one of its triangles. Work is cut into (triangle, tile) pairs that a loop of dynamic length draws in chunks:
no capacity exists that could overflow. The same compiled loop runs twice, first for the nearest depth, then for the
lowest face id at that depth, so that both passes see the same bits.

Space: clip positions in, pixels out (row 0 on top, centres at +0.5). Depth reversed: 1 near, 0 far, greater wins.
Gradient: face ids have none, on purpose (`stop_gradient` stands in `rasterize`); barycentrics and depth are recomputed
from the clip vertices and are exact inside each triangle. Coverage is piecewise constant: its gradient is 0.
"""

import functools
import math

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..buffers import Stats, Visibility
from ..check import below, fit
from ..math.table import fetch
from .barycentric import LIMIT, barycentric
from .clip import CORNERS, clip_polygon, plane_distances
from .fixed_point import GUARD, SUBPIXELS, edge, pixels_inside, sign, snap, to_float

TILE = 4  # pixels; small triangles dominate, and a larger tile mostly draws what they do not cover
PAIRS = 4096  # (triangle, tile) pairs a step of the loop
FAN = CORNERS - 2  # triangles of a clipped polygon
GROUP = 2**16  # triangles whose pairs are counted together; each group costs some milliseconds of its own
POLYGONS = 2**10  # faces clipped together; few scenes have more that cross a plane
_LAST = 2**31 - 1


def _screen(clip, height, width):
    """Snapped x, y and depth of vertices whose w is positive; NaN elsewhere is somebody else's to mask."""
    inverse = 1.0 / clip[..., 3]
    x = snap(clip[..., 0] * inverse * (0.5 * width))
    y = snap(-clip[..., 1] * inverse * (0.5 * height))
    return x, y, clip[..., 2] * inverse


def _setup(x, y, depth, drawable, sides, height, width):
    """What the loop needs of `[n, 3]` screen triangles: int rows `[n, 16]`, numbers of tiles, and the areas' signs.

    `sides` is 1 where back faces are culled, -1 where front faces are, 0 for neither.
    """
    (x0, x1, x2), (y0, y1, y2) = (tuple(v[:, i] for i in range(3)) for v in (x, y))
    area = edge(x0, y0, x1, y1, x2, y2)
    winding = sign(area)
    # Screen y points down, so that a counter-clockwise front face has negative area.
    drawable = drawable & (winding != 0) & (winding * sides <= 0)

    # Count the tiles over the box of the pixel centres that the triangle can reach, from its own corner on.
    def centres(low, high, size):
        first = -((-low - (size - 1) * (SUBPIXELS // 2)) // SUBPIXELS)
        last = (high + (size - 1) * (SUBPIXELS // 2)) // SUBPIXELS
        return jnp.maximum(first, 0), jnp.minimum(last, size - 1)

    left, right = centres(jnp.min(x, axis=1), jnp.max(x, axis=1), width)
    top, bottom = centres(jnp.min(y, axis=1), jnp.max(y, axis=1), height)
    drawable = drawable & (left <= right) & (top <= bottom)
    across = (right - left) // TILE + 1
    tiles = jnp.where(drawable, across * ((bottom - top) // TILE + 1), 0)

    # Orient all triangles the same way by swapping the last two corners.
    flipped = winding < 0
    x1, x2, y1, y2 = (jnp.where(flipped, a, b) for a, b in ((x2, x1), (x1, x2), (y2, y1), (y1, y2)))
    d0, d1, d2 = (
        depth[:, 0],
        jnp.where(flipped, depth[:, 2], depth[:, 1]),
        jnp.where(flipped, depth[:, 1], depth[:, 2]),
    )
    inverse_area = 1.0 / jnp.where(drawable, jnp.abs(to_float(area)), 1.0)
    floats = [d0 * inverse_area, d1 * inverse_area, d2 * inverse_area, jnp.min(depth, axis=1), jnp.max(depth, axis=1)]
    bits = [lax.bitcast_convert_type(v.astype(jnp.float32), jnp.int32) for v in floats]
    zero = jnp.zeros_like(x0)
    rows = jnp.stack([x0, y0, x1, y1, x2, y2, left, top, jnp.maximum(across, 1), *bits, zero, zero], axis=-1)
    return rows, tiles, winding


def _draw(buffer, rows, tiles, ids, finding_ids, height, width):
    """Draw a group of triangles into `buffer`: depth bits of all pixels, then (last - id) of all pixels, then a spare.

    Both halves keep maxima; while `finding_ids` only pixels whose depth equals the first half's are drawn.
    """
    num_pixels, spare = height * width, buffer.shape[0] - 1
    ends = jnp.cumsum(tiles)
    total = ends[-1]
    lane = jnp.arange(PAIRS, dtype=jnp.int32)

    def chunk(state):
        start, buffer = state
        # Find each pair's triangle and tile.
        pair = start + lane
        triangle = jnp.minimum(jnp.searchsorted(ends, pair, side="right").astype(jnp.int32), tiles.shape[0] - 1)
        row = fetch(rows, triangle).T
        x0, y0, x1, y1, x2, y2, left, top, across = row[:9]
        q0, q1, q2, lowest, highest = lax.bitcast_convert_type(row[9:14], jnp.float32)
        within = pair - fetch(ends - tiles, triangle)
        column = left + within % across * TILE
        line = top + within // across * TILE

        # Evaluate the edges exactly at the tile's first pixel.
        px = column * SUBPIXELS - (width - 1) * (SUBPIXELS // 2)
        py = line * SUBPIXELS - (height - 1) * (SUBPIXELS // 2)
        steps, depth, slope_x, slope_y = [], 0.0, 0.0, 0.0
        for ax, ay, bx, by, q in ((x1, y1, x2, y2, q0), (x2, y2, x0, y0, q1), (x0, y0, x1, y1, q2)):
            limbs, dx, dy = edge(ax, ay, bx, by, px, py), bx - ax, by - ay
            steps.append((pixels_inside(limbs, dx, dy), dx, dy))
            depth += to_float(limbs) * q
            slope_x -= dy.astype(jnp.float32) * (SUBPIXELS * q)
            slope_y += dx.astype(jnp.float32) * (SUBPIXELS * q)
        exists, id = pair < total, fetch(ids, triangle)

        # Visit the tiles' pixels one after the other; a loop of its own, or XLA repeats the above for each of them.
        def draw_pixel(step, buffer):
            i, j = step % TILE, step // TILE
            x, y = column + i, line + j
            inside = exists & (x < width) & (y < height)
            for first, dx, dy in steps:
                inside = inside & (first - dy * i + dx * j >= 0)
            # Clamp to the corners' depths: exact for triangles parallel to the screen, and slivers cannot overshoot.
            here = depth + slope_x * i.astype(jnp.float32) + slope_y * j.astype(jnp.float32)
            here = jnp.minimum(jnp.maximum(here, lowest), highest)
            inside = inside & (here > 0)
            bits = lax.bitcast_convert_type(here, jnp.int32)
            # Keep the nearest depth, or the lowest id that has it.
            pixel = jnp.where(inside, y * width + x, spare)
            value = jnp.where(finding_ids, jnp.where(bits == fetch(buffer, pixel), _LAST - id, 0), bits)
            target = jnp.where(finding_ids & inside, pixel + num_pixels, pixel)
            return buffer.at[target].max(value, mode="promise_in_bounds")

        return start + PAIRS, lax.fori_loop(jnp.int32(0), jnp.int32(TILE * TILE), draw_pixel, buffer)

    return lax.while_loop(lambda state: state[0] < total, chunk, (jnp.int32(0), buffer))[1]


def _nearest(clip, faces, sides, *, height, width, depth_only):
    """Face id of each pixel's nearest triangle, -1 for none, or only its depth, 0 for none; and what was left out."""
    num_pixels, num_faces = height * width, faces.shape[0]
    guard_x, guard_y = 2.0 * GUARD / width, 2.0 * GUARD / height

    # Leave out faces that name no vertex: a gather would clamp their indices, and draw some other triangle.
    exists = jnp.all((faces >= 0) & (faces < clip.shape[0]), axis=1)
    faces = jnp.where(exists[:, None], faces, 0)

    # Snap every vertex once, and set up the faces that need no clipping.
    finite = jnp.all(jnp.abs(clip) < LIMIT, axis=-1)
    clip = jnp.where(finite[:, None], clip, 1.0).astype(jnp.float32)
    whole = jnp.all(plane_distances(clip, guard_x, guard_y) >= 0, axis=-1) & (clip[:, 3] > 0)
    x, y, depth = _screen(jnp.where(whole[:, None], clip, 1.0), height, width)
    face_finite = jnp.all(finite[faces], axis=1) & exists
    face_whole = jnp.all(whole[faces], axis=1) & face_finite
    rows, tiles, winding = _setup(x[faces], y[faces], depth[faces], face_whole, sides, height, width)

    # Draw in groups small enough for their tiles to be counted in 31 bits; clipped faces follow the whole ones.
    num_tiles = math.ceil(height / TILE) * math.ceil(width / TILE)
    group = max(FAN, min(GROUP, num_faces, 2**30 // num_tiles))
    polygons = min(POLYGONS, group // FAN)
    whole_groups = math.ceil(num_faces / group)
    padding = (0, whole_groups * group - num_faces)
    rows, tiles = jnp.pad(rows, (padding, (0, 0)), constant_values=1), jnp.pad(tiles, padding)
    crossing = face_finite & ~face_whole
    num_crossing = jnp.sum(crossing, dtype=jnp.int32)
    crossing_ids = jnp.nonzero(crossing, size=num_faces, fill_value=0)[0].astype(jnp.int32)
    groups = whole_groups + (num_crossing + polygons - 1) // polygons

    def whole_group(index):
        start = index * group
        take = functools.partial(lax.dynamic_slice_in_dim, start_index=start, slice_size=group)
        return take(rows), take(tiles), start + jnp.arange(group, dtype=jnp.int32)

    def clipped_group(index):
        place = (index - whole_groups) * polygons + jnp.arange(polygons, dtype=jnp.int32)
        ids = crossing_ids[jnp.minimum(place, num_faces - 1)]
        polygon, corners = clip_polygon(clip[faces[ids]], guard_x, guard_y)
        corners = jnp.where(place < num_crossing, corners, 0)
        # Fan each polygon about its first corner; a clipped w of 0 or less has no place on the screen.
        fan = jnp.arange(FAN, dtype=jnp.int32)
        index = jnp.stack([jnp.zeros_like(fan), fan + 1, fan + 2], axis=-1)
        drawable = (fan[None, :] + 2 < corners[:, None]) & jnp.all(polygon[:, index, 3] > 0, axis=-1)
        positive = jnp.where(polygon[..., 3:] > 0, polygon, 1.0)
        x, y, depth = (v[:, index].reshape(-1, 3) for v in _screen(positive, height, width))
        ids = jnp.repeat(ids, FAN)
        rows, tiles, _ = _setup(x, y, depth, drawable.reshape(-1), sides[ids], height, width)
        unused = (0, group - polygons * FAN)
        return jnp.pad(rows, (unused, (0, 0)), constant_values=1), jnp.pad(tiles, unused), jnp.pad(ids, unused)

    def draw_group(state):
        step, buffer = state
        index = step % groups
        rows, tiles, ids = lax.cond(index < whole_groups, whole_group, clipped_group, index)
        return step + 1, _draw(buffer, rows, tiles, ids, step >= groups, height, width)

    # Derive the first buffer from the input, so that a device-varying input makes a device-varying loop.
    passes = 1 if depth_only else 2
    buffer = jnp.zeros(passes * num_pixels + 1, jnp.int32) + jnp.min(faces, initial=0) * 0
    buffer = lax.while_loop(lambda state: state[0] < passes * groups, draw_group, (jnp.int32(0), buffer))[1]
    stats = Stats(
        non_finite=jnp.sum(~face_finite & exists, dtype=jnp.int32),
        degenerate=jnp.sum(face_whole & (winding == 0), dtype=jnp.int32),
        out_of_range=jnp.sum(~exists, dtype=jnp.int32),
    )
    if depth_only:
        return lax.bitcast_convert_type(buffer[:-1].reshape(height, width), jnp.float32), stats
    found = buffer[num_pixels:-1].reshape(height, width)
    return jnp.where(found > 0, _LAST - found, -1), stats


@functools.cache
def _core(height: int, width: int, depth_only: bool = False):
    """The compiled integer core for one picture size; batches run one after the other, in loops of their own length."""
    return jax.custom_batching.sequential_vmap(
        jax.jit(functools.partial(_nearest, height=height, width=width, depth_only=depth_only))
    )


def _sides(cull, num_faces):
    """`cull` as a number per face: 1 drops its back, -1 its front, 0 neither."""
    if cull is None or isinstance(cull, str):
        names = {None: 0, "back": 1, "front": -1}
        if cull not in names:
            raise ValueError(f"rasterize: cull must be None, 'back', 'front' or a bool array [f], got {cull!r}")
        return jnp.full((num_faces,), names[cull], jnp.int32)
    fit("rasterize: cull", cull, Bool[Array, " f"], {"f": num_faces})
    return jnp.asarray(cull).astype(jnp.int32)


def rasterize(
    clip: Float[Array, "*b v 4"], faces: Int[Array, "f 3"], *, height: int, width: int, cull=None
) -> Visibility:
    """Face id, perspective-correct barycentrics and reversed depth of the nearest triangle at every pixel centre.

    Args:
        clip: positions with z already in [0, w]: w at the near plane, 0 at the far (fragments at or beyond it are not
            drawn). Triangles with a corner that is not finite or not below 1.844e18 are not drawn, change no pixel,
            and are counted in `stats`, as are those without area that cross no plane.
        faces: indices of corners; counter-clockwise on the screen is the front. An index that names no vertex raises
            where it is known when tracing, and is counted in `stats` otherwise.
        height, width: static; under `jit` close over them.
        cull: None, "back", "front", or a bool per face that drops the back of those faces.

    Ties in depth go to the lower face id. Leading axes of `clip` are batches.

    Gradient: none through `face`; exact through `barycentric` and `depth` inside each triangle, for the triangle that
    won; coverage and the depth test contribute 0.

    Example:
        >>> clip = jnp.array([[-1.0, -1.0, 0.5, 1.0], [1.0, -1.0, 0.5, 1.0], [-1.0, 1.0, 0.5, 1.0]])
        >>> rasterize(clip, jnp.array([[0, 1, 2]]), height=2, width=2).face.tolist()
        [[-1, -1], [0, -1]]
    """
    fit("rasterize: clip", clip, Float[Array, "*b v 4"])
    fit("rasterize: faces", faces, Int[Array, "f 3"])
    below("rasterize: faces", faces, clip.shape[-2], "vertices")
    for name, size in (("height", height), ("width", width)):
        if type(size) is not int or size < 1:
            raise ValueError(f"rasterize: {name} must be a whole number of at least 1, got {size!r} (close over it)")
    if max(height, width) > 2 * GUARD:
        raise ValueError(f"rasterize: {width} x {height} pixels exceed {2 * GUARD} on a side; draw it in parts")
    if clip.ndim > 2:
        per_picture = functools.partial(rasterize, height=height, width=width, cull=cull)
        return jax.vmap(per_picture, in_axes=(0, None))(clip, faces)
    clip, faces = jnp.asarray(clip), jnp.asarray(faces).astype(jnp.int32)
    if faces.shape[0] == 0 or clip.shape[0] == 0:
        # Draw one invisible triangle: gathers from empty tables are not defined.
        clip, faces, cull = jnp.full((1, 4), jnp.nan, clip.dtype), jnp.zeros((1, 3), jnp.int32), None
    face, stats = _core(height, width)(lax.stop_gradient(clip), faces, _sides(cull, faces.shape[0]))
    weights, depth = barycentric(clip, faces, face)
    return Visibility(face=face, barycentric=weights, depth=depth, stats=stats)


def rasterize_depth(
    clip: Float[Array, "v 4"], faces: Int[Array, "f 3"], *, height: int, width: int
) -> Float[Array, "h w"]:
    """The depth alone that decided `rasterize`, of the snapped triangles: half the work, and all a shadow map needs.

    Gradient: none.
    """
    sides = jnp.zeros(faces.shape[0], jnp.int32)
    return _core(height, width, depth_only=True)(lax.stop_gradient(clip), faces.astype(jnp.int32), sides)[0]
