"""GGX reflection as a linearly transformed cosine: the fit behind `area_lobe`, made on the host at first use.

Target: f = D V (n·l), that is F = 1, over the l above the surface, seen from v = (s, 0, c) with c = n·v, s² + c² = 1.
In axes y, the mirror direction z, and x = y × z, directions are mapped by

w = ((1 - δ s²) x + k s z, y, α (a z + b n·l)),

and p = w_z det / (π |w|⁴), a cosine before it was mapped, is fitted to f/∫f by least ∫ (p^¾ - f^¾)². Powers of α and s
are split off so that δ, k, a, b are smooth and y may point anywhere at s = 0. As α → 0 they are 1/(1 + c), 0, 2c, 0,
and the fit is exact.

Gradient: none, these are constants.
Source: Heitz, Dupuy, Hill & Neubelt 2016, "Real-Time Polygonal-Light Shading with Linearly Transformed Cosines"; the
parameters, and what is minimized, are ours.
"""

import functools

import numpy as np
from jaxtyping import Float

# Nodes are even in roughness, from the least that materials have, and in the root of n·v, from their least one; the
# last stays clear of s = 0, where δ and k mean nothing.
NODES = 16
ROUGHNESS, ROOT = (0.045, 1.0), (0.031, 0.99)
SIDE = 20  # samples of a lobe along either axis, and as many of the cosine
STEPS = 25  # of Levenberg and Marquardt's method
# Compared are powers of the lobes: 1 would leave the tails twice too bright, ½ a peak half too dim, at grazing angles.
POWER = 0.75
# Least weight of b² in what is minimized: it decides where b has no effect, and costs nothing where it has.
RIDGE = 1e-5

Rows = Float[np.ndarray, "..."]


def _normals(l: Rows, v: Rows, alpha: Rows) -> tuple[Rows, Rows]:
    """D of the half vectors, and √(c² (1 - α²) + α²)."""
    h = l + v
    h = h / np.linalg.norm(h, axis=-1, keepdims=True)
    a2 = alpha**2
    d = a2 / (np.pi * (h[..., 0] ** 2 + h[..., 1] ** 2 + a2 * h[..., 2] ** 2) ** 2)
    return d, np.sqrt(v[..., 2] ** 2 * (1.0 - a2) + a2)


def samples(v: Rows, alpha: Rows) -> tuple[Rows, Rows]:
    """Directions `[m, q, 3]`, half of them mirrored at visible normals, half cosine-distributed, and 1/(q density)."""
    u = (np.arange(SIDE) + 0.5) / SIDE
    u, turn = (x.ravel()[:, None] for x in np.meshgrid(u, 2.0 * np.pi * u, indexing="ij"))
    around, axis = np.concatenate([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1), np.array([0.0, 0.0, 1.0])
    # Draw visible normals as `brdf.sampling` does, by spherical caps.
    stretch = np.concatenate([alpha, alpha, np.ones_like(alpha)], axis=-1)[:, None]
    w = stretch * v / np.linalg.norm(stretch * v, axis=-1, keepdims=True)
    z = (1.0 - u) * (1.0 + w[..., 2:]) - w[..., 2:]
    h = stretch * (np.sqrt(np.maximum(1.0 - z * z, 0.0)) * around + z * axis + w)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    mirrored = 2.0 * np.sum(v * h, axis=-1, keepdims=True) * h - v
    cosine = np.sqrt(u) * around + np.sqrt(1.0 - u) * axis
    l = np.concatenate([mirrored, np.broadcast_to(cosine, mirrored.shape)], axis=1)
    d, view = _normals(l, v, alpha)
    density = 0.25 * d / (v[..., 2] + view) + 0.5 * np.maximum(l[..., 2], 0.0) / np.pi
    return l, np.where(l[..., 2] > 0, 1.0 / density, 0.0) / l.shape[1]


def lobe(l: Rows, v: Rows, alpha: Rows) -> Rows:
    """D V (n·l), 0 below the surface."""
    d, view = _normals(l, v, alpha)
    up, c = np.maximum(l[..., 2], 0.0), v[..., 2]
    light = np.sqrt(up * up * (1.0 - alpha**2) + alpha**2)
    return 0.5 * d * up / (up * view + c * light)


def _mapped(entries: Rows, geometry: tuple[Rows, ...]) -> tuple[Rows, Rows]:
    """p, and the slopes of log p in the entries 1 - δ s², k s, a and b, `[m, q, 4]`."""
    x, y, z, up, alpha, s, c = geometry
    wide, lean, a, b = (entries[:, None, i] for i in range(4))
    w = (wide * x + lean * z, y, alpha * (a * z + b * up))
    square = w[0] ** 2 + w[1] ** 2 + w[2] ** 2
    det = alpha * (wide * (a + b * c) - lean * b * s)
    valid = (w[2] > 0) & (det > 0)
    rise, det = np.where(valid, w[2], 1.0), np.where(valid, det, 1.0)
    p = np.where(valid, rise * det / (np.pi * square**2), 0.0)
    slope = 1.0 / rise - 4.0 * w[2] / square
    slopes = (
        alpha * (a + b * c) / det - 4.0 * w[0] * x / square,
        -alpha * b * s / det - 4.0 * w[0] * z / square,
        alpha * (wide / det + z * slope),
        alpha * ((wide * c - lean * s) / det + up * slope),
    )
    return p, np.stack(slopes, axis=-1)


def _least(entries: Rows, f: Rows, weight: Rows, geometry: tuple[Rows, ...]) -> Rows:
    """The entries, and the log of a factor of p as the fifth, of the least ∫ (p^¾ - f^¾)²; all cells at once."""
    wanted = f**POWER
    weight = weight / np.sum(wanted**2 * weight, axis=1, keepdims=True)

    def errors(entries):
        p, slopes = _mapped(entries, geometry)
        fitted = (p * np.exp(entries[:, 4:])) ** POWER
        slopes = POWER * fitted[..., None] * np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)
        loss = np.sum((fitted - wanted) ** 2 * weight, axis=1) + RIDGE * entries[:, 3] ** 2
        # A map without any light would be a way out where the start is far off.
        return np.where((p > 0).any(axis=1), loss, np.inf), fitted - wanted, slopes

    ridge, damping = np.diag([0.0, 0.0, 0.0, RIDGE, 0.0]), np.full((len(entries), 1, 1), 0.1)
    loss, error, slopes = errors(entries)
    for _ in range(STEPS):
        weighed = (slopes * weight[..., None]).swapaxes(1, 2)
        curvature = weighed @ slopes + ridge
        diagonal = np.eye(5) * np.diagonal(curvature, axis1=1, axis2=2)[:, None]
        step = np.linalg.solve(curvature + damping * diagonal, weighed @ error[..., None] + ridge @ entries[..., None])
        tried = (entries - step[..., 0], *errors(entries - step[..., 0]))
        better = tried[1] < loss
        damping *= np.where(better, 0.3, 4.0)[:, None, None]
        entries, loss, error, slopes = (
            np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
            for new, old in zip(tried, (entries, loss, error, slopes))
        )
    return entries


def fit(alpha: Float[np.ndarray, " m"], c: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 5"]:
    """δ, k, a, b, and 1 over the share of p above the surface, for every pair of α and n·v; in double precision."""
    alpha, c = alpha[:, None], c[:, None]
    s = np.sqrt(1.0 - c * c)
    v = np.stack([s, 0.0 * s, c], axis=-1)
    l, weight = samples(v, alpha)
    f = lobe(l, v, alpha)
    f /= np.sum(f * weight, axis=1, keepdims=True)
    x, y, up = np.moveaxis(l, -1, 0)
    geometry = (c * x + s * up, y, c * up - s * x, up, alpha, s, c)

    # Start from the limit of smooth surfaces and, by the share of roughness, from what rough ones come to.
    rough = alpha / (alpha + c)
    start = [c + 0.5 * alpha * s * s, -alpha * s * rough**2, 2.0 * c * (1.0 - rough), 1.5 * rough, 0.0 * c]
    entries = _least(np.concatenate(start, axis=1), f, weight, geometry)
    above = np.sum(_mapped(entries, geometry)[0] * weight, axis=1)
    wide, lean, a, b = entries[:, :4].T
    s = s[:, 0]
    return np.stack([(1.0 - wide) / s**2, lean / s, a, b, 1.0 / above], axis=-1)


@functools.cache
def table() -> Float[np.ndarray, "n 5"]:
    """`fit` at all nodes, roughness by roughness; made once."""
    roughness, root = np.meshgrid(*(np.linspace(*ends, NODES) for ends in (ROUGHNESS, ROOT)), indexing="ij")
    return fit(roughness.ravel() ** 2, root.ravel() ** 2)
