"""Hard inputs of the rasterizer for which no other test stands; docs/hard-cases.md names the tests of all."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_case import case
from on_screen import NUM_FACES, clip_of, draw, graded, on_grid, ruled, same
from reference import raster as twin

from jaxraster.math.pair import pair, unpair
from jaxraster.visibility import raster
from jaxraster.visibility.barycentric import LIMIT
from jaxraster.visibility.fixed_point import GUARD, SUBPIXELS
from jaxraster.visibility.large import draw_large, pack
from jaxraster.visibility.raster import rasterize, rasterize_depth
from jaxraster.visibility.small import draw_small
from jaxraster.visibility.tiles import FARTHEST, NOBODY, PIXELS, grid, picture, span
from jaxraster.visibility.triangle import set_up

HEIGHT, WIDTH = 32, 64
SIZE = {"height": HEIGHT, "width": WIDTH}
NORMAL = 2.0**-126  # the least float32 that is not flushed to 0
PROPER = np.array([[2.3, 1.7], [50.2, 9.1], [11.4, 30.6]])
TWO = np.array([[0, 1, 2], [3, 4, 5]], np.int32)


@jax.jit
@jax.value_and_grad
def slope(clip):
    """A sum of all that is differentiable of two triangles, for its gradient."""
    seen = rasterize(clip, jnp.asarray(TWO), **SIZE)
    weights = np.random.default_rng(0).uniform(0.5, 1.5, (HEIGHT, WIDTH, 3)).astype(np.float32)
    return jnp.sum(weights * seen.barycentric) + jnp.sum(weights[..., 0] * seen.depth)


def beside_a_proper_one(clip):
    """What is seen of a triangle beside a proper one, and the gradients of the corners of both."""
    clip = np.concatenate([clip_of(PROPER, HEIGHT, WIDTH), np.asarray(clip, np.float32)])
    seen, gradient = draw(clip, TWO, HEIGHT, WIDTH), np.asarray(slope(clip)[1])
    assert np.isfinite(seen.barycentric).all() and np.isfinite(seen.depth).all() and np.isfinite(gradient).all()
    return seen, gradient


NOWHERE = np.full((3, 4), np.nan)


@case("R4", "a corner whose w is 0, negative or next to 0", "the visible part is drawn; weights, gradients are finite")
@pytest.mark.parametrize("w", [0.0, -0.0, 1e-30, -1e-30, 1e-39, -1e-39, -1.0, -1e6])  # of either size and sign
def test_a_corner_about_the_plane_of_the_camera_is_cut_off(w):
    clip = np.array([[0.3, 0.4, 0.1, w], [-0.9, -0.7, 0.1, 1.0], [0.8, -0.5, 0.1, 1.2]], np.float32)
    beside_a_proper_one(clip)
    faces = np.array([[0, 1, 2]])
    owner, _, distance = twin.cast(clip, faces, HEIGHT, WIDTH)
    seen, sure = draw(clip, faces, HEIGHT, WIDTH), distance > 2 / 256
    assert (seen.face == owner)[sure].all() and (seen.face == 0).sum() > 100 and sure.mean() > 0.9


DEGENERATE = {  # corners in pixels, and whether they are counted as without area
    "one point": ([[9.5, 9.5]] * 3, True),
    "two corners in one place": ([[9.5, 9.5], [9.5, 9.5], [30.5, 20.5]], True),
    "a line through pixel centres": ([[3.0, 3.0], [10.0, 10.0], [20.0, 20.0]], True),
    "a line back and forth": ([[3.0, 3.5], [40.0, 3.5], [20.0, 3.5]], True),
    "an area of 1e-12 px²": ([[9.5, 9.5], [9.500001, 9.5], [9.5, 9.500002]], True),
    "a sliver of less than half a step": ([[3.0, 8.0], [60.0, 8.0], [60.0, 8.001]], True),
    "a sliver between samples": ([[3.1, 3.1], [20.1, 3.1], [20.1, 3.2]], False),
}


@case(
    "R6",
    "triangles without area, or thinner than a sample",
    "no pixel, no NaN, gradients kept; those without area counted",
)
@pytest.mark.parametrize("name", DEGENERATE)
def test_a_triangle_without_area_changes_nothing_and_is_counted(name):
    corners, counted = DEGENERATE[name]
    seen, gradient = beside_a_proper_one(clip_of(np.array(corners), HEIGHT, WIDTH, depth=0.9))
    alone, kept = beside_a_proper_one(NOWHERE)
    assert same(seen, alone) and (gradient == kept).all() and (kept[:3] != 0).any()
    assert seen.stats.degenerate == NUM_FACES - 2 + counted


@case(
    "R8", "coordinates of 1.844e18 and just below", "below the limit drawn as it is; at the limit left out and counted"
)
def test_the_limit_of_coordinates_is_sharp():
    limit = np.float32(LIMIT)
    square, faces = (
        np.array([[-1, -1, 0.5, 1], [1, -1, 0.5, 1], [1, 1, 0.5, 1], [-1, 1, 0.5, 1]]),
        [[0, 1, 2], [0, 2, 3]],
    )
    usual, below, at = (
        draw((square * scale).astype(np.float32), faces, HEIGHT, WIDTH)
        for scale in (1.0, np.nextafter(limit, np.float32(0)), limit)
    )
    assert (below.face == usual.face).all() and (usual.face >= 0).all()
    assert np.abs(below.barycentric - usual.barycentric).max() <= 2.0**-22
    assert (at.face == -1).all() and below.stats.non_finite == 0 and at.stats.non_finite == 2


@case(
    "R11", "depths down to the least float, 0, -0 and negative", "ordered as numbers; 0 and less, and denormals, unseen"
)
def test_depths_are_ordered_as_numbers():
    seen = [NORMAL, 2 * NORMAL, 1e-30, 1e-10, 0.1, 0.5, np.nextafter(np.float32(0.5), np.float32(1)), 1.0]  # any sizes
    unseen = [-1.0, -1e-30, -0.0, 0.0, 1e-45, NORMAL / 2]  # denormals are flushed to 0 by XLA on processors
    depth = np.float32([*unseen, *seen])
    order = np.random.default_rng(0).permutation(len(depth))
    cover = np.broadcast_to([[-9.0, -9.0], [150.0, -9.0], [-9.0, 150.0]], (len(depth), 3, 2))
    faces = np.arange(3 * len(depth)).reshape(-1, 3)
    for left in range(len(depth) + 1):
        values = np.where(order < left, depth[order], 0)
        picture = draw(clip_of(cover, HEIGHT, WIDTH, values[:, None]).reshape(-1, 4), faces, HEIGHT, WIDTH)
        assert (picture.face == (np.argmax(values) if left > len(unseen) else -1)).all(), left


@case("R12", "face ids about 2²⁴ and 2³¹", "they come out as they went in, from either path")
@pytest.mark.parametrize("first", [2**24 - 2, 2**31 - 7])
def test_large_ids_stay_whole(first):
    ids = first + jnp.arange(5, dtype=jnp.int32)
    corners = np.array([[0.2, 0.3], [9.8, 0.4], [0.1, 9.9]]) + np.arange(5)[:, None, None] * [12, 4]
    x, y = (tuple(jnp.array(v.T, jnp.int32)) for v in np.moveaxis(corners - [WIDTH / 2, HEIGHT / 2], -1, 0) * SUBPIXELS)
    depth = (jnp.full(5, 0.5),) * 3
    nothing = (FARTHEST, NOBODY)

    @jax.jit
    def large(ids):
        down, across = grid(HEIGHT, WIDTH)
        near, id = (jnp.full((down * across + 1, PIXELS), value, jnp.int32) for value in nothing)
        box = set_up(ids[0] > 0, x, y, depth, HEIGHT, WIDTH)
        tiles = span(box.left, box.right) * span(box.top, box.bottom)
        pixels = draw_large(pair(near, id), None, pack(box, ids), tiles, window=64, height=HEIGHT, width=WIDTH)
        return picture(unpair(pixels)[1], HEIGHT, WIDTH)

    @jax.jit
    def small(ids):
        def of(ids):
            return jax.tree.map(lambda v: v[ids - first], (x, y, depth))

        near, id = (jnp.full((HEIGHT, WIDTH), value, jnp.int32) for value in nothing)
        near = draw_small(near, near, (), jnp.bool(False), of, ids, jnp.int32(5), chunk=16)
        return draw_small(id, near, (), jnp.bool(True), of, ids, jnp.int32(5), chunk=16)

    for path in (large, small):
        assert set(np.unique(path(ids))) == {*np.asarray(ids).tolist(), NOBODY}, path


@case(
    "R13", "more pixels on a side than fixed-point positions reach", "refused in one line before anything is compiled"
)
def test_a_picture_beyond_the_guard_band_is_refused():
    for size in ((2 * GUARD + 1, 1), (1, 2 * GUARD + 1), (2**20, 2**20)):
        with pytest.raises(ValueError, match=f"{size[1]} x {size[0]} pixels exceed {2 * GUARD} on a side"):
            rasterize(jnp.zeros((3, 4)), jnp.zeros((1, 3), jnp.int32), height=size[0], width=size[1])


@case(
    "R13",
    "as many triangles, each over all of a large picture",
    "their pairs with tiles are counted below 2³¹",
)
def test_pairs_of_a_group_never_reach_31_bits(monkeypatch):
    size, num, most = 2 * GUARD, raster.GROUP, []

    def count(pixels, *rest, **options):
        rows = next(table for table in rest if table is not None)
        most.append(len(rows) * math.prod(grid(size, size)))
        return pixels

    monkeypatch.setattr(raster, "draw_large", count)
    shapes = [((3 * num, 4), jnp.float32), ((num, 3), jnp.int32), ((num,), jnp.int32), ((), jnp.int32)]
    draw_all = functools.partial(raster._nearest, height=size, width=size, depth_only=False)
    jax.eval_shape(draw_all, *(jax.ShapeDtypeStruct(*shape) for shape in shapes))
    assert most and max(most) < 2**31


@case("R16", "coordinates and w of 1e-39, which processors flush to 0", "nothing of it is drawn, nothing else changes")
@pytest.mark.parametrize("scale", [1e-39, 1e-42, 1e-45])  # all below the least normal float
def test_a_triangle_of_denormals_changes_nothing(scale):
    clip = (clip_of(PROPER[::-1], HEIGHT, WIDTH, depth=0.9).astype(np.float64) * scale).astype(np.float32)
    assert (np.abs(clip) < NORMAL).all() and (clip != 0).any()
    (seen, gradient), (alone, kept) = beside_a_proper_one(clip), beside_a_proper_one(NOWHERE)
    assert same(seen, alone) and (gradient == kept).all()


@case("R19", "slivers whose winding could flip when snapped", "the depth alone and the picture draw the same triangles")
@pytest.mark.parametrize("cells", [12, 22])
@pytest.mark.parametrize("step", [None, 256, 1])
def test_depth_alone_covers_what_the_picture_covers(cells, step):
    rng = np.random.default_rng(cells)
    shapes = [ruled(step, WIDTH, 40, 3.0), graded(step, HEIGHT, WIDTH, cells)]
    corners = np.concatenate(shapes)[:NUM_FACES]
    corners = corners[rng.uniform(size=len(corners)) < 0.5]
    corners = np.where(rng.uniform(size=(len(corners), 1, 1)) < 0.3, on_grid(corners, 256), corners)
    clip = clip_of(corners, HEIGHT, WIDTH, rng.uniform(0.1, 1, (len(corners), 3))).reshape(-1, 4)
    faces = np.arange(len(clip)).reshape(-1, 3)
    seen = draw(clip, faces, HEIGHT, WIDTH)
    spare = jnp.full((3 * NUM_FACES - len(clip), 4), 1.0)
    faces = np.concatenate([faces, np.zeros((NUM_FACES - len(faces), 3), int)]).astype(np.int32)
    depth = np.asarray(rasterize_depth(jnp.concatenate([clip, spare]), jnp.array(faces), **SIZE))
    assert ((depth > 0) == (seen.face >= 0)).all() and 0.2 < (depth > 0).mean() < 1
