"""The rasterizer's twin in NumPy: 64-bit integers, every triangle against every pixel of its box, no tiles."""

import numpy as np

SUBPIXELS = 256


def snapped(clip: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Screen positions in 1/256 px from the picture's centre, y down, and z/w; float32 as the rasterizer has it."""
    clip = clip.astype(np.float32)
    inverse = np.float32(1.0) / clip[:, 3]
    x = clip[:, 0] * inverse * np.float32(0.5 * width)
    y = -clip[:, 1] * inverse * np.float32(0.5 * height)
    return np.stack([np.round(x * SUBPIXELS), np.round(y * SUBPIXELS)], axis=-1).astype(np.int64), clip[:, 2] * inverse


def edge(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(b - a) × (p - a) of integer points, exact."""
    return (b[..., 0] - a[..., 0]) * (p[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (p[..., 0] - a[..., 0])


def fragments(points: np.ndarray, depth: np.ndarray, faces: np.ndarray, height: int, width: int):
    """Of each triangle with an area: its number, its box of pixels, and there which samples it covers and its depth."""
    columns = np.arange(width) * SUBPIXELS - (width - 1) * (SUBPIXELS // 2)
    lines = np.arange(height) * SUBPIXELS - (height - 1) * (SUBPIXELS // 2)
    for number, face in enumerate(faces):
        corners = points[face]
        area = edge(corners[0], corners[1], corners[2])
        if area == 0:
            continue
        left, right = np.searchsorted(columns, (corners[:, 0].min(), corners[:, 0].max() + 1))
        top, bottom = np.searchsorted(lines, (corners[:, 1].min(), corners[:, 1].max() + 1))
        pixel = np.stack(np.meshgrid(columns[left:right], lines[top:bottom]), axis=-1)
        order = (0, 1, 2) if area > 0 else (0, 2, 1)
        corners, z = corners[list(order)], depth[face[list(order)]].astype(np.float64)
        inside, weights = np.ones(pixel.shape[:2], bool), []
        for a, b in ((corners[1], corners[2]), (corners[2], corners[0]), (corners[0], corners[1])):
            value = edge(a, b, pixel)
            dx, dy = b - a
            inside &= (value > 0) | ((value == 0) & (dy < 0 or (dy == 0 and dx > 0)))
            weights.append(value / abs(area))
        yield number, np.s_[top:bottom, left:right], inside, sum(w * d for w, d in zip(weights, z))


def rasterize(points: np.ndarray, depth: np.ndarray, faces: np.ndarray, height: int, width: int):
    """(face, depth, number of triangles that cover each pixel) of snapped points that need no clipping."""
    nearest, owner = np.zeros((height, width)), np.full((height, width), -1)
    count = np.zeros((height, width), int)
    for number, box, inside, here in fragments(points, depth, faces, height, width):
        wins = inside & (here > 0) & (here > nearest[box])
        nearest[box], owner[box] = np.where(wins, here, nearest[box]), np.where(wins, number, owner[box])
        count[box] += inside
    return owner, nearest, count


def runner_up(points: np.ndarray, depth: np.ndarray, faces: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """The greatest depth at each pixel of the triangles that do not own it, 0 where there is none."""
    second = np.zeros(owner.shape)
    for number, box, inside, here in fragments(points, depth, faces, *owner.shape):
        second[box] = np.maximum(second[box], np.where(inside & (owner[box] != number), here, 0))
    return second


def cut(corners: np.ndarray) -> np.ndarray:
    """What of a triangle in clip space lies beyond the near plane, z <= w: four corners, of no area if nothing does."""
    polygon = []
    for a, b in zip(corners.astype(np.float64), np.roll(corners, -1, axis=0).astype(np.float64)):
        here, there = a[3] - a[2], b[3] - b[2]
        polygon += [a] if here >= 0 else []
        polygon += [(a * there - b * here) / (there - here)] if here * there < 0 else []
    polygon = polygon or [np.array([0.0, 0.0, 0.0, 1.0])]
    return np.array((polygon + [polygon[-1]] * 3)[:4])


def cast(clip: np.ndarray, faces: np.ndarray, height: int, width: int, gap: float = 0.01):
    """(face, depth, distance) by homogeneous edge functions in double precision, without snapping or clipping.

    `distance` is how far each pixel lies from any decision, a triangle's edge or the near plane, in pixels; 0 where
    the two nearest triangles are closer to each other than `gap` of their depth, a percent since snapping moves depths.
    """
    clip = clip.astype(np.float64)
    x = (np.arange(width) + 0.5) * 2 / width - 1
    y = 1 - (np.arange(height) + 0.5) * 2 / height
    x, y = np.meshgrid(x, y)
    nearest, owner = np.zeros((height, width)), np.full((height, width), -1)
    distance, second = np.full((height, width), np.inf), np.zeros((height, width))
    for number, face in enumerate(faces):
        p = clip[face]
        matrix = np.stack([p[:, 0] * width / 2, p[:, 1] * height / 2, p[:, 3]], axis=-1)
        determinant = np.linalg.det(matrix)
        if abs(determinant) < 1e-12 * np.abs(matrix).max() ** 3:
            continue
        inverse = np.linalg.inv(matrix)
        e = np.stack([inverse[0, i] * x * width / 2 + inverse[1, i] * y * height / 2 + inverse[2, i] for i in range(3)])
        # e_i is β_i / w, its gradient's length per pixel that of the edge: their ratio is the distance to the edge.
        # An edge between two corners in the camera's plane is infinitely far: none of its gradient is left.
        reach = np.maximum(np.hypot(inverse[0], inverse[1]), 1e-30)[:, None, None]
        reciprocal_w = e.sum(axis=0)
        ndc = np.tensordot(p[:, 2], e, (0, 0))
        covered = (e > 0).all(axis=0) & (reciprocal_w > 0)
        here = np.where(covered & (ndc <= 1), ndc, 0)
        wins = here > nearest
        second = np.maximum(second, np.minimum(here, nearest))
        nearest, owner = np.where(wins, here, nearest), np.where(wins, number, owner)
        slope = np.tensordot(p[:, 2], inverse[:2].T, (0, 0))
        near_plane = np.abs(ndc - 1) / max(np.hypot(*slope), 1e-30)
        outside = np.maximum(-(e / reach), 0).max(axis=0)
        to_edge = np.where(outside > 0, outside, np.abs(e / reach).min(axis=0))
        distance = np.minimum(distance, np.where(reciprocal_w > 0, np.minimum(to_edge, near_plane), np.inf))
    return owner, nearest, np.where(second > (1 - gap) * nearest, np.where(nearest > 0, 0, distance), distance)
