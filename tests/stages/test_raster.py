"""Visibility against its NumPy twin, and the promises a rasterizer makes at edges, planes and broken triangles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import raster as twin

from jaxraster.math.transform import perspective, transform_points
from jaxraster.visibility.raster import rasterize

HEIGHT, WIDTH = 37, 50
NUM_FACES = 40


@pytest.fixture(scope="module")
def draw():
    return jax.jit(lambda clip, faces: rasterize(clip, faces, height=HEIGHT, width=WIDTH))


@pytest.fixture(scope="module")
def coverage():
    """How many of the triangles, each drawn alone, cover each pixel."""

    def alone(clip, face):
        return rasterize(clip, face[None], height=HEIGHT, width=WIDTH).face == 0

    return jax.jit(lambda clip, faces: jnp.sum(jax.lax.map(lambda f: alone(clip, f), faces), axis=0, dtype=jnp.int32))


def screen(points, depth=0.5):
    """Clip positions (w = 1) of points in pixels from the top left; a float64 of x.5 hits a pixel's centre exactly."""
    points = np.asarray(points, np.float64)
    x, y = points[:, 0] * 2 / WIDTH - 1, 1 - points[:, 1] * 2 / HEIGHT
    depth = np.broadcast_to(depth, x.shape)
    return jnp.array(np.stack([x, y, depth, np.ones_like(x)], axis=-1), jnp.float32)


def random_scene(seed, snap=None, size=20.0):
    """Overlapping triangles of all sizes, on and off the picture; `snap` puts corners on a grid of 1/snap pixel."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-5, [[WIDTH + 5, HEIGHT + 5]], (NUM_FACES, 2))
    corners = centre[:, None, :] + rng.normal(0, 1, (NUM_FACES, 3, 2)) * rng.exponential(size, (NUM_FACES, 1, 1))
    if snap:
        corners = np.round(corners * snap) / snap
    depth = rng.uniform(0.01, 1, (NUM_FACES, 3)).reshape(-1)
    w = np.exp(rng.uniform(-3, 3, NUM_FACES * 3))[:, None]
    clip = np.asarray(screen(corners.reshape(-1, 2), depth)) * w.astype(np.float32)
    return jnp.array(clip), jnp.arange(3 * NUM_FACES, dtype=jnp.int32).reshape(-1, 3)


@pytest.mark.parametrize("seed", range(40))
def test_equals_the_integer_twin(draw, seed):
    clip, faces = random_scene(seed, snap=(None, 2, 256)[seed % 3], size=(1, 5, 20)[seed // 3 % 3])
    points, depth = twin.snapped(np.asarray(clip), HEIGHT, WIDTH)
    owner, nearest, _ = twin.rasterize(points, depth, np.asarray(faces), HEIGHT, WIDTH)
    visibility = draw(clip, faces)
    assert (np.asarray(visibility.face) == owner).all()
    assert len(np.unique(owner)) > 5
    # Depth is of the unsnapped triangle: away from it by what 1/256 px moves it.
    seen = owner >= 0
    assert np.abs(np.asarray(visibility.depth) - nearest)[seen].max() < 0.05
    assert np.median(np.abs(np.asarray(visibility.depth) - nearest)[seen]) < 1e-3


def test_twin_catches_a_wrong_rule(draw, monkeypatch):
    """The comparison is sharp: with the rule's tie on the other side some scene on pixel centres differs."""
    edge = twin.edge
    differs = False
    for seed in range(1, 12, 3):
        clip, faces = random_scene(seed, snap=2)
        points, depth = twin.snapped(np.asarray(clip), HEIGHT, WIDTH)
        monkeypatch.setattr(twin, "edge", lambda a, b, p: edge(a, b, p) - (p.ndim > 1))
        owner, _, _ = twin.rasterize(points, depth, np.asarray(faces), HEIGHT, WIDTH)
        monkeypatch.setattr(twin, "edge", edge)
        differs = differs or (np.asarray(draw(clip, faces).face) != owner).any()
    assert differs


@pytest.mark.parametrize("seed", range(12))
def test_triangles_through_the_camera_plane(draw, seed):
    """Corners beside, behind and far outside the camera: as cast in double precision, except beside a decision."""
    rng = np.random.default_rng(seed)
    world = rng.normal(0, 3, (3 * NUM_FACES, 3)) * rng.choice([0.3, 1, 30], (3 * NUM_FACES, 1))
    clip = transform_points(perspective(1.0, 0.1, 100.0), jnp.array(world, jnp.float32))
    faces = jnp.arange(3 * NUM_FACES, dtype=jnp.int32).reshape(-1, 3)
    owner, _, distance = twin.cast(np.asarray(clip), np.asarray(faces), HEIGHT, WIDTH)
    visibility = draw(clip, faces)
    sure = distance > 2 / 256
    assert (np.asarray(visibility.face) == owner)[sure].all()
    assert sure.mean() > 0.5 and (owner >= 0).mean() > 0.5
    assert ((np.asarray(visibility.depth) > 0) == (np.asarray(visibility.face) >= 0)).all()


def test_drtk_quad_has_no_hole(coverage):
    """Each pixel of the quad belongs to one of its triangles, in every order (DRTK's issue 9)."""
    left, right, top, low = 0.5, 6.50006103515625, 0.49993896484375, 6.5
    corners = np.array([[left, top], [left, low], [right, top], [right, low]])
    for a in ((0, 1, 2), (1, 2, 0), (2, 1, 0)):
        for b in ((3, 2, 1), (2, 1, 3), (1, 2, 3)):
            count = np.asarray(coverage(screen(corners + 0.5), jnp.array([a, b], jnp.int32)))
            assert (count[1:7, 1:7] == 1).all() and count.max() == 1


@pytest.mark.parametrize("radius", [20.0, 2e3, 1e5, 1e6, 1e7])
@pytest.mark.parametrize("hub", [(20.5, 17.5), (20.3, 17.9)])
def test_closed_fan_covers_every_pixel_once(coverage, radius, hub):
    """A fan whose hub lies on a pixel's centre or beside it, its rim on the picture or ten million pixels off."""
    count = 16
    angle = np.arange(count) * 2 * np.pi / count + 0.123
    rim = np.array(hub) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    clip = screen(np.concatenate([[hub], rim]))
    faces = np.stack([np.zeros(count, int), 1 + np.arange(count), 1 + (np.arange(count) + 1) % count], axis=-1)
    covered = np.asarray(coverage(clip, jnp.array(faces, jnp.int32)))
    assert covered.max() == 1
    if radius > 100:
        assert covered.min() == 1


def test_strip_through_the_near_plane_has_no_crack(coverage):
    """Neighbours cut by the same plane get the same new corner on their shared edge."""
    rng = np.random.default_rng(0)
    for _ in range(8):
        angle, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.5)
        grid = np.stack(np.meshgrid(np.linspace(-40, 40, 5), np.linspace(-40, 40, 5)), axis=-1).reshape(-1, 2)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        x, z = (grid @ turn).T
        world = np.stack([x, -0.3 + tilt * z, z], axis=-1)
        clip = transform_points(perspective(1.2, 0.5, np.inf), jnp.array(world, jnp.float32))
        cell = np.array([0, 1, 2, 3]).repeat(4) + 5 * np.tile([0, 1, 2, 3], 4)
        faces = np.concatenate([[[c, c + 1, c + 6], [c, c + 6, c + 5]] for c in cell])
        count = np.asarray(coverage(clip, jnp.array(faces, jnp.int32)))
        _, _, distance = twin.cast(np.asarray(clip), np.array([[0, 4, 24], [0, 24, 20]]), HEIGHT, WIDTH)
        assert count.max() == 1
        # Within the sheet's outline no pixel is left out; its diagonal is no decision here.
        whole = twin.cast(np.asarray(clip), faces, HEIGHT, WIDTH)[0] >= 0
        assert (count[whole & (distance > 2 / 256)] == 1).all()


def test_order_of_faces_and_corners_changes_nothing(draw):
    clip, faces = random_scene(7)
    first = draw(clip, faces)
    order = np.random.default_rng(1).permutation(NUM_FACES)
    shuffled = draw(clip, faces[order])
    back = np.append(order, -1)[np.asarray(shuffled.face)]
    assert (back == np.asarray(first.face)).all()
    assert (np.asarray(shuffled.depth) == np.asarray(first.depth)).all()
    rotated = draw(clip, jnp.roll(faces, 1, axis=1))
    assert (np.asarray(rotated.face) == np.asarray(first.face)).all()
    assert np.abs(np.roll(np.asarray(rotated.barycentric), -1, axis=-1) - np.asarray(first.barycentric)).max() < 3e-7


def test_ties_go_to_the_lower_id(draw):
    clip, faces = random_scene(3)
    doubled = draw(clip, jnp.concatenate([faces[:20], faces[:20]]))
    assert int(doubled.face.max()) < 20 and int(doubled.face.max()) >= 0
    swapped = draw(clip, jnp.concatenate([faces[:20][::-1], faces[:20]]))
    assert (np.asarray(doubled.depth) == np.asarray(swapped.depth)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1.9e18])
@pytest.mark.parametrize("component", range(4))
def test_broken_triangle_changes_nothing_and_is_counted(draw, bad, component):
    clip, faces = random_scene(5)
    without = draw(clip, faces.at[4].set(0))
    broken = draw(clip.at[13, component].set(bad), faces)
    assert (np.asarray(broken.face) == np.asarray(without.face)).all()
    assert np.isfinite(np.asarray(broken.barycentric)).all() and np.isfinite(np.asarray(broken.depth)).all()
    assert int(broken.stats.non_finite) == 1 and int(without.stats.non_finite) == 0
    assert int(without.stats.degenerate) == 1


def test_unreferenced_broken_vertex_changes_nothing(draw):
    clip, faces = random_scene(5)
    used = jnp.where(faces == 13, 12, faces)
    assert (draw(clip, used).face == draw(clip.at[13].set(jnp.nan), used).face).all()
    assert int(draw(clip.at[13].set(jnp.nan), used).stats.non_finite) == 0


def test_culling_by_side_and_by_face():
    clip, faces = random_scene(9)

    def draw(faces, cull):
        return np.asarray(rasterize(clip, faces, height=HEIGHT, width=WIDTH, cull=cull).face)

    points, depth = twin.snapped(np.asarray(clip), HEIGHT, WIDTH)
    front = twin.edge(*(points[np.asarray(faces)[:, i]] for i in range(3))) < 0
    for cull, kept in (("back", front), ("front", ~front), (jnp.array(np.arange(NUM_FACES) % 2 == 0), None)):
        kept = front | (np.arange(NUM_FACES) % 2 == 1) if kept is None else kept
        alone = np.where(kept[:, None], np.asarray(faces), 0)
        owner, _, _ = twin.rasterize(points, depth, alone, HEIGHT, WIDTH)
        assert (draw(faces, cull) == owner).all()
    assert front.any() and (~front).any()


def test_counter_clockwise_is_the_front():
    clip = jnp.array([[-1, -1, 0.5, 1], [1, -1, 0.5, 1], [0, 1, 0.5, 1]], jnp.float32)
    for faces, seen in (([[0, 1, 2]], 0), ([[0, 2, 1]], -1)):
        assert int(rasterize(clip, jnp.array(faces), height=8, width=8, cull="back").face.max()) == seen


def test_screen_parallel_planes_four_ulp_apart_are_ordered():
    """Reversed float32 depth, near 0.1 and far 1000: the nearer of two planes wins from 1 to 900 units, either way."""
    for distance in (1.0, 10.0, 100.0, 900.0):
        near_depth = np.float32(0.1 * (1000 - distance) / (999.9 * distance))
        far_depth = near_depth
        for _ in range(4):
            far_depth = np.nextafter(far_depth, np.float32(0))
        square = np.array([[-3, -3], [90, -7], [-9, 80], [80, 85]], float) + 0.13
        clip = jnp.concatenate([screen(square, far_depth), screen(square * 0.9 + 0.3, near_depth)]) * distance
        faces = jnp.array([[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]], jnp.int32)
        face = np.asarray(rasterize(clip, faces, height=HEIGHT, width=WIDTH).face)
        assert (face >= 2).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 257), (3, 5)])
def test_odd_sizes_and_empty_scenes(shape):
    height, width = shape
    clip = jnp.array([[-1, -1, 0.5, 1], [3, -1, 0.5, 1], [-1, 3, 0.5, 1]], jnp.float32)
    full = rasterize(clip, jnp.array([[0, 1, 2]]), height=height, width=width)
    assert full.face.shape == shape and (full.face == 0).all()
    for corners in (clip, jnp.zeros((0, 4))):
        empty = rasterize(corners, jnp.zeros((0, 3), jnp.int32), height=height, width=width)
        assert (empty.face == -1).all() and (empty.depth == 0).all() and (empty.barycentric == 0).all()


def test_far_plane_and_beyond_are_not_drawn():
    clip = perspective(1.0, 0.1, 10.0)
    for z, seen in ((-9.99, True), (-10.01, False), (-0.11, True), (-0.09, False)):
        corners = transform_points(clip, jnp.array([[-50, -50, z], [50, -50, z], [0, 50, z]], jnp.float32))
        assert bool((rasterize(corners, jnp.array([[0, 1, 2]]), height=4, width=4).face >= 0).any()) == seen


def test_batches_equal_one_by_one(draw):
    clips, faces = zip(*(random_scene(seed) for seed in (1, 2, 3)))
    clip = jnp.stack(clips)
    mapped = jax.jit(jax.vmap(lambda c: rasterize(c, faces[0], height=HEIGHT, width=WIDTH)))(clip)
    leading = rasterize(clip, faces[0], height=HEIGHT, width=WIDTH)
    both = jax.vmap(lambda c, f: rasterize(c, f, height=HEIGHT, width=WIDTH))(clip, jnp.stack(faces))
    for i in range(3):
        single = draw(clip[i], faces[0])
        for batch in (mapped, leading, both):
            assert (batch.face[i] == single.face).all()
            # Other programs round otherwise; corners' w differ by up to e⁶ here.
            assert jnp.abs(batch.barycentric[i] - single.barycentric).max() <= 2e-5
            assert (batch.stats.degenerate[i] == single.stats.degenerate).all()


def test_scaling_by_powers_of_two_changes_no_bit(draw):
    clip, faces = random_scene(11)
    reference = draw(clip, faces)
    for exponent in (-40, 40):
        scaled = draw(clip * 2.0**exponent, faces)
        for name in ("face", "depth", "barycentric"):
            assert (getattr(scaled, name) == getattr(reference, name)).all()


BAD_CALLS = [
    ({"clip": np.zeros((3, 3), np.float32)}, ValueError, r"clip must be float \[..., v, 4\], got float32 \[3, 3\]"),
    ({"clip": np.zeros((4, 4), np.int32)}, TypeError, r"clip must be float .*, got int32 \[4, 4\]"),
    ({"faces": np.zeros((3, 1), np.int32)}, ValueError, r"faces must be int \[f, 3\], got int32 \[3, 1\]"),
    ({"faces": np.zeros((1, 3), np.float32)}, TypeError, r"faces must be int \[f, 3\], got float32"),
    ({"cull": "both"}, ValueError, r"cull must be None, 'back', 'front' or a bool array \[f\], got 'both'"),
    ({"width": 0}, ValueError, r"width must be a whole number of at least 1, got 0"),
    ({"height": 2.5}, ValueError, r"height must be a whole number of at least 1, got 2.5"),
]


@pytest.mark.parametrize("change, kind, message", BAD_CALLS)
def test_bad_arguments_are_named(change, kind, message):
    call = {"clip": np.zeros((3, 4), np.float32), "faces": np.zeros((1, 3), np.int32), "height": 4, "width": 4} | change
    with pytest.raises(kind, match=message):
        # Past the type checker of these tests, which users do not have.
        call_it = getattr(rasterize, "__wrapped__", rasterize)
        call_it(jnp.array(call.pop("clip")), jnp.array(call.pop("faces")), **call)
