"""The GGX lobe about the mirror direction, by quadrature in double precision."""

import numpy as np


def lobe(v: np.ndarray, alpha: float, side: int = 96) -> tuple[np.ndarray, np.ndarray]:
    """Directions l about +Z, of any sign, and weights ∝ D V (n·l) dl, 0 below: v [3] mirrored at visible normals (Dupuy
    and Benyoub 2023), times G₂/G₁."""
    u = (np.arange(side) + 0.5) / side
    u, w = np.meshgrid(u, u, indexing="ij")
    stretched = np.array([alpha, alpha, 1.0]) * v
    stretched /= np.linalg.norm(stretched)
    t = w * (1 + stretched[2])
    radius = np.sqrt(t * (2 - t))
    cap = np.stack([radius * np.cos(2 * np.pi * u), radius * np.sin(2 * np.pi * u), 1 - t], axis=-1)
    h = (cap + stretched) * np.array([alpha, alpha, 1.0])
    # The cap lies about z: its points are 1 - t high, of which the view's own height is a part.
    h[..., 2] = (1 - w) * (1 + stretched[2])
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    l = 2 * (h @ v)[..., None] * h - v
    long_v, long_l = (np.sqrt(alpha**2 * (1 - c * c) + c * c) for c in (v[2], l[..., 2]))
    weight = np.where(l[..., 2] > 0, l[..., 2] * (v[2] + long_v) / (l[..., 2] * long_v + v[2] * long_l), 0)
    return l, weight
