"""Whether any surface in view can be shadowed, or its sky hidden, at all: a proof on the host, on concrete geometry.

A face shadows another only if, seen along the light or from the lamp, the two overlap, and it reaches above the
other's plane. Faces in view are first cut to the camera's frustum; the answer errs towards "yes".

Gradient: none, plain NumPy in double precision.
"""

import numpy as np

# Where there are more pairs, only so many receivers are tried: nearly always one of them settles it, and else a proof
# would take seconds.
MAX_PAIRS = 4_000_000
# A face must reach above a plane by this share of the scene's size, which is some float32 roundings of a position.
RELATIVE_GAP = 1e-6
# Overlap is judged with this margin of the scene's size: of a map's 1024 texels each is at most 1/1020 of it, the
# filter reaches two of them beyond an edge on either axis, 2.83 in all, and snapping adds less than one.
RELATIVE_REACH = 4 / 1024


def clip_to_frustum(triangle: np.ndarray, clip_from_world: np.ndarray) -> np.ndarray:
    """The part of a triangle `[3, 3]` in view, as a convex polygon `[k, 3]`; k = 0 where none is."""
    polygon = [np.append(corner, 1.0) for corner in triangle.astype(np.float64)]
    matrix = clip_from_world.astype(np.float64)
    planes = [matrix[3] - matrix[0], matrix[3] + matrix[0], matrix[3] - matrix[1], matrix[3] + matrix[1]]
    planes += [matrix[3] - matrix[2], matrix[2]]
    for plane in planes:
        kept = []
        for start, end in zip(polygon, polygon[1:] + polygon[:1]):
            a, b = plane @ start, plane @ end
            if a >= 0:
                kept.append(start)
            if (a >= 0) != (b >= 0):
                kept.append(start + a / (a - b) * (end - start))
        polygon = kept
    return np.array([corner[:3] for corner in polygon]).reshape(-1, 3)


def visible_polygons(triangles: np.ndarray, clip_from_world: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """(face, polygon) of every face that reaches into the frustum."""
    corners = np.concatenate([triangles, np.ones((*triangles.shape[:2], 1))], axis=-1).astype(np.float64)
    x, y, z, w = np.moveaxis(corners @ clip_from_world.T.astype(np.float64), -1, 0)
    distances = np.stack([w - x, w + x, w - y, w + y, w - z, z])
    inside = (distances >= 0).all(axis=(0, 2))
    crossing = ~inside & ~(distances < 0).all(axis=2).any(axis=0)
    polygons = [(int(face), triangles[face]) for face in np.flatnonzero(inside)]
    for face in np.flatnonzero(crossing):
        polygon = clip_to_frustum(triangles[face], clip_from_world)
        if len(polygon) >= 3:
            polygons.append((int(face), polygon))
    return polygons


def _separated(a: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    """Whether a polygon `[k, 2]` and triangles `[n, 3, 2]`, all convex, lie apart by more than `reach`."""

    def axes(polygons):
        edges = np.roll(polygons, -1, axis=-2) - polygons
        lengths = np.linalg.norm(edges, axis=-1, keepdims=True)
        return np.stack([-edges[..., 1], edges[..., 0]], axis=-1) / np.where(lengths > 0, lengths, 1.0)

    def gaps(axis):
        along = np.moveaxis(axis, -1, -2)
        mine, theirs = a @ along, others @ along
        return np.maximum(theirs.min(-2) - mine.max(-2), mine.min(-2) - theirs.max(-2)).max(-1)

    own = np.broadcast_to(axes(a), (len(others), len(a), 2))
    return np.maximum(gaps(own), gaps(axes(others))) > reach


def _planes(triangles: np.ndarray) -> np.ndarray:
    """Unit normals of triangles, 0 where they have no area."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals / np.where(lengths > 0, lengths, 1.0)


def may_shadow(
    triangles: np.ndarray,
    receivers: list[tuple[int, np.ndarray]],
    direction: np.ndarray,
    size: float,
    reach: float = RELATIVE_REACH,
    pairs: int = MAX_PAIRS,
) -> bool | None:
    """Whether any of the faces `[f, 3, 3]` can stand between parallel light and a receiver; None if too many to tell.

    `size` is the diagonal of the box around all vertices, and a map's filter reaches `reach` of it.
    """
    stride = max(1, -(-len(receivers) * len(triangles) // pairs))
    towards = -np.asarray(direction, np.float64) / np.linalg.norm(direction)
    helper = np.eye(3)[np.argmin(np.abs(towards))]
    right = np.cross(helper, towards)
    right /= np.linalg.norm(right)
    flat = np.stack([right, np.cross(towards, right)], axis=-1)
    shadows = triangles @ flat
    normals = _planes(triangles)

    for face, polygon in receivers[::stride]:
        normal = normals[face] * np.where(normals[face] @ towards < 0, -1.0, 1.0)
        above = ((triangles - triangles[face, 0]) @ normal).max(axis=1) > RELATIVE_GAP * size
        above[face] = False
        candidates = shadows[above]
        if len(candidates) and not _separated(polygon @ flat, candidates, reach * size).all():
            return True
    return False if stride == 1 else None


def lamp_may_shadow(
    triangles: np.ndarray,
    receivers: list[tuple[int, np.ndarray]],
    position: np.ndarray,
    size: float,
    reach: float = RELATIVE_REACH,
    pairs: int = MAX_PAIRS,
) -> bool | None:
    """The same for a lamp: `reach` is then a tangent, seen from it.

    What shadows a receiver meets the pyramid from the lamp to it, so that no side of the pyramid has it outside.
    """
    stride = max(1, -(-len(receivers) * len(triangles) // pairs))
    gap, lamp = RELATIVE_GAP * size, np.asarray(position, np.float64)
    away, normals = triangles - lamp, _planes(triangles)
    allowed = reach * np.linalg.norm(away, axis=-1).max(axis=1)

    for face, polygon in receivers[::stride]:
        normal = normals[face] * (-1.0 if normals[face] @ away[face, 0] > 0 else 1.0)
        outside = ((triangles - triangles[face, 0]) @ normal).max(axis=1) <= gap
        outside[face] = True
        rays = polygon - lamp
        middle = rays.mean(axis=0)
        for edge in np.cross(rays, np.roll(rays, -1, axis=0)):
            length = np.linalg.norm(edge)
            if length > 0:
                edge = edge / length * (-1.0 if edge @ middle > 0 else 1.0)
                outside |= (away @ edge).min(axis=1) > allowed
        if not outside.all():
            return True
    return False if stride == 1 else None


def may_darken(
    triangles: np.ndarray,
    receivers: list[tuple[int, np.ndarray]],
    culled: np.ndarray,
    eye: np.ndarray,
    size: float,
    reach: float,
    pairs: int = MAX_PAIRS,
) -> bool | None:
    """Whether any of the faces within `reach` metres of a receiver rises above its plane, on the side of the eye; None
    if too many to tell.

    The backs of faces that are `culled` receive nothing. `eye` is a place and 1, or the direction back to a camera
    without perspective and 0.
    """
    stride = max(1, -(-len(receivers) * len(triangles) // pairs))
    normals, low, high = _planes(triangles), triangles.min(axis=1), triangles.max(axis=1)
    for face, polygon in receivers[::stride]:
        place = triangles[face, 0]
        behind = normals[face] @ (eye[:3] - eye[3] * place) < 0
        if behind and culled[face]:
            continue
        normal = -normals[face] if behind else normals[face]
        apart = np.maximum(np.maximum(low - polygon.max(axis=0), polygon.min(axis=0) - high), 0.0)
        near = triangles[np.linalg.norm(apart, axis=1) <= reach]
        if ((near - place) @ normal).max() > RELATIVE_GAP * size:
            return True
    return False if stride == 1 else None
