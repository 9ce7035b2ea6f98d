"""What lights with an area give, in double precision and by other means: Lambert's polygons, and quadrature."""

import numpy as np

from jaxraster.brdf.energy_table import integrate


def polygon(corners: np.ndarray, n: np.ndarray) -> float:
    """The form factor of a convex polygon `[k, 3]` about the receiver, cut at the horizon."""
    p, q = corners, np.roll(corners, -1, axis=0)
    high, low = p @ n, q @ n
    out = (high > 0) != (low > 0)
    crossing = p + (high / np.where(out, high - low, 1.0))[:, None] * (q - p)
    # Above each corner that is kept stands the crossing that may follow it.
    kept = np.stack([p, crossing], axis=1)[np.stack([high > 0, out], axis=1)]
    if len(kept) < 3:
        return 0.0
    p, q = kept, np.roll(kept, -1, axis=0)
    across = np.cross(p, q)
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, np.sum(p * q, axis=1))
    return float(abs(np.sum(angle * (across @ n) / np.where(sine > 0, sine, 1.0))) / (2 * np.pi))


def rim(center, axis, radius: float, count: int = 4000) -> np.ndarray:
    """Corners of a polygon of the area of a disc."""
    x = np.cross(axis, [0.3, 0.5, -0.8])
    x /= np.linalg.norm(x)
    turn = 2 * np.pi * (np.arange(count) + 0.5) / count
    radius = radius * np.sqrt(np.pi / (count / 2 * np.sin(2 * np.pi / count)))
    return center + radius * (np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * np.cross(axis, x))


def specular(v: np.ndarray, alpha: float, f0: float, light, side: int = 256) -> float:
    """∫ D V F (n·l) over a light of radiance 1, n = z, with all of its bounces: samples of light and lobe together.

    `light` is a pair of functions: directions from `[q, 2]` numbers, and their density.
    """
    draw, density_of = light
    u = (np.arange(side) + 0.5) / side
    u = np.stack([x.ravel() for x in np.meshgrid(u, u, indexing="ij")], axis=-1)
    a2, view = alpha**2, np.sqrt(v[2] ** 2 * (1 - alpha**2) + alpha**2)

    def lobe(l):
        h = (l + v) / np.linalg.norm(l + v, axis=-1, keepdims=True)
        d = a2 / (np.pi * (h[:, 0] ** 2 + h[:, 1] ** 2 + a2 * h[:, 2] ** 2) ** 2)
        up = np.maximum(l[:, 2], 0)
        masking = 0.5 / (up * view + v[2] * np.sqrt(up**2 * (1 - a2) + a2))
        return d * masking * up * (f0 + (1 - f0) * (1 - np.minimum(h @ v, 1)) ** 5), 0.5 * d / (v[2] + view)

    stretch = np.array([alpha, alpha, 1.0])
    w = stretch * v / np.linalg.norm(stretch * v)
    z = (1 - u[:, 1]) * (1 + w[2]) - w[2]
    radius, turn = np.sqrt(np.maximum(1 - z * z, 0)), 2 * np.pi * u[:, 0]
    h = stretch * (np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=-1) + w)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    total = 0.0
    for l in (draw(u), 2 * (h @ v)[:, None] * h - v):
        value, density = lobe(l)
        of_light = density_of(l)
        total += np.mean(np.where(of_light > 0, value / (of_light + density), 0.0))
    a, b = (x[0] for x in integrate(v[2:], np.array([alpha])))
    return total * (1 + f0 * (1 / (a + b) - 1))


def quad(center, right, up):
    """Of `specular`, a rectangle that shines to both sides."""
    normal = np.cross(right, up)
    area = 4 * np.linalg.norm(normal)
    normal = normal / np.linalg.norm(normal)

    def draw(u):
        points = center + (2 * u[:, :1] - 1) * right + (2 * u[:, 1:] - 1) * up
        return points / np.linalg.norm(points, axis=1, keepdims=True)

    def density(l):
        cosine = l @ normal
        distance = (center @ normal) / np.where(np.abs(cosine) > 1e-9, cosine, 1e-9)
        at = l * distance[:, None] - center
        inside = (distance > 0) & (np.abs(at @ right) < right @ right) & (np.abs(at @ up) < up @ up)
        return inside * distance**2 / np.maximum(np.abs(cosine), 1e-9) / area

    return draw, density


def ball(center, radius: float):
    """Of `specular`, a sphere."""
    axis = center / np.linalg.norm(center)
    x = np.cross(axis, [0.3, 0.5, -0.8])
    x /= np.linalg.norm(x)
    least = np.sqrt(1 - (radius**2 / (center @ center)))

    def draw(u):
        cosine, turn = 1 - u[:, :1] * (1 - least), 2 * np.pi * u[:, 1:]
        around = np.cos(turn) * x + np.sin(turn) * np.cross(axis, x)
        return cosine * axis + np.sqrt(1 - cosine**2) * around

    return draw, lambda l: (l @ axis > least) / (2 * np.pi * (1 - least))
