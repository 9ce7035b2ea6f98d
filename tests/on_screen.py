"""Triangles placed in pixels, and `rasterize` told which way to go.

It draws triangles whose box is at most `raster.SMALL` pixels on a side one way and larger ones another; both ways, and
any mixture of them, must agree to the bit.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.visibility import raster

PATHS = {"small": 2**20, "large": 0, "mixed": raster.SMALL}
NUM_FACES = 1024  # every picture of a size is drawn by one program: what is missing are triangles without area
BATCH = (100, 26, 16)  # pictures, vertices and faces of what is drawn in batches, for the same reason


def _padded(clip, faces, num_vertices, num_faces):
    """More vertices, all of them in one place, and faces of the last."""
    place = np.broadcast_to(np.float32([0, 0, 0, 1]), (*clip.shape[:-2], num_vertices - clip.shape[-2], 4))
    spare = np.full((num_faces - len(faces), 3), num_vertices - 1)
    return jnp.array(np.concatenate([clip, place], axis=-2)), jnp.array(np.concatenate([faces, spare]), jnp.int32)


def draw(clip, faces, height, width, path="mixed"):
    """`rasterize` as NumPy arrays."""
    sizes = max(3 * NUM_FACES, len(clip)) + 1, max(NUM_FACES, len(faces))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(raster, "SMALL", PATHS[path])
        return jax.device_get(raster.rasterize(*_padded(clip, faces, *sizes), height=height, width=width))


@functools.cache
def _drawing_each(height, width):
    def draw_batch(clip, faces, small):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(raster, "SMALL", small)
            return raster.rasterize(clip, faces, height=height, width=width)

    return jax.jit(draw_batch)


def draw_each(clips, faces, height, width, path="mixed"):
    """`rasterize` of each of `clips` `[n, v, 4]`, n a multiple of 100."""
    batches = clips.reshape(-1, BATCH[0], *clips.shape[1:])
    drawing = _drawing_each(height, width)
    drawn = [drawing(*_padded(batch, faces, *BATCH[1:]), jnp.int32(PATHS[path])) for batch in batches]
    return jax.tree.map(lambda *parts: np.concatenate(parts), *drawn)


def same(one, other, names=("face", "barycentric", "depth")):
    """Whether two visibilities are the same to the bit."""
    return all((getattr(one, name) == getattr(other, name)).all() for name in names)


def clip_of(points, height, width, depth=0.5):
    """Float32 clip positions of points in pixels from the top left, (x, y) or homogeneous (x w, y w, w).

    An x.5 is a pixel's centre, and `depth` is z/w.
    """
    points = np.asarray(points, np.float64)
    x, y, w = points[..., 0], points[..., 1], points[..., 2] if points.shape[-1] == 3 else np.ones(points.shape[:-1])
    return np.stack([x * 2 / width - w, w - y * 2 / height, depth * w, w], axis=-1).astype(np.float32)


def with_w(points, w):
    """Homogeneous (x w, y w, w) of points in pixels."""
    w = np.broadcast_to(w, points.shape[:-1])[..., None]
    return np.concatenate([points * w, w], axis=-1)


def first_and_last(corners, height, width, path="mixed"):
    """The lowest and the highest number of the triangles `[f, 3, 2 or 3]` that cover each pixel, -1 for none.

    Every triangle has a depth of its own, so that two pictures find them: with depths that fall and that rise with the
    number. Where both are the same, exactly one triangle covers the pixel.
    """
    num = len(corners)
    rising = np.arange(1, num + 1)[:, None] / (num + 1)
    faces = np.arange(3 * num).reshape(num, 3)
    clips = (clip_of(corners, height, width, depth).reshape(-1, 4) for depth in (1 - rising, rising))
    first, last = (draw(clip, faces, height, width, path).face for clip in clips)
    return first, last


def num_wrong(corners, must, height, width, path="mixed"):
    """How many pixels are covered twice, or not at all where they `must` be."""
    first, last = first_and_last(corners, height, width, path)
    return int(((first != last) | (must & (first < 0))).sum())


def on_grid(points, grid):
    """Points moved to the nearest multiple of 1/grid from a pixel's centre; None leaves them."""
    return points if grid is None else np.round((points - 0.5) * grid) / grid + 0.5


def circle(count, radius, centre, turn=0.123):
    """`count` points on a circle; `radius` may be one for x and one for y."""
    angle = np.arange(count) * 2 * np.pi / count + turn
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def fan(rim, hub):
    """Triangles `[n, 3, c]` between a hub and the n corners of a closed polygon around it."""
    return np.stack([np.broadcast_to(hub, rim.shape), rim, np.roll(rim, -1, axis=0)], axis=1)


def split(grid, flip):
    """Two triangles for each cell of a grid of points `[n, m, c]`; `flip` says, by cell, along which diagonal."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    flip = np.broadcast_to(flip, a.shape[:2])[..., None, None]
    one = np.where(flip, np.stack([a, b, d], axis=2), np.stack([a, b, c], axis=2))
    other = np.where(flip, np.stack([b, c, d], axis=2), np.stack([a, c, d], axis=2))
    return np.stack([one, other], axis=2).reshape(-1, 3, grid.shape[-1])


def ruled(grid, size, count, tilt):
    """2 · count slivers between lines that run across a square picture, and beyond it by half of it on either side."""
    rng = np.random.default_rng(0)
    spacing = 1.2 * size / count
    y = (np.arange(count + 1) - count / 2) * spacing + size / 2 + rng.uniform(-0.3, 0.3, (2, count + 1)) * spacing
    y += np.array([[-tilt], [tilt]])
    x = np.broadcast_to([[-size / 2], [size * 1.5]], y.shape)
    return split(on_grid(np.stack([x, y], axis=-1), grid), rng.uniform(size=(1, count)) < 0.5)


def graded(grid, height, width, cells=22):
    """A mesh over the whole picture with cells from under a pixel to a fifth of it, in all proportions."""
    rng = np.random.default_rng(0)
    ticks = []
    for size in (width, height):
        gaps = rng.permutation(np.exp(np.linspace(np.log(1.0 if grid == 1 else 0.4), np.log(size / 5), cells)))
        ticks.append((np.append(0, np.cumsum(gaps)) / gaps.sum() * 1.1 - 0.05) * size)
    # Move corners by less than would turn a triangle over; on whole pixels, not at all.
    room = [np.minimum(np.diff(v, prepend=v[0] - 1), np.diff(v, append=v[-1] + 1)) for v in ticks]
    points, room = (np.stack(np.meshgrid(*v), axis=-1) for v in (ticks, room))
    points = points + (0 if grid == 1 else 0.2) * room * rng.uniform(-1, 1, points.shape)
    return split(on_grid(points, grid), rng.uniform(size=(cells, cells)) < 0.5)


def pixels(height, width):
    """The pixels' centres `[h, w, 2]`."""
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def depth_inside(polygon, points):
    """How far points lie inside a convex polygon `[n, 2]`, in pixels; negative outside."""
    following = np.roll(polygon, -1, axis=0)
    turn = np.sign(np.sum(polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]))
    normal = (following - polygon)[:, ::-1] * [-turn, turn]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.min([(points - p) @ n for p, n in zip(polygon, normal)], axis=0)
