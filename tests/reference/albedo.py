"""The split sum of the GGX lobe once more, in double precision and another way: by normals as the viewer sees them."""

import numpy as np


def split_sum(n_dot_v: float, alpha: float, side: int = 160) -> tuple[float, float]:
    """(A, B): the mean over visible normals h of G₂/G₁, times 1 - c and times c = (1 - v·h)⁵, from above the horizon.

    The normals are those of a cap of the sphere (Dupuy and Benyoub 2023), as vectors, and l is v mirrored at h. Far
    from the peak, where light goes into the surface, points are denser: u = s (2 - s).
    """
    s, around = ((np.arange(side) + 0.5) / side for _ in "ab")
    u, phi = np.meshgrid(s * (2 - s), np.pi * around, indexing="ij")
    weight = np.broadcast_to(2 * (1 - s[:, None]), u.shape) / side**2
    v = np.array([np.sqrt(1 - n_dot_v**2), 0, n_dot_v])
    w = v * [alpha, alpha, 1]
    w /= np.linalg.norm(w)
    z = 1 - u * (1 + w[2])
    radius = np.sqrt(np.maximum(1 - z * z, 0))
    h = (np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=-1) + w) * [alpha, alpha, 1]
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    l = 2 * (h @ v)[..., None] * h - v

    def smith(cosine):
        return 0.5 * (np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1)

    above = l[..., 2] > 0
    masking = (1 + smith(n_dot_v)) / (1 + smith(n_dot_v) + smith(np.where(above, l[..., 2], 1)))
    c = (1 - h @ v) ** 5
    whole = np.where(above, weight * masking, 0)
    return float((whole * (1 - c)).sum()), float((whole * c).sum())
