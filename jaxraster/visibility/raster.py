"""The hard rasterizer: one sample at each pixel's centre, the nearest triangle wins.

Coverage is decided by integers (`fixed_point`) under the top-left rule, so that every sample on a shared edge belongs
to exactly one of its triangles. Triangles are ordered by the size of their boxes: the small ones visit their pixels
(`small`), the large ones and those cut by a plane go through tiles (`large`). All loops are of dynamic length over
chunks of fixed size: no capacity exists that could overflow.

Space: clip positions in, pixels out (row 0 on top, centres at +0.5). Depth reversed: 1 near, 0 far, greater wins.
Gradient: face ids have none, on purpose (`stop_gradient` stands in `rasterize`); barycentrics and depth are recomputed
from the clip vertices and are exact inside each triangle. Coverage is piecewise constant: its gradient is 0.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..buffers import Stats, Visibility
from ..check import below, fit
from ..math.pair import pair, unpair
from ..math.scan import partition
from ..math.table import fetch
from .barycentric import LIMIT, barycentric
from .clip import CORNERS, clip_polygon, plane_distances
from .fixed_point import GUARD
from .large import draw_large, pack
from .small import draw_small
from .tiles import FARTHEST, NOBODY, PIXELS, grid, picture, span, tiled
from .triangle import boxes, screen, set_up, winding

SMALL = 6  # pixels: boxes up to this many on a side are cheaper to visit than to sort into tiles
LONGEST = 64  # pixels from which on steps across a small box could leave 31 bits
FAN = CORNERS - 2  # triangles of a clipped polygon
POLYGONS = 2**10  # faces clipped together; few scenes have more that cross a plane
GROUP = 2**13  # large triangles set up together
WINDOW = 2**13  # pairs sorted together: their rows stay in the cache
CHUNK = 2**15  # small triangles visited side by side
SKIPPED, LARGE, CUT = -1, 4, 5  # and small ones by their size: up to 2, 3, 4, and more pixels


def _power_of_two(number: int, least: int, most: int) -> int:
    """The next power of two within limits."""
    return max(least, min(most, 1 << max(number - 1, 0).bit_length()))


def _kinds(x, y, whole, crossing, sides, small, height, width):
    """How each face is to be drawn, and the sign of its area."""
    area = winding(x, y)
    left, right, top, bottom = boxes(x, y, height, width)
    size = jnp.maximum(right - left, bottom - top) + 1
    # Screen y points down, so that a counter-clockwise front face has negative area.
    drawn = whole & (area != 0) & (area * sides <= 0) & (left <= right) & (top <= bottom)
    kind = jnp.where(size <= jnp.minimum(small, LONGEST), jnp.clip(size - 2, 0, LARGE - 1), LARGE)
    return jnp.where(crossing, CUT, jnp.where(drawn, kind, SKIPPED)), area


def _nearest(clip, faces, sides, small, *seen, height, width, depth_only):
    """Nearness of each pixel's nearest triangle, 0 for none, its id, -1 for none, and what was left out.

    Where another picture's nearness and face are given as `seen`, the nearest triangle behind that one.
    """
    num_faces = faces.shape[0]
    guard_x, guard_y = 2.0 * GUARD / width, 2.0 * GUARD / height

    # Leave out faces that name no vertex: a gather would clamp their indices, and draw some other triangle.
    exists = jnp.all((faces >= 0) & (faces < clip.shape[0]), axis=1)
    faces = jnp.where(exists[:, None], faces, 0)

    # Snap every vertex once.
    finite = jnp.all(jnp.abs(clip) < LIMIT, axis=-1)
    clip = jnp.where(finite[:, None], clip, 1.0).astype(jnp.float32)
    whole = jnp.all(plane_distances(clip, guard_x, guard_y) >= 0, axis=-1) & (clip[:, 3] > 0) & finite
    x, y, depth = screen(jnp.where(whole[:, None], clip, 1.0), height, width)
    state = finite.astype(jnp.int32) + whole.astype(jnp.int32)
    points = jnp.stack([x, y, lax.bitcast_convert_type(depth, jnp.int32), state], axis=-1)

    def corners(ids):
        rows = [fetch(points, fetch(faces, ids)[:, k]) for k in range(3)]
        x, y, depth = (tuple(row[:, k] for row in rows) for k in range(3))
        return x, y, tuple(lax.bitcast_convert_type(value, jnp.float32) for value in depth)

    # Order the faces by how they are drawn.
    rows = [fetch(points, faces[:, k]) for k in range(3)]
    states = jnp.minimum(jnp.minimum(rows[0][:, 3], rows[1][:, 3]), rows[2][:, 3])
    face_whole, crossing = exists & (states == 2), exists & (states == 1)
    x, y = (tuple(row[:, k] for row in rows) for k in range(2))
    kind, area = _kinds(x, y, face_whole, crossing, sides, small, height, width)
    order, starts = partition(kind)
    first_large, first_cut, end = starts[LARGE], starts[CUT], starts[CUT + 1]

    chunk = _power_of_two(num_faces // 8, 256, CHUNK)
    down, across = grid(height, width)
    # A group's pairs of a triangle and a tile are counted in 31 bits.
    group = max(FAN, min(_power_of_two(num_faces, FAN, GROUP), 2**30 // (down * across)))
    polygons = max(1, min(POLYGONS, group // FAN))
    window = _power_of_two(max(3 * min(num_faces, GROUP), 4 * down * across), 2048, WINDOW)
    window = min(window, 2 ** (30 - (down * across).bit_length()))
    whole_groups = (first_cut - first_large + group - 1) // group
    groups = whole_groups + (end - first_cut + polygons - 1) // polygons

    def whole_group(index):
        place = first_large + index * group + jnp.arange(group, dtype=jnp.int32)
        ids = fetch(order, jnp.minimum(place, num_faces - 1))
        return corners(ids), ids, place < first_cut

    def cut_group(index):
        place = first_cut + (index - whole_groups) * polygons + jnp.arange(polygons, dtype=jnp.int32)
        ids = fetch(order, jnp.minimum(place, num_faces - 1))
        polygon, num_corners = clip_polygon(clip[faces[ids]], guard_x, guard_y)
        num_corners = jnp.where(place < end, num_corners, 0)
        # Fan each polygon about its first corner; a clipped w of 0 or less has no place on the screen.
        fan = jnp.arange(FAN, dtype=jnp.int32)
        index = jnp.stack([jnp.zeros_like(fan), fan + 1, fan + 2])
        drawn = (fan[None, :] + 2 < num_corners[:, None]) & jnp.all(polygon[:, index, 3] > 0, axis=1)
        positive = jnp.where(polygon[..., 3:] > 0, polygon, 1.0)
        points = (tuple(v[:, index[k]].reshape(-1) for k in range(3)) for v in screen(positive, height, width))
        parts = tuple(points), jnp.repeat(ids, FAN), drawn.reshape(-1)
        return jax.tree.map(lambda v: jnp.pad(v, (0, group - polygons * FAN)), parts)

    def draw_group(state):
        index, pixels = state
        (x, y, depth), ids, drawn = lax.cond(index < whole_groups, whole_group, cut_group, index)
        area = winding(x, y)
        triangle = set_up(index < groups, x, y, depth, height, width)
        drawn = drawn & (area != 0) & (area * fetch(sides, ids) <= 0)
        drawn = drawn & (triangle.left <= triangle.right) & (triangle.top <= triangle.bottom)
        tiles = jnp.where(drawn, span(triangle.left, triangle.right) * span(triangle.top, triangle.bottom), 0)
        rows = pack(triangle, ids)
        return index + 1, draw_large(pixels, ahead, rows, tiles, window=window, height=height, width=width)

    # Derive the first pixels from the input, so that a device-varying input makes device-varying loops.
    zero = groups * 0
    ahead = pair(*map(tiled, seen)) if seen else None
    near, id = (jnp.full((down * across + 1, PIXELS), value, jnp.int32) + zero for value in (FARTHEST, NOBODY))
    pixels = lax.while_loop(lambda state: state[0] < groups, draw_group, (zero, pair(near, id)))[1]

    large_near, large_id = (picture(part, height, width) for part in unpair(pixels))
    stats = Stats(
        non_finite=jnp.sum((states == 0) & exists, dtype=jnp.int32),
        degenerate=jnp.sum(face_whole & (area == 0), dtype=jnp.int32),
        out_of_range=jnp.sum(~exists, dtype=jnp.int32),
    )

    def draw(drawn, near, finding_ids):
        return draw_small(drawn, near, seen, finding_ids, corners, order, first_large, chunk=chunk)

    def covered(near, values, nothing):
        return jnp.where(near > FARTHEST, values, nothing)

    if depth_only:
        near = lax.cond(first_large > 0, lambda: draw(large_near, large_near, False), lambda: large_near)
        return covered(near, near, 0), stats

    # Small triangles' depths first; their ids when all depths are known, and instead of those that they hid.
    def draw_phase(phase, state):
        near, id = state
        drawn = lax.cond(phase == 1, lambda: jnp.where(near == large_near, id, NOBODY), lambda: near)
        drawn = draw(drawn, near, phase == 1)
        return lax.cond(phase == 1, lambda: (near, drawn), lambda: (drawn, id))

    def finish(near, id):
        return covered(near, near, 0), covered(near, id, -1)

    near, id = lax.cond(
        first_large > 0,
        lambda: finish(*lax.fori_loop(zero, zero + 2, draw_phase, (large_near, large_id))),
        lambda: finish(large_near, large_id),
    )
    return near, id, stats


@functools.cache
def _core(height: int, width: int, depth_only: bool = False):
    """The compiled integer core for one picture size; batches run one after the other, in loops of their own length."""
    return jax.custom_batching.sequential_vmap(
        jax.jit(functools.partial(_nearest, height=height, width=width, depth_only=depth_only))
    )


@functools.cache
def _pictures(height: int, width: int, axes: int):
    """A picture of clip positions, or a batch with so many leading axes, compiled once."""

    def draw(clip, ahead, faces, sides, small):
        nearness, face, stats = _core(height, width)(lax.stop_gradient(clip), faces, sides, small, *ahead)
        weights, depth = barycentric(clip, faces, face)
        return Visibility(face=face, barycentric=weights, depth=depth, nearness=nearness, stats=stats)

    if axes == 0:
        return draw
    for _ in range(axes):
        draw = jax.vmap(draw, in_axes=(0, 0, None, None, None))
    return jax.jit(draw)


def _sides(name, cull, num_faces):
    """`cull` as a number per face: 1 drops its back, -1 its front, 0 neither."""
    if cull is None or isinstance(cull, str):
        names = {None: 0, "back": 1, "front": -1}
        if cull not in names:
            raise ValueError(f"{name}: cull must be None, 'back', 'front' or a bool array [f], got {cull!r}")
        return jnp.full((num_faces,), names[cull], jnp.int32)
    fit(f"{name}: cull", cull, Bool[Array, " f"], {"f": num_faces})
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
    for name, size in (("height", height), ("width", width)):
        if type(size) is not int or size < 1:
            raise ValueError(f"rasterize: {name} must be a whole number of at least 1, got {size!r} (close over it)")
    if max(height, width) > 2 * GUARD:
        raise ValueError(f"rasterize: {width} x {height} pixels exceed {2 * GUARD} on a side; draw it in parts")
    return _draw("rasterize", clip, faces, (), height, width, cull)


def peel(clip: Float[Array, "*b v 4"], faces: Int[Array, "f 3"], visibility: Visibility, *, cull=None) -> Visibility:
    """The next surface behind `visibility` at every pixel, which `rasterize` or this made of the same triangles.

    Exactly the fragments that lost: each is found once, in order of depth, those of equal depth in order of their ids;
    behind nothing there is nothing. Arguments, errors and gradients are those of `rasterize`.

    Example:
        >>> clip = jnp.array([[-1.0, -1, 0.5, 1], [3, -1, 0.5, 1], [-1, 3, 0.5, 1]])
        >>> clip, faces = jnp.concatenate([clip, clip * 2]), jnp.array([[0, 1, 2], [3, 4, 5]])
        >>> first = rasterize(clip, faces, height=1, width=1)
        >>> second = peel(clip, faces, first)
        >>> [int(layer.face[0, 0]) for layer in (first, second, peel(clip, faces, second))]
        [0, 1, -1]
    """
    sizes: dict[str, int] = {}
    for name in ("face", "nearness"):
        fit(f"peel: visibility.{name}", getattr(visibility, name), Int[Array, "*b h w"], sizes)
    *batch, height, width = visibility.face.shape
    if not batch == list(visibility.nearness.shape[:-2]) == list(clip.shape[:-2]):
        shapes = f"{list(visibility.face.shape)} of clip {list(clip.shape)}"
        raise ValueError(f"peel: visibility must be what rasterize made of clip, got {shapes}; draw it anew")
    return _draw("peel", clip, faces, (visibility.nearness, visibility.face), height, width, cull)


def _draw(name, clip, faces, ahead, height, width, cull):
    """Check and draw, what is behind the pixels `ahead` (nearness, face) or all of it."""
    fit(f"{name}: clip", clip, Float[Array, "*b v 4"])
    fit(f"{name}: faces", faces, Int[Array, "f 3"])
    below(f"{name}: faces", faces, clip.shape[-2], "vertices")
    clip, faces = jnp.asarray(clip), jnp.asarray(faces).astype(jnp.int32)
    if faces.shape[0] == 0 or clip.shape[-2] == 0:
        # Draw one triangle behind the camera, which no count counts: gathers from empty tables are not defined.
        clip = jnp.full((*clip.shape[:-2], 1, 4), -1.0, clip.dtype)
        faces, cull = jnp.zeros((1, 3), jnp.int32), None
    sides = _sides(name, cull, faces.shape[0])
    return _pictures(height, width, clip.ndim - 2)(clip, ahead, faces, sides, jnp.int32(SMALL))


def rasterize_depth(
    clip: Float[Array, "v 4"], faces: Int[Array, "f 3"], *, height: int, width: int
) -> Float[Array, "h w"]:
    """The depth alone that decided `rasterize`, of the snapped triangles: half the work, and all a shadow map needs.

    Gradient: none.
    """
    sides = jnp.zeros(faces.shape[0], jnp.int32)
    core = _core(height, width, depth_only=True)
    nearness, _ = core(lax.stop_gradient(clip), faces.astype(jnp.int32), sides, jnp.int32(SMALL))
    return lax.bitcast_convert_type(nearness, jnp.float32)
