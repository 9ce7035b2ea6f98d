"""Surfaces seen by a camera and known exactly: planes and pits, cast ray by ray in double precision."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from hand_made import surface

from jaxraster.buffers import Surface
from jaxraster.camera import Camera
from jaxraster.math.transform import look_at, orthographic, perspective

FLOOR = ((0, 0, 0), (0, 1, 0))
WALL = ((0, 0, 0), (0, 0, 1))
SIDE = ((0, 0, 0), (1, 0, 0))


def camera(eye=(0.7, 1.5, 2.5), target=(0, 0, 0), fov_y=40.0, half_height=None, far=100.0) -> Camera:
    """A pinhole, or a parallel projection where `half_height` is given."""
    lens = perspective(np.radians(fov_y)) if half_height is None else orthographic(half_height, 0.0, far)
    return Camera(world_from_view=look_at(eye, target), clip_from_view=lens)


def rays(seen_by: Camera, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions through the pixels' centres of a square picture."""
    pose, lens = (np.asarray(m, np.float64) for m in (seen_by.world_from_view, seen_by.clip_from_view))
    at = (np.arange(size) + 0.5) * 2 / size - 1
    x, y = np.meshgrid(at, -at)
    if lens[3, 2] == 0:
        offset = np.stack([(x - lens[0, 3]) / lens[0, 0], (y - lens[1, 3]) / lens[1, 1], np.zeros_like(x)], axis=-1)
        return pose[:3, 3] + offset @ pose[:3, :3].T, np.broadcast_to(-pose[:3, 2], (size, size, 3))
    ahead = np.stack([(x + lens[0, 2]) / lens[0, 0], (y + lens[1, 2]) / lens[1, 1], -np.ones_like(x)], axis=-1)
    return np.broadcast_to(pose[:3, 3], ahead.shape), ahead @ pose[:3, :3].T


def cast(planes, seen_by: Camera, size: int) -> Surface:
    """What is seen of infinite planes, (point, normal) each; nothing lies where no plane is met."""
    origin, direction = rays(seen_by, size)
    nearest, normal = np.full((size, size), np.inf), np.zeros((size, size, 3))
    for point, n in planes:
        n = np.asarray(n, np.float64) / np.linalg.norm(n)
        towards = direction @ n
        t = ((np.asarray(point) - origin) @ n) / np.where(towards == 0, 1, towards)
        hit = (towards != 0) & (t > 0) & (t < nearest)
        nearest, normal = np.where(hit, t, nearest), np.where(hit[..., None], -np.sign(towards)[..., None] * n, normal)
    return seen(origin, direction, nearest, normal)


def seen(origin, direction, t, normal) -> Surface:
    """The surface at origin + t direction, none where t is infinite."""
    mask = np.isfinite(t)
    view = -direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    position = origin + np.where(mask, t, 1.0)[..., None] * direction
    made = surface(position, np.where(mask[..., None], normal, view), view)
    return replace(made, mask=jnp.asarray(mask))


def pit(radius: float, depth: float, size: int, half_height: float) -> tuple[Surface, Camera]:
    """A cylindrical pit in the plane y = 0, from straight above, by a parallel projection."""
    above = camera((0, 5, 0), half_height=half_height)
    origin, direction = rays(above, size)
    inside = np.hypot(origin[..., 0], origin[..., 2]) < radius
    t = origin[..., 1] + np.where(inside, depth, 0.0)
    return seen(origin, direction, t, np.broadcast_to([0.0, 1.0, 0.0], origin.shape)), above
