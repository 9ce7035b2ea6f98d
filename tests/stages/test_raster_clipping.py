"""Triangles about the camera's plane and beyond the guard band: cut where NumPy cuts them, and without a crack."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from on_screen import PATHS, draw, draw_each, fan, first_and_last, same, split
from reference import raster as twin

from jaxraster.visibility.clip import clip_polygon, plane_distances
from jaxraster.visibility.raster import rasterize

SIZE = 64
NEAR = 0.5
NUM_SHEETS = 1000
HEIGHT, WIDTH = 24, 32  # of the sheets' pictures


def seen_from(points):
    """Float32 clip positions of points of view space, 90° wide and without a far plane."""
    x, y, z = np.moveaxis(np.asarray(points, np.float64), -1, 0)
    return np.stack([x, y, np.full_like(x, NEAR), -z], axis=-1).astype(np.float32)


TOUCHING = {  # how many corners lie how far behind the camera
    "anywhere": (0, 0.0),
    "a corner in the camera's plane": (1, 0.0),
    "an edge in the camera's plane": (2, 0.0),
    "a corner in the near plane": (1, -NEAR),
    "an edge in the near plane": (2, -NEAR),
}


def about_the_camera(corners, depth):
    """100 triangles before, behind and around the camera."""
    rng = np.random.default_rng(0)
    points = rng.normal(0, 1, (100, 3, 3)) * np.exp(rng.uniform(-1, 2, (100, 1, 1))) - [0, 0, NEAR]
    points[:, :corners, 2] = depth
    return seen_from(points)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("touching", TOUCHING)
def test_triangles_about_the_camera_equal_what_is_cut_beforehand(touching, path):
    clip = about_the_camera(*TOUCHING[touching])
    seen = draw_each(clip, [[0, 1, 2]], HEIGHT, WIDTH, path)
    # Half the depth, so that nothing is left to cut.
    cut = np.float32([twin.cut(corners) for corners in clip]) * np.float32([1, 1, 0.5, 1])
    before = draw_each(cut, [[0, 1, 2], [0, 2, 3]], HEIGHT, WIDTH, path)
    sure = np.stack([twin.cast(c, np.array([[0, 1, 2]]), HEIGHT, WIDTH)[2] for c in clip]) > 1 / 256
    covered = seen.face >= 0
    assert (covered == (before.face >= 0))[sure].all()
    np.testing.assert_allclose(seen.depth[sure], 2 * before.depth[sure], rtol=1e-4)
    assert ((seen.depth > 0) == covered).all()
    assert sure.mean() > 0.99 and covered.any(axis=(1, 2)).sum() > 10


def test_triangles_behind_the_near_plane_are_not_seen():
    rng = np.random.default_rng(0)
    points = rng.normal(0, 1, (100, 3, 3))
    points[..., 2] = np.abs(points[..., 2]) - 0.999 * NEAR
    assert (draw_each(seen_from(points), [[0, 1, 2]], HEIGHT, WIDTH).face < 0).all()


def test_triangles_in_the_near_plane_are_seen_whole():
    clip = seen_from(np.random.default_rng(0).normal(0, 1, (100, 3, 3)) * [1, 1, 0] - [0, 0, NEAR])
    seen = draw_each(clip, [[0, 1, 2]], HEIGHT, WIDTH)
    beyond = draw_each(clip * np.float32([1, 1, 0.5, 1]), [[0, 1, 2]], HEIGHT, WIDTH)
    assert (seen.face == beyond.face).all() and (seen.face >= 0).mean() > 0.1
    assert (seen.depth == (seen.face >= 0)).all()


def sheets():
    """Sheets of 4 x 4 cells at random angles to the camera's plane, and how far each pixel lies inside of them.

    A sheet's point (u, v) in [-1, 1]² has homogeneous pixels H (u, v, 1), so that a pixel's (u, v, 1) / w is H⁻¹ times
    it: the sheet's four sides and the near plane are linear in the pixel.
    """
    rng = np.random.default_rng(0)
    axes, _ = np.linalg.qr(rng.normal(size=(NUM_SHEETS, 3, 3)))
    extent = np.exp(rng.uniform(np.log(2), np.log(1000), (NUM_SHEETS, 1, 1)))
    plane = np.concatenate([axes[:, :2] * extent, axes[:, 2:] * rng.uniform(0.05, 0.6, (NUM_SHEETS, 1, 1))], axis=1)
    ticks = np.linspace(-1, 1, 5)
    u, v = (t.reshape(-1) for t in np.meshgrid(ticks, ticks))
    clip = seen_from(np.einsum("vi,nij->nvj", np.stack([u, v, np.ones_like(u)], axis=-1), plane))
    x, y, z = np.moveaxis(plane, -1, 0)
    inverse = np.linalg.inv(np.stack([(x - z) * WIDTH / 2, (-z - y) * HEIGHT / 2, -z], axis=1))
    a, b, c = np.moveaxis(inverse, 1, 0)
    sides = np.stack([c - a, c + a, c - b, c + b, np.array([0, 0, 1 / NEAR]) - c], axis=1)
    pixel = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5, [1.0]), axis=-1)[:, :, 0]
    inside = np.einsum("nsi,hwi->nhws", sides, pixel) / np.hypot(sides[..., 0], sides[..., 1])[:, None, None, :]
    return clip, inside.min(axis=-1)


def test_neighbours_cut_by_the_same_plane_leave_no_crack_at_a_thousand_angles():
    clip, inside = sheets()
    index = split(np.arange(25).reshape(5, 5, 1), False)[..., 0]
    # Two triangles with a common side are never both first or both second of their cells.
    count = sum((draw_each(clip, index[part::2], HEIGHT, WIDTH).face >= 0).astype(int) for part in (0, 1))
    assert count.max() == 1
    assert (count[inside > 1 / 256] == 1).all() and (count[inside < -1 / 256] == 0).all()
    assert (inside > 0).mean() > 0.1 and (clip[..., 3].min(axis=1) < NEAR).mean() > 0.9


def test_a_fan_to_infinity_covers_every_pixel_once():
    """The rim has w = 0: it touches the camera's plane in every direction."""
    angle = np.arange(12) * np.pi / 6 + 0.1
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    for path in PATHS:
        first, last = first_and_last(fan(rim, np.array([20.5, 33.5, 1.0])), SIZE, SIZE, path)
        assert (first == last).all() and (first >= 0).all()


def test_both_triangles_of_an_edge_cut_it_at_the_same_bits():
    """Corners are given by position: of a→b in one triangle and b→a in the other, the same two ends are left."""
    rng = np.random.default_rng(0)
    a, b, c, d = rng.normal(size=(4, 20000, 4)) * 10.0 ** rng.uniform(-3, 3, (4, 20000, 1))
    a, b, c, d = (np.float32(v) for v in (a, b, c, d))
    guards = (2.0, 3.0)
    cut = jax.jit(lambda corners: clip_polygon(corners, *guards))
    (one, num_one), (other, num_other) = (
        map(np.asarray, cut(jnp.array(np.stack(corners, axis=1)))) for corners in ((a, b, c), (b, a, d))
    )
    slot = np.arange(one.shape[1])
    used = (slot < num_one[:, None])[:, :, None] & (slot < num_other[:, None])[:, None, :]
    common = ((one[:, :, None] == other[:, None]).all(axis=-1) & used).sum(axis=(1, 2))
    # The edge is visible where its part inside of all planes has a length.
    start, end = (np.asarray(plane_distances(jnp.asarray(v), *guards), np.float64) for v in (a, b))
    t = np.where(start == end, 0.5, start / np.where(start == end, 1.0, start - end))
    low = np.where((start < 0) & (end >= 0), t, 0).max(axis=1)
    high = np.where((start >= 0) & (end < 0), t, 1).min(axis=1)
    visible = (low < high - 1e-3) & ~((start < 0) & (end < 0)).any(axis=1)
    whole = (start >= 0).all(axis=1) & (end >= 0).all(axis=1)
    assert (visible & ~whole).sum() > 1000
    assert (common[visible] >= 2).all()


def test_seams_by_position_and_by_index_are_the_same_bits():
    clip, _ = sheets()
    index = split(np.arange(25).reshape(5, 5, 1), False)[..., 0]
    for sheet in clip[:20]:
        apart = draw(sheet[index].reshape(-1, 4), np.arange(96).reshape(32, 3), SIZE, SIZE)
        assert same(draw(sheet, index, SIZE, SIZE), apart)


def spread(seed):
    """40 triangles with w from 1e-3 to 1e3 in each, some corners behind the camera."""
    rng = np.random.default_rng(seed)
    w = 10.0 ** np.stack([np.full(40, -3), rng.uniform(-3, 3, 40), np.full(40, 3)], axis=1)
    w *= rng.choice([1, 1, 1, -1], (40, 3))
    place, depth = rng.normal(0, 1, (40, 3, 2)), rng.uniform(0.1, 1, (40, 3, 1))
    ndc = np.concatenate([place, depth, np.ones_like(depth)], axis=-1)
    return np.float32(ndc * w[..., None]).reshape(-1, 4)


@pytest.mark.parametrize("seed", range(4))
def test_spans_of_a_million_in_w_stay_finite(seed):
    clip, faces = spread(seed), np.arange(120, dtype=np.int32).reshape(40, 3)
    for path in PATHS:
        seen = draw(clip, faces, SIZE, SIZE, path)
        assert np.isfinite(seen.barycentric).all() and np.isfinite(seen.depth).all()
        assert ((seen.depth > 0) == (seen.face >= 0)).all() and (seen.face >= 0).mean() > 0.5


def test_gradients_of_spans_of_a_million_in_w_are_finite():
    faces = np.arange(120, dtype=np.int32).reshape(40, 3)

    def total(clip):
        seen = rasterize(clip, jnp.asarray(faces), height=SIZE, width=SIZE)
        return jnp.sum(seen.depth) + jnp.sum(seen.barycentric[..., 0])

    for seed in range(4):
        slope = np.asarray(jax.grad(total)(jnp.asarray(spread(seed))))
        assert np.isfinite(slope).all() and (slope != 0).any(axis=1).mean() > 0.1
