"""The microfacets that a viewer sees, as points of a quadrature."""

import numpy as np

UP = (0.0, 0.0, 1.0)
SIDE = 96  # Gauss's points per axis, the same everywhere: one compiled shape


def gauss(low=0.0, high=1.0) -> tuple[np.ndarray, np.ndarray]:
    """SIDE points from low to high, and their weights."""
    x, weight = np.polynomial.legendre.leggauss(SIDE)
    return low + (high - low) * 0.5 * (x + 1), (high - low) * 0.5 * weight


def facets(distribution, alpha, v) -> tuple[np.ndarray, np.ndarray]:
    """Normals h `[n 3]` of a lobe as wide as two `alpha`, that v sees, and the area D (v·h) dh of each.

    `distribution` takes single-precision h and alpha in the surface's own space. In the plane of slopes, dh = cos³θ
    dx dy, stretched by alpha and with v's own direction first: there v·h > 0 where cos φ > -v_z/(t w), and Gauss's
    points up to that angle have no kink to straddle; nor have those on either side of t = v_z/w.
    """
    alpha = np.asarray(alpha)
    stretched = v[:2] * alpha
    w = np.hypot(*stretched)
    direction, w = (stretched / w, w) if w > 1e-6 else (np.array([1.0, 0.0]), 1e-6)
    across = np.array([-direction[1], direction[0]])
    split = v[2] / (v[2] + w)  # t = s/(1 - s)
    fraction, dfraction = gauss()
    parts = []
    for low, high in ((0.0, split), (split, 1.0)):
        s, ds = gauss(low, high)
        t, dt = s / (1 - s), ds / (1 - s) ** 2
        limit = np.arccos(np.clip(-v[2] / np.maximum(t * w, 1e-300), -1, 1))
        phi = limit[:, None] * fraction
        x, y = t[:, None] * np.cos(phi), t[:, None] * np.sin(phi)
        area = np.prod(alpha) * (t * dt * limit)[:, None] * dfraction
        # The one half of them, and the other, mirrored at v's direction.
        for side in (1, -1):
            slopes = alpha * (x[..., None] * direction + side * y[..., None] * across)
            h = np.concatenate([slopes, np.ones((SIDE, SIDE, 1))], axis=-1)
            h /= np.linalg.norm(h, axis=-1, keepdims=True)
            parts.append((h.reshape(-1, 3), (area * h[..., 2] ** 3 * (h @ v)).ravel()))
    h, area = (np.concatenate(x) for x in zip(*parts))
    widths = np.broadcast_to(alpha, (len(h), 2)).astype(np.float32)
    return h, area * np.asarray(distribution(h.astype(np.float32), widths), np.float64)
