"""The table behind `energy`: two integrals of the GGX lobe, made once in a process by quadrature on the host.

A = ∫ D V (n·l) (1 - c) dl and B = ∫ D V (n·l) c dl with c = (1 - v·h)⁵: what a surface of Schlick's Fresnel mirrors of
uniform light is f0·A + f90·B. In terms of half vectors, at azimuth φ and angle θ from n with tan θ = α tan χ, D and the
cosines cancel: E = A + B = 1/π ∫ dφ ∫ dχ sin χ (v·h/h_z) cos χ · 2 (n·l) / ((n·l) |αv| + (n·v) |αl|), |αv| as in
`sampling` and φ once around. Light comes from above exactly where 2θ < π - atan2(n·v, √(1 - (n·v)²) cos φ), so that the
integrand has no edge, and few points do.

Source: the split in two is Karis 2013, "Real Shading in Unreal Engine 4"; D and V are those of `distribution` and
`masking`; the limit of θ follows from n·l = 2 (v·h) h_z - n·v.
"""

import functools
from typing import NamedTuple

import numpy as np

SIDE = 64  # nodes an axis, which leave an error of 0.0022 at most; 32 would leave 0.008
DEGREE = 7  # of the means' polynomials, right to 1e-4
POINTS = 16  # an axis of the quadrature, right to 4e-5
SMALLEST = 1e-12  # stands for a cosine and an alpha of 0, where the integrands are 0/0 and the integrals have limits


class Tables(NamedTuple):
    """`cells`: of each cell of the grid A, B at its corner, their changes along n·v, along α, and along both.
    `means`: coefficients of polynomials in roughness, from the constant upwards; see `energy.mean_split_sum`."""

    cells: np.ndarray  # [(SIDE - 1)², 8]
    means: np.ndarray  # [DEGREE + 1, 4]


def _nodes(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of [0, 1] and their weights, Gauss's squared: crowded at 0."""
    x, weight = np.polynomial.legendre.leggauss(count)
    return (0.5 + 0.5 * x) ** 2, weight * (0.5 + 0.5 * x)


def integrate(n_dot_v: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A, B) in double precision, for n·v and α in [0, 1] of one shape.

    Example:
        >>> a, b = integrate(np.ones(1), np.ones(1))
        >>> bool(abs(a + b - (1 - np.log(2)))[0] < 1e-12)
        True
    """
    # Where both are 0 the cosine counts as the smaller: seen from the side, all is mirrored.
    mu, alpha = (np.maximum(x, least)[..., None, None] for x, least in ((n_dot_v, SMALLEST**2), (alpha, SMALLEST)))
    sine = np.sqrt(1.0 - mu * mu)

    # Crowd the azimuths at both sides of 90°, where grazing light changes fastest, and the angles at their limit.
    near, weight = _nodes(POINTS // 2)
    cosine = np.cos(0.5 * np.pi * np.concatenate([1.0 - near, 1.0 + near]))[:, None]
    weight = np.tile(0.5 * weight, 2)[:, None]
    limit = 0.5 * (np.pi - np.arctan2(mu, sine * cosine))
    limit = np.arctan2(np.sin(limit), alpha * np.cos(limit))
    below, share = _nodes(POINTS)
    chi = limit * (1.0 - below)

    # h is (α sin χ cos φ, ..., cos χ) over its length.
    x, z = alpha * np.sin(chi), np.cos(chi)
    square, v_dot_h = x * x + z * z, sine * x * cosine + mu * z
    n_dot_l = np.maximum(2.0 * v_dot_h * z / square - mu, SMALLEST**2)
    long_v, long_l = (np.sqrt(alpha * alpha * (1.0 - c * c) + c * c) for c in (mu, n_dot_l))
    masking = 2.0 * n_dot_l / (n_dot_l * long_v + mu * long_l)
    whole = 2.0 * weight * share * limit * np.sin(chi) * v_dot_h * masking
    schlick = np.clip(1.0 - v_dot_h / np.sqrt(square), 0.0, 1.0) ** 5
    return (whole * (1.0 - schlick)).sum(axis=(-2, -1)), (whole * schlick).sum(axis=(-2, -1))


@functools.cache
def tables() -> Tables:
    """The tables over ⁴√(n·v) and ⁴√α: at grazing angles all happens where n·v is about α, however small that is."""
    nodes = np.linspace(0.0, 1.0, SIDE) ** 4
    grid = np.stack([np.stack(integrate(np.full(SIDE, n_dot_v), nodes), axis=-1) for n_dot_v in nodes])
    along_v, along_alpha = np.diff(grid, axis=0), np.diff(grid, axis=1)
    corners = [grid[:-1, :-1], along_v[:, :-1], along_alpha[:-1], np.diff(along_v, axis=1)]
    cells = np.concatenate(corners, axis=-1).reshape(-1, 8)

    # Average over the hemisphere, 2 ∫ … (n·v) d(n·v), what `energy` needs; fit it in the square root of α.
    n_dot_v, weight = _nodes(POINTS)
    a, b = integrate(*np.broadcast_arrays(n_dot_v[:, None], nodes))
    lost = 1.0 / (a + b) - 1.0
    averages = np.einsum("v,kva->ak", 2.0 * n_dot_v * weight, np.stack([a, b, a * lost, b * lost]))
    return Tables(cells=cells, means=np.polynomial.polynomial.polyfit(np.sqrt(nodes), averages, DEGREE))
