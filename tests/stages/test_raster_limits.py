"""No number and no size that breaks the rasterizer, and depths that are told apart to their last bits."""

import numpy as np
import pytest
from on_screen import PATHS, clip_of, draw, draw_each, graded, with_w
from reference import raster as twin


@pytest.mark.slow
@pytest.mark.parametrize("path", PATHS)
def test_a_million_triangles_in_one_pixel(path):
    """Corners anywhere in pixel (20, 30), a depth for every two triangles: the nearest about its centre is seen."""
    rng = np.random.default_rng(0)
    num = 2**20
    corners = np.array([20, 30]) + rng.integers(0, 257, (num, 3, 2)) / 256
    depth = (rng.permutation(num) // 2 + 1) / (num // 2 + 1)
    clip = clip_of(corners, 64, 64, depth[:, None]).reshape(-1, 4)
    points, depth = twin.snapped(clip, 64, 64)
    a, b, c = points.reshape(num, 3, 2).swapaxes(0, 1)
    centre = np.array([(20 - 32) * 256 + 128, (30 - 32) * 256 + 128])
    edges = np.stack([twin.edge(a, b, centre), twin.edge(b, c, centre), twin.edge(c, a, centre)])
    inside = (edges > 0).all(axis=0) | (edges < 0).all(axis=0)
    # On an edge the fill rule decides: leave those triangles out.
    kept = np.flatnonzero(inside | ~(edges == 0).any(axis=0))
    here = np.where(inside, depth.reshape(num, 3)[:, 0], 0)[kept]
    faces = np.arange(3 * num).reshape(num, 3)[kept]
    assert len(faces) > 1_000_000
    seen = draw(clip, faces, 64, 64, path)
    assert seen.face[30, 20] == np.argmax(here) and 0.1 < inside.mean() < 0.9
    assert (seen.face >= 0).sum() == 1 and (seen.depth > 0).sum() == 1


DISTANCES = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 900.0)


def at_distance(corners, distance):
    """Clip positions of points in pixels as a camera with its near plane at 0.1 and the far at 1000 sees them."""
    distance = np.broadcast_to(distance, corners.shape[:-1])
    return clip_of(corners, 64, 64, 0.1 * (1000 - distance) / (999.9 * distance)) * np.float32(distance)[..., None]


def nearer(clip, num_ulp):
    """Clip positions whose z is that many ulp greater."""
    clip = clip.copy()
    for _ in range(num_ulp):
        clip[..., 2] = np.nextafter(clip[..., 2], np.float32(np.inf))
    return clip


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("distance", DISTANCES)
def test_planes_parallel_to_the_screen_four_ulp_apart_are_ordered(distance, path):
    """Of two meshes with nothing in common but the depth of each, the nearer is seen on every pixel."""
    meshes = [at_distance(graded(grid, 64, 64, cells=12), distance) for grid in (1, None)]
    assert len(np.unique(np.concatenate(meshes)[..., 2:], axis=None)) == 2
    faces = np.arange(6 * len(meshes[0])).reshape(-1, 3)
    for near in (0, 1):
        clip = np.concatenate([nearer(mesh, 4 * (i == near)) for i, mesh in enumerate(meshes)])
        face = draw(clip.reshape(-1, 4), faces, 64, 64, path).face
        assert (face // len(meshes[0]) == near).all()


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("distance", DISTANCES)
def test_slanted_triangles_eight_ulp_apart_are_ordered(distance, path):
    """Of two copies of a mesh whose corners' z differ by 8 ulp each, the nearer is seen on every pixel.

    The corners lie up to 3 % of the distance before and behind it, so that a triangle's depths differ by at most two.
    """
    corners = graded(None, 64, 64, cells=12)
    # The depth is a function of the place: corners that meet stay together.
    slant = 1 + 0.03 * np.sin(corners[..., 0] / 9 + corners[..., 1] / 7)
    mesh = at_distance(corners, distance * slant)
    depth = mesh[..., 2] / mesh[..., 3]
    assert 1.01 < (depth.max(axis=1) / depth.min(axis=1)).max() < 2
    faces = np.arange(6 * len(mesh)).reshape(-1, 3)
    for near in (0, 1):
        clip = np.concatenate([nearer(mesh, 8 * (i == near)) for i in (0, 1)])
        face = draw(clip.reshape(-1, 4), faces, 64, 64, path).face
        assert (face // len(mesh) == near).all()


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("scale", [1.0, 1e-10, 1e-20])
def test_depth_is_above_zero_exactly_where_a_face_is_seen(scale, path):
    """100 triangles, each alone in its picture, that pass through the far plane along a row of pixel centres."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(0, [32, 24], (100, 1, 2)) + rng.normal(0, 20, (100, 3, 2))
    w = rng.uniform(0.1, 1, (100, 3))
    clip = clip_of(with_w(corners, w), 24, 32, (corners[..., 1] - 12.5) / 128 * scale)
    seen = draw_each(clip, [[0, 1, 2]], 24, 32, path)
    assert ((seen.depth > 0) == (seen.face >= 0)).all()
    assert (seen.depth[seen.face < 0] == 0).all() and (seen.face >= 0).mean() > 0.05
