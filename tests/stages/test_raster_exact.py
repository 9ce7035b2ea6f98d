"""Coverage without exception: every sample beside a shared edge has one owner, at any size and on either path."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from on_screen import (
    PATHS,
    circle,
    clip_of,
    depth_inside,
    draw,
    fan,
    first_and_last,
    graded,
    num_wrong,
    on_grid,
    pixels,
    ruled,
    same,
    split,
    with_w,
)
from reference import raster as twin

from jaxraster.visibility import fixed_point

EXTENT = 8192  # pixels from end to end of where corners lie
LARGE = 4096
NUM_SAMPLES = 2_000_000
ULP = 2.0**-24  # of float32 numbers below 1, at most
GRIDS = [None, 256, 1]  # corners anywhere, on 1/256 px, or on pixel centres
# The small path is for small triangles, so that it is forced where all of them are.
SQUARES = [(64, 64, path) for path in PATHS]
BANDS = [(*size, path) for size in ((37, 1000), (1000, 37)) for path in ("large", "mixed")]
MIDDLING = [(2048, 2048, path) for path in ("large", "mixed")]


def samples(grid):
    """Ends of random edges, and of each the pixel centre nearest to one of its points."""
    rng = np.random.default_rng(0)
    length = np.exp(rng.uniform(np.log(0.5), np.log(EXTENT), (NUM_SAMPLES, 1)))
    middle, half = rng.uniform(-EXTENT / 2, EXTENT / 2, (NUM_SAMPLES, 2)), rng.uniform(-0.5, 0.5, (NUM_SAMPLES, 2))
    ends = [np.clip(middle + side * half * length, -EXTENT / 2, EXTENT / 2) for side in (-1, 1)]
    a, b = (on_grid(end, grid).astype(np.float32) for end in ends)
    return a, b, (np.floor(a + (b - a) * rng.uniform(0, 1, (NUM_SAMPLES, 1))) + 0.5).astype(np.float32)


def ownership(a, b, sample, step):
    """Whether a→b has a sample on its inner side, decided `step` pixels away from it, as within a tile."""
    (ax, ay), (bx, by), (px, py) = (fixed_point.snap(v.T) for v in (a, b, sample - step.astype(jnp.float32)))
    first = fixed_point.pixels_inside(fixed_point.edge(ax, ay, bx, by, px, py), bx - ax, by - ay)
    return first - (by - ay) * step[:, 0] + (bx - ax) * step[:, 1] >= 0


def arithmetic(grid):
    """Number of samples that lie on their edge, whose side is not what 64 bits say, and with two owners or none."""
    a, b, sample = samples(grid)
    step = np.random.default_rng(1).integers(-3, 8, sample.shape).astype(np.int32)
    owns = jax.jit(lambda *where: ownership(*where))  # anew, for the rule may have changed
    forth, back = (np.asarray(owns(*ends, sample, step)) for ends in ((a, b), (b, a)))
    start, end, point = (np.round(v.astype(np.float64) * 256).astype(np.int64) for v in (a, b, sample))
    value, (dx, dy) = twin.edge(start, end, point), (end - start).T
    exact = (value > 0) | ((value == 0) & ((dy < 0) | ((dy == 0) & (dx > 0))))
    edge = (dx != 0) | (dy != 0)
    return tuple(int((wrong & edge).sum()) for wrong in (value == 0, forth != exact, forth == back))


@pytest.mark.parametrize("grid, least", [(None, 0), (256, 0), (1, 100)])
def test_arithmetic_gives_two_million_samples_to_one_side_of_their_edge(grid, least):
    ties, wrong, not_once = arithmetic(grid)
    assert (wrong, not_once) == (0, 0)
    assert ties >= least


@pytest.mark.slow
@pytest.mark.parametrize("grid, axis", [(None, 0), (256, 1), (1, 0)])
def test_two_million_samples_beside_long_edges_have_one_owner(grid, axis):
    corners = ruled(grid, LARGE, 512, tilt=40)
    first, last = first_and_last(corners[..., ::-1] if axis else corners, LARGE, LARGE)
    assert (first >= 0).all() and (first == last).all()
    # Where a line parts two neighbours, one of them is the sample nearest to it.
    assert (np.diff(first, axis=axis) != 0).sum() > NUM_SAMPLES


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("height, width, path", SQUARES + BANDS + MIDDLING)
def test_mesh_of_all_sizes_covers_every_pixel_once(height, width, path, grid):
    assert num_wrong(graded(grid, height, width), True, height, width, path) == 0


QUADS = {  # circumradius in halves of the picture, other diagonal, w of the corners
    "basic": (0.6, False, 1.0),
    "reversed": (0.6, True, 1.0),
    "clipped fully": (4.0, False, 1.0),
    "clipped fully by the guard band": (1e4, True, 1.0),
    "clipped partly": (1.3, False, 1.0),
    "projected": (0.9, False, (0.1, 4.0, 1.0, 0.4)),
}


@pytest.mark.parametrize("case", QUADS)
@pytest.mark.parametrize("height, width, path", SQUARES + BANDS + MIDDLING)
def test_quad_covers_every_pixel_once(height, width, path, case):
    """The five fill-rule cases of the OpenGL and Vulkan conformance suites, at many angles where pictures are small."""
    radius, flip, w = QUADS[case]
    half = np.array([width, height]) / 2
    for turn in np.linspace(0.05, 1.6, 15 if height == width == 64 else 1):
        quad = circle(4, radius * half, half + 0.5, turn)
        corners = split(with_w(quad, w)[[0, 1, 3, 2]].reshape(2, 2, 3), flip)
        must = depth_inside(quad, pixels(height, width)) > 1 / 256  # snapping moves an edge by less
        assert must.any() and must.all() == (radius >= 4)
        assert num_wrong(corners, must, height, width, path) == 0


FANS = [(*square, count) for square in SQUARES for count in (4, 16, 64, 256, 1024)]
FANS += [(*band, 64) for band in BANDS] + [(2048, 2048, "mixed", 256), (LARGE, LARGE, "mixed", 16)]


@pytest.mark.parametrize("radius", [1e5, 1e6, 1e7])
@pytest.mark.parametrize("height, width, path, count", FANS)
def test_closed_fan_about_a_pixel_centre_covers_every_pixel_once(height, width, path, count, radius):
    hub = np.array([width // 2 + 0.5, height // 3 + 0.5])
    assert num_wrong(fan(circle(count, radius, hub), hub), True, height, width, path) == 0


@pytest.mark.parametrize("path", ["large", "mixed"])
def test_a_hundred_triangles_that_fill_the_picture(path):
    """Each is the nearest along a stripe: their depths are tangents of a parabola over the picture's diagonal."""
    size, num = 2048, 100
    corners = np.stack([circle(3, 3000, (size / 2, size / 2), turn) for turn in range(num)])
    corners = on_grid(corners, 256)  # so that snapping moves no depth
    touch = np.random.default_rng(0).permutation(np.linspace(-1, 1, num))[:, None]

    def depth(diagonal):
        return 0.4 - 0.05 * touch**2 + 0.1 * touch * (diagonal / size - 1)

    clip = clip_of(corners, size, size, depth(corners.sum(axis=-1))).reshape(-1, 4)
    seen = draw(clip, np.arange(3 * num).reshape(num, 3), size, size, path)
    depths = depth(np.arange(1, 2 * size))
    second, first = np.sort(depths, axis=0)[-2:]
    place = np.add.outer(np.arange(size), np.arange(size))
    sure = (first - second > 8 * ULP)[place]
    assert (seen.face == np.argmax(depths, axis=0)[place])[sure].all()
    assert sure.mean() > 0.9 and len(np.unique(seen.face)) == num
    assert np.abs(seen.depth - first[place]).max() < 8 * ULP


@pytest.mark.slow
def test_one_triangle_that_fills_a_large_picture():
    corners = on_grid(circle(3, 1.5 * LARGE, (LARGE / 2, LARGE / 2)), 256)
    seen = draw(clip_of(corners, LARGE, LARGE, 0.5 + corners[:, 0] / 2**15), np.array([[0, 1, 2]]), LARGE, LARGE)
    assert (seen.face == 0).all()
    assert np.abs(seen.depth - (0.5 + (np.arange(LARGE) + 0.5) / 2**15)).max() < 8 * ULP


def star(far):
    """A fan whose edges run through pixel centres, every third rim corner `far` times as far from the hub."""
    directions = np.array([(x, y) for x in range(-4, 5) for y in range(-4, 5) if np.gcd(x, y) == 1])
    directions = directions[np.argsort(np.arctan2(directions[:, 1], directions[:, 0]))]
    reach = np.where(np.arange(len(directions)) % 3 == 0, 200 * far, 200)
    hub = np.array([32.5, 21.5])
    w = np.random.default_rng(0).uniform(0.1, 4, len(directions))
    return fan(with_w(hub + directions * reach[:, None], w), np.append(hub, 1.0))


@pytest.mark.parametrize("far", [1, 1000, 1e6])
@pytest.mark.parametrize("path", PATHS)
def test_edges_through_pixel_centres_have_one_owner_whether_or_not_a_neighbour_is_clipped(path, far):
    assert num_wrong(star(far), True, 64, 64, path) == 0


SCENES = [(64, 64, seed) for seed in range(200)]
SCENES += [(37, 1000, seed) for seed in range(4)] + [(1000, 37, seed) for seed in range(4)]
NUM_APART = 36  # triangles of a scene before its copies


def scene(seed, height, width):
    """Clip positions, faces and the grid of the corners: triangles from 0.3 px to three pictures, some of them joined.

    40 triangles: 24 apart, 8 that share corners with those, 4 slivers, and 4 that are there twice.
    """
    rng = np.random.default_rng(seed)
    grid = (1, 2, 256, None)[seed % 4]
    size = np.exp(rng.uniform(np.log(0.3), np.log(3 * max(height, width)), (28, 1, 1)))
    corners = rng.uniform(0, [width, height], (28, 1, 2)) + size * rng.normal(0, 0.5, (28, 3, 2))
    a, b, _ = corners[24:].swapaxes(0, 1)
    corners[24:, 2] = a + rng.uniform(0, 1, (4, 1)) * (b - a) + rng.normal(0, 0.5, (4, 2))
    points = on_grid(corners.reshape(-1, 2), grid)
    faces = np.concatenate([np.arange(84).reshape(28, 3), rng.integers(0, 84, (8, 3)), rng.integers(0, 84, (4, 3))])
    faces[NUM_APART:] = faces[: 40 - NUM_APART]
    points = with_w(points, np.exp(rng.uniform(-3, 3, len(points))))
    return clip_of(points, height, width, rng.uniform(0.05, 1, len(points))), faces, grid


@pytest.mark.parametrize("height, width, seed", SCENES)
def test_each_path_equals_the_integer_twin(height, width, seed):
    clip, faces, _ = scene(seed, height, width)
    points, depth = twin.snapped(clip, height, width)
    owner, nearest, _ = twin.rasterize(points, depth, faces, height, width)
    # Depths are float32: less than 8 ulp of a corner's depth apart, either of two triangles may win, save of copies.
    sure = nearest - twin.runner_up(points, depth, faces[:NUM_APART], owner) > 8 * ULP
    seen = draw(clip, faces, height, width)
    assert (seen.face == owner)[sure | (owner < 0)].all()
    assert sure.sum() >= 0.99 * (owner >= 0).sum() > 0
    assert ((seen.depth > 0) == (seen.face >= 0)).all()
    for path in PATHS if height == width else ("large",):
        assert same(draw(clip, faces, height, width, path), seen)


@pytest.mark.parametrize("seed", range(40))
def test_equals_double_precision_from_clip_space(seed):
    """Without snapping: 1/256 px away from edges, and 8 ulp from other depths, or 1 % where snapping moves them."""
    clip, faces, grid = scene(seed, 64, 64)
    faces = faces[:NUM_APART]
    owner, _, distance = twin.cast(clip, faces, 64, 64, gap=0.01 if grid is None else 8 * ULP)
    sure = distance > 1 / 256
    assert (draw(clip, faces, 64, 64).face == owner)[sure].all()
    assert sure.mean() > 0.9


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("seed", range(20))
def test_order_of_faces_vertices_and_corners_changes_no_bit(path, seed):
    clip, faces, _ = scene(seed, 64, 64)
    faces = faces[:NUM_APART]
    rng = np.random.default_rng(seed)
    first = draw(clip, faces, 64, 64, path)
    order, place = rng.permutation(len(faces)), rng.permutation(len(clip))
    moved = np.empty_like(clip)
    moved[place] = clip
    other = draw(moved, place[faces][order], 64, 64, path)
    assert (np.append(order, -1)[other.face] == first.face).all() and same(other, first, ("barycentric", "depth"))
    rotated = draw(clip, np.roll(faces, 1, axis=1), 64, 64, path)
    assert (rotated.face == first.face).all()
    # Two ulp of 1: the sum of the three edges is rounded in another order.
    assert np.abs(np.roll(rotated.barycentric, -1, axis=-1) - first.barycentric).max() <= 2 * 2.0**-23


@pytest.mark.parametrize("path", PATHS)
def test_exact_ties_go_to_the_lowest_id(path):
    rng = np.random.default_rng(0)
    corners = on_grid(rng.uniform(0, 64, (100, 1, 2)) + rng.normal(0, 12, (100, 3, 2)), 256)
    clip, faces = clip_of(corners, 64, 64).reshape(-1, 4), np.arange(300).reshape(100, 3)
    lowest = np.full((64, 64), -1)
    for number, box, inside, _ in reversed(list(twin.fragments(*twin.snapped(clip, 64, 64), faces, 64, 64))):
        lowest[box] = np.where(inside, number, lowest[box])
    assert (draw(clip, faces, 64, 64, path).face == lowest).all()
    assert (draw(clip, np.concatenate([faces] * 10), 64, 64, path).face == lowest).all()


@pytest.mark.slow
def test_a_fill_rule_that_is_off_by_one_is_noticed(monkeypatch):
    """With ties that belong to both sides of steep edges and to neither of flat ones, each kind of check fails."""
    right = fixed_point.pixels_inside

    def wrong(limbs, dx, dy):
        return right(limbs, 0 * dx, jnp.where(jnp.abs(dx) < jnp.abs(dy), -1, 1))

    for name, module in list(sys.modules.items()):
        if name.startswith("jaxraster.visibility") and hasattr(module, "pixels_inside"):
            monkeypatch.setattr(module, "pixels_inside", wrong)
    # A size of its own, so that nothing compiled with the right rule is found again.
    height, width = 63, 65
    hub = np.array([32.5, 21.5])
    for path in PATHS:
        for corners in (graded(1, height, width), fan(circle(4, 1e5, hub, turn=0.0), hub), star(1000)):
            first, last = first_and_last(corners, height, width, path)
            assert (first != last).any() and (first < 0).any()
    _, not_exact, not_once = arithmetic(1)
    assert not_exact > 100 and not_once > 100
