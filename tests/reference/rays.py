"""Rays against all triangles in double precision, and where single precision may decide otherwise."""

import numpy as np

ROUNDING = 2.0**-24


def cast(vertices, faces, origin, direction, t_max=np.inf):
    """(face, t, doubtful): the nearest hit of each ray, -1 and inf for none, and whether roundings could change it.

    In coordinates across the ray, a corner at distance q moves by a few roundings of q, and an edge function by that
    times how far the corners are from the ray.
    """
    corners = vertices[faces].astype(np.float64)
    face, near, doubtful = np.full(len(origin), -1), np.full(len(origin), np.inf), np.zeros(len(origin), bool)
    for i, (o, d) in enumerate(zip(origin.astype(np.float64), direction.astype(np.float64))):
        length = np.linalg.norm(d)
        w = d / length
        u = np.cross(w, np.eye(3)[np.abs(w).argmin()])
        u /= np.linalg.norm(u)
        p = (corners - o) @ np.stack([u, np.cross(w, u), w], axis=-1)
        x, y, z = np.moveaxis(p, -1, 0)
        j, k = [1, 2, 0], [2, 0, 1]
        edge = x[:, j] * y[:, k] - y[:, j] * x[:, k]
        total = edge.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (edge * z).sum(axis=1) / total
        reach, across = np.linalg.norm(p, axis=-1).max(axis=1), np.hypot(x, y).max(axis=1)
        error = 32 * ROUNDING * reach * across
        inside = (edge >= 0).all(axis=1) | (edge <= 0).all(axis=1)
        near_edge = ((edge >= -error[:, None]).all(axis=1) | (edge <= error[:, None]).all(axis=1)) & (
            np.abs(edge) <= error[:, None]
        ).any(axis=1)
        # How far off t may be: the edges' errors weigh the corners' distances.
        with np.errstate(divide="ignore", invalid="ignore"):
            off = 3 * error * np.ptp(z, axis=1) / np.abs(total) + 32 * ROUNDING * reach
        solid = total != 0
        hit = inside & solid & (t > 0) & (t < t_max * length)
        best = t[hit].min() if hit.any() else t_max * length
        at_risk = solid & (inside | near_edge) & (t - off <= best) & (t + off >= 0)
        first = np.flatnonzero(hit & (t == best))
        rivals = at_risk & (t + off >= best - off[first[0]] if len(first) else at_risk)
        doubtful[i] = (at_risk & near_edge).any() or rivals.sum() > 1 or (len(first) == 0 and rivals.any())
        if len(first):
            face[i], near[i] = first[0], best / length
    return face, near, doubtful
