"""Where rays meet triangles: the test that leaves no gaps, the place of a hit, and rays that leave it.

In coordinates that put a ray's origin at 0 and lay it along z, a triangle is hit where the three edge functions
E(p, q) = p_x q_y - p_y q_x of its corners have one sign. Corners are ordered by their coordinates, not as the face
names them: both triangles of an edge then evaluate the same expression of the same numbers, and the ray lies to one
side of it, or on it and hits both. A face's own order would leave this to E(p, q) = -E(q, p), which fused
multiply-adds break.

Gradient: none through the test; `intersection` and `spawn` are differentiable for given faces.
Source: Woop, Benthin & Wald 2013, "Watertight Ray/Triangle Intersection" (shear; we order corners where they fall
back to double precision). Möller & Trumbore 1997 for `intersection`.
"""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Float32, Int

from ..buffers import Stats
from ..check import below, fit
from ..math import safe
from ..math.table import fetch
from ..record import Scalar, record

# The largest coordinate: sums of products of three of them, each doubled, stay within float32. At the lower end, such
# products vanish for triangles of about 1e-12 and less seen from as near: below that, rays may miss them.
LIMIT = 1e12
# In units of the largest coordinate and of the triangle's size over its height: 16 roundings of 2⁻²⁴, of which the
# place takes a few and the test as many; no ray of the tests meets its own triangle at one of them.
OFFSET = 2.0**-20
# In units of the longest edge, the farthest that slivers move a place: a sixteenth of it still met own triangles.
FARTHEST = 2.0**-10
AXES = (1, 2, 0), (2, 0, 1), (0, 1, 2)  # the order of coordinates that puts the axis 0, 1 or 2 last


@record
class Rays:
    """origin + t direction for t_min < t < t_max; t counts in lengths of the direction.

    A direction's largest component lies within 1e-30 and 1e30. A t_min below 0 counts as 0. Rays with a number that is
    NaN, a direction of 0 or otherwise out of range, or an origin beyond 1e12 hit nothing and cost nothing.
    """

    origin: Float[Array, "*b 3"]
    direction: Float[Array, "*b 3"]
    t_min: Scalar = 0.0
    t_max: Scalar = jnp.inf


def check_rays(where: str, rays: Any) -> tuple[Array, Array, Array, Array]:
    """Origin, direction, t_min and t_max, each for every ray; raises one line for what are no rays."""
    if not isinstance(rays, Rays):
        raise TypeError(f"{where} must be a Rays, got {type(rays).__name__}")
    fit(f"{where}.origin", rays.origin, Float[Array, "*b 3"])
    fit(f"{where}.direction", rays.direction, Float[Array, "*b 3"])
    limits = [jnp.asarray(t, jnp.float32) for t in (rays.t_min, rays.t_max)]
    shapes = rays.origin.shape[:-1], rays.direction.shape[:-1], *(t.shape for t in limits)
    try:
        shape = jnp.broadcast_shapes(*shapes)
    except ValueError:
        listed = ", ".join(str(list(each)) for each in shapes)
        raise ValueError(f"{where}: origin, direction, t_min, t_max must be one for each ray, got {listed}") from None
    origin, direction = (jnp.broadcast_to(jnp.asarray(v), (*shape, 3)) for v in (rays.origin, rays.direction))
    t_min, t_max = (jnp.broadcast_to(t, shape) for t in limits)
    return origin, direction, t_min, t_max


def _in_order(p: Float[Array, "f 3"], q: Float[Array, "f 3"]) -> tuple[Float[Array, "f 3"], Float[Array, "f 3"]]:
    """Two corners, the one of lower x first, then of lower y, then of lower z."""
    x, y, z = ((q[:, k], p[:, k]) for k in range(3))
    swap = (x[0] < x[1]) | ((x[0] == x[1]) & ((y[0] < y[1]) | ((y[0] == y[1]) & (z[0] < z[1]))))
    return jnp.where(swap[:, None], q, p), jnp.where(swap[:, None], p, q)


def canonical(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> tuple[Float32[Array, "f 3 3"], Stats]:
    """Corners of each face by their coordinates, and how many faces can never be hit: their corners are all 0."""
    exists = jnp.all((faces >= 0) & (faces < vertices.shape[0]), axis=1)
    points = vertices[jnp.where(exists[:, None], faces, 0)].astype(jnp.float32)
    finite = jnp.all(jnp.abs(points) < LIMIT, axis=(1, 2))
    points = jnp.where((exists & finite)[:, None, None], points, 0.0)
    a, b, c = points[:, 0], points[:, 1], points[:, 2]
    a, b = _in_order(a, b)
    b, c = _in_order(b, c)
    a, b = _in_order(a, b)

    # Round both products, which a comparison forces: equal ones must cancel for corners on a line.
    u, v = b - a, c - a
    products = jnp.stack([u[:, i] * v[:, j] for i, j in ((1, 2), (2, 1), (2, 0), (0, 2), (0, 1), (1, 0))])
    products = jnp.where(jnp.abs(products) < jnp.inf, products, 0.0)
    solid = jnp.any(products[0::2] != products[1::2], axis=0)
    corners = jnp.where(solid[:, None, None], jnp.stack([a, b, c], axis=1), 0.0)
    return corners, Stats(
        non_finite=jnp.sum(exists & ~finite, dtype=jnp.int32),
        degenerate=jnp.sum(exists & finite & ~solid, dtype=jnp.int32),
        out_of_range=jnp.sum(~exists, dtype=jnp.int32),
    )


def main_axis(direction: Sequence[Float32[Array, "*b"]]) -> Int[Array, "*b"]:
    """The axis along which a direction is longest, the last one of equals."""
    x, y, z = (jnp.abs(component) for component in direction)
    return jnp.where((z >= x) & (z >= y), 2, jnp.where(y >= x, 1, 0)).astype(jnp.int32)


def turned(point, axis):
    """Three coordinates in the order of `AXES`, the main axis' last."""
    orders = [[point[k] for k in axes] for axes in AXES]
    return [jnp.where(axis == 2, z, jnp.where(axis == 1, y, x)) for x, y, z in zip(*orders)]


def strike(corners, origin, shear, per_z) -> tuple[Bool[Array, "*b"], Float32[Array, "*b"]]:
    """Whether the line meets the triangle, and at which t; both sides count.

    Of a line in the triangle's own plane, all three edge functions are rounding: it may count as met from beside.

    `corners` are nine arrays, those of `canonical` and the origin's three being in the order of `AXES` for the
    direction's main axis; `shear` is (d_x, d_y) / d_z and `per_z` 1 / d_z.
    """
    points = []
    for k in range(3):
        x, y, z = (corners[3 * k + i] - origin[i] for i in range(3))
        points.append((x - shear[0] * z, y - shear[1] * z, z))
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = points
    bc, ac, ab = bx * cy - by * cx, ax * cy - ay * cx, ax * by - ay * bx
    total = (bc - ac) + ab
    inside = ((bc >= 0) & (ac <= 0) & (ab >= 0)) | ((bc <= 0) & (ac >= 0) & (ab <= 0))
    return inside & (total != 0), (bc * az - ac * bz + ab * cz) / total * per_z


def _corners(vertices, faces, face) -> list[Float[Array, "*b 3"]]:
    """The three corners of each given face, of a harmless one where it is -1."""
    table = jnp.concatenate([vertices[faces].reshape(-1, 9), jnp.array([[0, 0, 0, 1, 0, 0, 0, 1, 0]], vertices.dtype)])
    row = fetch(table, jnp.where(face < 0, faces.shape[0], face))
    return [row[..., 3 * k : 3 * k + 3] for k in range(3)]


def _check(where, vertices, faces, face):
    fit(f"{where}: vertices", vertices, Float[Array, "v 3"], batched=False)
    fit(f"{where}: faces", faces, Int[Array, "f 3"])
    fit(f"{where}: face", face, Int[Array, "*b"])
    below(f"{where}: faces", faces, vertices.shape[0], "vertices")
    below(f"{where}: face", face, faces.shape[0], "faces", least=-1)
    return jnp.asarray(vertices), jnp.asarray(faces), jnp.asarray(face)


def intersection(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], face: Int[Array, "*b"], rays: Rays
) -> tuple[Float[Array, "*b"], Float[Array, "*b 3"]]:
    """t and barycentrics at which each ray meets the plane of its face; inf and 0 where the face is -1.

    With u = b - a, v = c - a, s = o - a: β_b = s · (d × v) / D, β_c = d · (s × u) / D and t = v · (s × u) / D, where
    D = u · (d × v). Barycentrics sum to 1 and are not clamped.
    Gradient: exact in vertices and rays; 0 where the face is -1 or seen edge-on.

    Example:
        >>> vertices, faces = jnp.eye(3), jnp.array([[0, 1, 2]])
        >>> rays = Rays(origin=jnp.zeros((1, 3)), direction=jnp.array([[0.5, 0.25, 0.25]]))
        >>> t, barycentric = intersection(vertices, faces, jnp.array([0]), rays)
        >>> t.round(5).tolist(), barycentric.round(5).tolist()
        ([1.0], [[0.5, 0.25, 0.25]])
    """
    vertices, faces, face = _check("intersection", vertices, faces, face)
    origin, direction, *_ = check_rays("intersection: rays", rays)
    if face.shape != origin.shape[:-1]:
        raise ValueError(f"intersection: face must be one per ray, {list(origin.shape[:-1])}, got {list(face.shape)}")
    a, b, c = _corners(vertices, faces, face)
    # Divide by the face's size, so that the products of four lengths stay within float32 at any scale.
    size = lax.stop_gradient(jnp.max(jnp.abs(jnp.concatenate([b - a, c - a], axis=-1)), axis=-1))[..., None]
    size = jnp.where(size > safe.TINY, size, 1.0)
    u, v, s, d = (b - a) / size, (c - a) / size, (origin - a) / size, safe.normalize(direction)
    across, along = jnp.cross(d, v), jnp.cross(s, u)
    whole = safe.dot(u, across)
    beta_b, beta_c, distance = (safe.divide(safe.dot(*pair), whole) for pair in ((s, across), (d, along), (v, along)))
    t = safe.divide(distance * size[..., 0], safe.length(direction))
    beta = jnp.stack([1.0 - beta_b - beta_c, beta_b, beta_c], axis=-1)
    return jnp.where(face >= 0, t, jnp.inf), jnp.where((face >= 0)[..., None], beta, 0.0)


def spawn(
    vertices: Float[Array, "v 3"],
    faces: Int[Array, "f 3"],
    face: Int[Array, "*b"],
    barycentric: Float[Array, "*b 3"],
    direction: Float[Array, "*b 3"],
) -> Rays:
    """Rays that leave places on faces and do not meet the same face again; none, of direction 0, where it is -1.

    p = a + β_b (b - a) + β_c (c - a), moved off the face to the direction's side by 2⁻²⁰ M + min(2⁻²⁰ L²/h, 2⁻¹⁰ L):
    M is the face's largest coordinate, L its longest edge and h its height above it. Without the minimum, this bounds
    what rounding can do to p and to the test, so that no constant in metres is needed. The minimum, from h < L / 1024
    on, keeps places of slivers near them: never farther off than 2⁻²⁰ M + 2⁻¹⁰ L.
    Gradient: exact in vertices, barycentrics and direction; 0 through the offset.
    Source: after Pharr, Jakob & Humphreys 2023, "Physically Based Rendering", 6.8.6, whose bound goes without L²/h
    because its test rejects small t; ours has no such test.

    Example:
        >>> vertices, faces = jnp.eye(3), jnp.array([[0, 1, 2]])
        >>> rays = spawn(vertices, faces, jnp.array([0]), jnp.array([[0.5, 0.25, 0.25]]), jnp.array([[1.0, 0, 0]]))
        >>> bool(abs(rays.origin[0, 0] - 0.5) < 1e-5), bool(rays.origin[0].sum() > 1)
        (True, True)
    """
    vertices, faces, face = _check("spawn", vertices, faces, face)
    fit("spawn: barycentric", barycentric, Float[Array, "*b 3"])
    fit("spawn: direction", direction, Float[Array, "*b 3"])
    a, b, c = _corners(vertices, faces, face)
    u, v = b - a, c - a
    place = a + barycentric[..., 1:2] * u + barycentric[..., 2:3] * v
    # The offset alone: a constant, whatever is differentiated.
    a, u, v, towards = lax.stop_gradient((a, u, v, direction))
    longest = jnp.maximum(jnp.maximum(safe.length(u), safe.length(v)), safe.length(u - v))
    scale = jnp.where(longest > safe.TINY, longest, 1.0)
    cross = jnp.cross(u / scale[..., None], v / scale[..., None])
    sliver = safe.divide(longest, safe.length(cross))
    coordinate = jnp.max(jnp.abs(jnp.concatenate([a, a + u, a + v], axis=-1)), axis=-1)
    normal = safe.normalize(cross)
    side = jnp.where(safe.dot(normal, towards) < 0, -1.0, 1.0).astype(normal.dtype)
    distance = OFFSET * coordinate + jnp.minimum(OFFSET * sliver, FARTHEST * longest)
    step = (side * distance)[..., None] * normal
    hit = (face >= 0)[..., None]
    return Rays(origin=jnp.where(hit, place + step, 0.0), direction=jnp.where(hit, direction, 0.0))
