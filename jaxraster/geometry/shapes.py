"""Simple shapes as meshes, and how to place and merge them.

Shapes are centred on the origin, +Y up, in metres, with outward counter-clockwise faces, exact unit normals, tangents
and uvs (u to the right, v downwards, seen from outside). Where a seam or an edge needs a vertex twice, both have the
same position to the last bit, so that nothing shines through. They are made on the host, in float64, then rounded.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math.safe import dot, normalize
from ..math.transform import multiply, transform_points
from ..scene import Mesh


def _mesh(vertices, normals, tangents, uvs, faces) -> Mesh:
    """A mesh of material 0 whose uvs are nowhere mirrored, less the triangles in which two corners coincide."""
    corners = np.asarray(vertices, np.float32)[faces]
    distinct = (corners != np.roll(corners, 1, axis=1)).any(axis=2).all(axis=1)
    used, faces = np.unique(faces[distinct], return_inverse=True)
    tangents = np.concatenate([tangents, np.ones((len(tangents), 1))], axis=1)
    vertices, normals, tangents, uvs = (
        jnp.asarray(np.asarray(a, np.float32)[used]) for a in (vertices, normals, tangents, uvs)
    )
    faces = jnp.asarray(faces.reshape(-1, 3).astype(np.int32))
    material = jnp.zeros(len(faces), jnp.int32)
    return Mesh(vertices=vertices, normals=normals, tangents=tangents, uvs=uvs, faces=faces, material=material)


def _grid(vertices, normals, tangents, u, v) -> tuple:
    """Arguments of `_mesh` for points `[rows, columns, 3]` seen from outside, row 0 on top, and their u and v."""
    rows, columns = len(v), len(u)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (i * columns + j).reshape(-1, 1)
    faces = a + np.array([[0, columns, columns + 1, 0, columns + 1, 1]])
    uvs = np.stack(np.meshgrid(u, v), axis=-1)
    return *(x.reshape(-1, x.shape[-1]) for x in (vertices, normals, tangents, uvs)), faces.reshape(-1, 3)


def lathe(profile: Float[np.ndarray, "k 2"], normals: Float[np.ndarray, "k 2"], segments: int = 48) -> Mesh:
    """A profile of (radius, height) points and their (radial, vertical) normals, turned about +Y.

    The profile runs downwards where its outside is to the right; give a point twice, with both normals, for a sharp
    edge. u runs once around, v along the profile's length.
    """
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    # Close the circle with its first point itself: sin 2π is not 0.
    angle = np.arange(segments + 1) % segments * (2 * np.pi / segments)
    sin, cos = np.sin(angle), np.cos(angle)

    def turn(points):
        radial, height = points[:, :1], points[:, 1:]
        return np.stack([radial * sin, np.broadcast_to(height, (len(points), len(sin))), radial * cos], axis=-1)

    tangents = np.broadcast_to(np.stack([cos, 0 * cos, -sin], axis=-1), (len(profile), segments + 1, 3))
    length = np.cumsum([0.0, *np.linalg.norm(np.diff(profile, axis=0), axis=1)])
    u = np.linspace(0.0, 1.0, segments + 1)
    return _mesh(*_grid(turn(profile), turn(normals), tangents, u, length / length[-1]))


def uv_sphere(radius: float = 1.0, segments: int = 48, rings: int = 24) -> Mesh:
    """A sphere of meridians and parallels; u = 0 at +Z and growing towards +X, v = 0 at +Y."""
    polar = np.linspace(0.0, np.pi, rings + 1)
    unit = np.stack([np.sin(polar), np.cos(polar)], axis=1)
    unit[-1] = 0.0, -1.0
    return lathe(radius * unit, unit, segments)


def cylinder(radius: float = 0.5, height: float = 1.0, segments: int = 48) -> Mesh:
    """A cylinder along Y with flat caps."""
    r, h = radius, 0.5 * height
    profile = np.array([(0.0, h), (r, h), (r, h), (r, -h), (r, -h), (0.0, -h)])
    normals = np.array([(0.0, 1.0), (0.0, 1.0), (1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, -1.0)])
    return lathe(profile, normals, segments)


def torus(radius: float = 1.0, tube: float = 0.25, segments: int = 48, rings: int = 24) -> Mesh:
    """A ring in the XZ plane: `radius` to the middle of the tube, which has radius `tube`; v = 0 is its inside."""
    angle = np.pi - np.arange(rings + 1) % rings * (2 * np.pi / rings)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return lathe(np.array([radius, 0.0]) + tube * unit, unit, segments)


def plane(width: float = 1.0, depth: float = 1.0) -> Mesh:
    """A rectangle in the XZ plane that faces +Y; seen from above with -Z upwards, its image is upright."""
    x, z = np.meshgrid([-0.5 * width, 0.5 * width], [-0.5 * depth, 0.5 * depth])
    up, right = (np.broadcast_to(axis, (2, 2, 3)) for axis in ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)))
    return _mesh(*_grid(np.stack([x, 0 * x, z], axis=-1), up, right, [0.0, 1.0], [0.0, 1.0]))


def box(size: tuple[float, float, float] = (1.0, 1.0, 1.0), radius: float = 0.0, segments: int = 4) -> Mesh:
    """A box of full extents `size`, its edges rounded to `radius` over 2 `segments` strips; each side a whole image.

    Each point q of the sharp box goes to inner + radius · (q - inner)/|q - inner|, where inner is the nearest point
    of the box shrunk by radius; strips at tan(angle) on the sharp box become equal arcs.
    """
    half = 0.5 * np.asarray(size, float)
    radius = min(radius, half.min())
    offsets = radius * np.tan(np.linspace(0.0, 0.25 * np.pi, segments + 1)) if radius > 0 else np.zeros(1)
    parts = []
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)):
        normal = sign * np.eye(3)[axis]
        up = np.array([0.0, 1.0, 0.0]) if axis != 1 else np.array([0.0, 0.0, -sign])
        right = np.cross(up, normal)
        along, down = (_ticks(float(np.abs(d) @ half), radius, offsets) for d in (right, up))
        s, t = along, down[::-1]
        sharp = normal * (np.abs(normal) @ half) + s[None, :, None] * right + t[:, None, None] * up
        inner = np.clip(sharp, radius - half, half - radius)
        outwards = sharp - inner if radius > 0 else np.broadcast_to(normal, sharp.shape)
        outwards = outwards / np.linalg.norm(outwards, axis=-1, keepdims=True)
        tangents = right - outwards * (outwards @ right)[..., None]
        tangents = tangents / np.linalg.norm(tangents, axis=-1, keepdims=True)
        u, v = (s - s[0]) / (s[-1] - s[0]), (t[0] - t) / (t[0] - t[-1])
        parts.append(_grid(inner + radius * outwards, outwards, tangents, u, v))
    *columns, faces = zip(*parts)
    offsets = np.cumsum([0, *(len(part[0]) for part in parts[:-1])])
    vertices, normals, tangents, uvs = (np.concatenate(column) for column in columns)
    return _mesh(vertices, normals, tangents, uvs, np.concatenate([f + o for f, o in zip(faces, offsets)]))


def _ticks(half: float, radius: float, offsets: np.ndarray) -> np.ndarray:
    """Where a side of the box is cut: within `radius` of both ends; the ends to the last bit at ±half."""
    upper = half - radius + offsets
    upper[-1] = half
    return np.concatenate([-upper[::-1], upper])


def icosphere(radius: float = 1.0, subdivisions: int = 3) -> Mesh:
    """A sphere of 20 · 4^subdivisions nearly equal triangles, with the uvs of `uv_sphere`; u passes 1 at the seam."""
    g = 0.5 * (1.0 + np.sqrt(5.0))
    ring = np.array([[0, s, t * g] for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([np.roll(ring, k, axis=1) for k in range(3)])
    points = points / np.linalg.norm(points[0])
    # Find the faces as the triples of mutual neighbours, turned so that they face outwards.
    near = points @ points.T > 0.4
    triples = np.array([(a, b, c) for a in range(12) for b in range(a) for c in range(b)])
    a, b, c = triples[near[triples, np.roll(triples, 1, axis=1)].all(axis=1)].T
    outward = (np.cross(points[a], points[b]) * points[c]).sum(axis=1) > 0
    faces = np.stack([a, np.where(outward, b, c), np.where(outward, c, b)], axis=1)
    for _ in range(subdivisions):
        edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = points[unique].sum(axis=1)
        ab, bc, ca = len(points) + which.reshape(-1, 3).T
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        a, b, c = faces.T
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    # Unroll u across the seam, and give a pole the mean u of the edge it faces.
    u = (np.arctan2(points[:, 0], points[:, 2]) / (2 * np.pi) % 1.0)[faces]
    pole = (points[:, 0] ** 2 + points[:, 2] ** 2 == 0)[faces]
    u = u + ((np.where(pole, 0.0, u).max(axis=1, keepdims=True) - u > 0.5) & ~pole)
    u = np.where(pole, 0.5 * np.where(pole, 0.0, u).sum(axis=1, keepdims=True), u)
    keys, index = np.unique(np.stack([faces, u], axis=-1).reshape(-1, 2), axis=0, return_inverse=True)
    unit, u = points[keys[:, 0].astype(int)], keys[:, 1]
    tangents = np.stack([np.cos(2 * np.pi * u), 0 * u, -np.sin(2 * np.pi * u)], axis=1)
    v = np.arccos(np.clip(unit[:, 1], -1.0, 1.0)) / np.pi
    return _mesh(radius * unit, unit, tangents, np.stack([u, v], axis=1), index.reshape(-1, 3))


@jax.jit
def _move(mesh: Mesh, matrix: Float[Array, "4 4"]) -> Mesh:
    linear = matrix[:3, :3]
    columns = [linear[:, i] for i in range(3)]
    cofactors = jnp.stack([jnp.cross(columns[(i + 1) % 3], columns[(i + 2) % 3]) for i in range(3)], axis=1)
    mirrored = dot(cofactors[:, 0], columns[0]) < 0
    sign = jnp.where(mirrored, -1.0, 1.0).astype(matrix.dtype)
    tangents = normalize(multiply(mesh.tangents[..., :3], linear.T))
    return replace(
        mesh,
        vertices=transform_points(matrix, mesh.vertices)[..., :3],
        normals=normalize(sign * multiply(mesh.normals, cofactors.T)),
        tangents=jnp.concatenate([tangents, sign * mesh.tangents[..., 3:]], axis=-1),
        faces=jnp.where(mirrored, mesh.faces[:, ::-1], mesh.faces),
    )


def place(mesh: Mesh, matrix: Float[Array, "4 4"], material: int | None = None) -> Mesh:
    """The mesh moved by an affine matrix and, if given, with row `material` of the materials on all its faces.

    p → M p + c, t → M t, n → cof(M) n · sign(det M): cofactors instead of the inverse also allow flattening a mesh.
    A mirroring matrix reverses the corners' order and the bitangents' sign.
    Gradient: exact in mesh and matrix.
    """
    moved = _move(mesh, matrix)
    return moved if material is None else replace(moved, material=jnp.full_like(mesh.material, material))


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of many; of none, the empty mesh. Second uvs and colours are 0 and white where a mesh has none."""
    if not meshes:
        shapes = {"vertices": 3, "normals": 3, "tangents": 4, "uvs": 2}
        floats = {name: jnp.zeros((0, n), jnp.float32) for name, n in shapes.items()}
        return Mesh(**floats, faces=jnp.zeros((0, 3), jnp.int32), material=jnp.zeros(0, jnp.int32))
    offsets = np.cumsum([0, *(m.vertices.shape[-2] for m in meshes)], dtype=np.int32)
    join = {n: jnp.concatenate([getattr(m, n) for m in meshes], -2) for n in ("vertices", "normals", "tangents", "uvs")}
    for name, filler in (("second_uvs", jnp.zeros((1, 2))), ("colors", jnp.ones((1, 4)))):
        if any(getattr(m, name) is not None for m in meshes):
            parts = [getattr(m, name) for m in meshes]
            fillers = [jnp.broadcast_to(filler, (*m.vertices.shape[:-1], filler.shape[1])) for m in meshes]
            join[name] = jnp.concatenate([f if p is None else p for p, f in zip(parts, fillers)], -2)
    return Mesh(
        **join,
        faces=jnp.concatenate([m.faces + int(o) for m, o in zip(meshes, offsets)]),
        material=jnp.concatenate([m.material for m in meshes]),
    )
