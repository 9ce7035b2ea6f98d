"""Shapes: watertight, outward, of the right size, with frames that fit their surfaces."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.geometry import shapes
from jaxraster.geometry.normals import face_normals, vertex_tangents
from jaxraster.math.transform import rotation

# Each closed shape with its exact volume and area (None: by inclusion of the pieces below).
PI = np.pi
ROUND = (2.0, 3.0, 4.0), 0.5  # inner box 1 × 2 × 3, grown by 0.5 (Steiner's formula)
CLOSED = {
    "icosphere": (shapes.icosphere(2.0, 3), 32 * PI / 3, 16 * PI),
    "uv_sphere": (shapes.uv_sphere(2.0, 64, 32), 32 * PI / 3, 16 * PI),
    "cylinder": (shapes.cylinder(0.5, 3.0, 96), 0.75 * PI, 3.5 * PI),
    "torus": (shapes.torus(1.0, 0.25, 96, 48), PI**2 / 8, PI**2),
    "box": (shapes.box((1.0, 2.0, 3.0)), 6.0, 22.0),
    "rounded box": (shapes.box(*ROUND), 6 + 11 + 0.25 * PI * 6 + PI / 6, 22 + PI * 6 + PI),
    "ball of a box": (shapes.box((2.0, 2.0, 2.0), 1.0, 16), 4 * PI / 3, 4 * PI),
}


def _corners(mesh):
    return np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]


@pytest.mark.parametrize("name", CLOSED)
def test_every_edge_is_shared_by_two_opposite_half_edges(name):
    corners = _corners(CLOSED[name][0])
    points, index = np.unique(corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    halves = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    forward, count = np.unique(halves, axis=0, return_counts=True)
    assert (count == 1).all() and (halves[:, 0] != halves[:, 1]).all()
    np.testing.assert_array_equal(forward, np.unique(halves[:, ::-1], axis=0))
    # Euler: vertices - edges + faces is 2, and 0 for a surface with one hole.
    assert len(points) - len(halves) // 2 + len(faces) == (0 if name == "torus" else 2)


@pytest.mark.parametrize("name", CLOSED)
def test_volume_and_area(name):
    mesh, volume, area = CLOSED[name]
    a, b, c = np.moveaxis(_corners(mesh), 1, 0)
    exact = {"box": 1e-6}.get(name, 0.02)
    np.testing.assert_allclose((a * np.cross(b, c)).sum() / 6, volume, rtol=exact)
    np.testing.assert_allclose(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, area, rtol=exact)


def test_a_finer_sphere_is_four_times_as_near():
    def volume(mesh):
        a, b, c = np.moveaxis(_corners(mesh), 1, 0)
        return (a * np.cross(b, c)).sum() / 6

    for make in (lambda k: shapes.icosphere(1.0, 2 + k), lambda k: shapes.uv_sphere(1.0, 16 * 2**k, 8 * 2**k)):
        errors = [4 * PI / 3 - volume(make(k)) for k in (0, 1)]
        assert 3.8 < errors[0] / errors[1] < 4.2


PLANE = shapes.plane(2.0, 3.0)


@pytest.fixture(scope="module")
def derived_tangents():
    """What `vertex_tangents` finds for each shape, all compiled as one mesh."""
    meshes = {name: mesh for name, (mesh, _, _) in CLOSED.items()} | {"plane": PLANE}
    both = shapes.merge(list(meshes.values()))
    tangents = np.asarray(jax.jit(vertex_tangents)(both.vertices, both.normals, both.uvs, both.faces))
    ends = np.cumsum([len(m.vertices) for m in meshes.values()])
    return dict(zip(meshes, np.split(tangents, ends[:-1])))


@pytest.mark.parametrize("name", [*CLOSED, "plane"])
def test_frames_fit_the_surface(name, derived_tangents):
    mesh = PLANE if name == "plane" else CLOSED[name][0]
    vertices, normals, tangents, uvs, faces = (
        np.asarray(getattr(mesh, n)) for n in ("vertices", "normals", "tangents", "uvs", "faces")
    )
    assert vertices.dtype == normals.dtype == tangents.dtype == uvs.dtype == np.float32 and faces.dtype == np.int32
    assert mesh.material.shape == (len(faces),) and np.unique(faces).tolist() == list(range(len(vertices)))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=2e-7)
    np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1, atol=2e-7)
    np.testing.assert_allclose((tangents[:, :3] * normals).sum(1), 0, atol=2e-7)
    # Every corner's normal lies on its face's outer side, and the tangents are those that the uvs define.
    a, b, c = np.moveaxis(_corners(mesh), 1, 0)
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert (np.einsum("fkx,fx->fk", normals[faces], flat) > 0.7).all()
    derived = derived_tangents[name]
    cosine = (derived[:, :3] * tangents[:, :3]).sum(1)
    np.testing.assert_array_equal(derived[:, 3], tangents[:, 3])
    assert cosine.min() > 0.7 and np.median(cosine) > 0.99
    low, high = uvs.min(0), uvs.max(0)
    assert low.min() == 0 and high[1] == 1 and (1 <= high[0] < 1.25 if name == "icosphere" else high[0] == 1)


def test_a_sphere_shows_its_picture_upright():
    mesh = shapes.uv_sphere(1.0, 8, 4)
    by_uv = {tuple(uv): p for uv, p in zip(np.asarray(mesh.uvs).tolist(), np.asarray(mesh.vertices))}
    np.testing.assert_allclose(by_uv[0.0, 0.5], [0, 0, 1], atol=1e-7)
    np.testing.assert_allclose(by_uv[0.25, 0.5], [1, 0, 0], atol=1e-7)
    np.testing.assert_allclose(by_uv[0.25, 0.0], [0, 1, 0], atol=1e-7)


def test_both_spheres_have_the_same_uvs():
    mesh = shapes.icosphere(1.0, 2)
    u, v = np.asarray(mesh.uvs, float).T * 2 * PI
    at_uv = np.stack([np.sin(v / 2) * np.sin(u), np.cos(v / 2), np.sin(v / 2) * np.cos(u)], axis=1)
    np.testing.assert_allclose(at_uv, mesh.vertices, atol=1e-6)
    # No triangle may sweep back over the picture.
    width = np.ptp(np.asarray(mesh.uvs)[np.asarray(mesh.faces), 0], axis=1)
    assert width.max() < 0.26


def test_rounding_by_nothing_is_a_box_and_by_too_much_a_capsule():
    size = (1.0, 2.0, 3.0)
    assert shapes.box(size).faces.shape == shapes.box(size, 0.0, 9).faces.shape == (12, 3)
    extent = np.ptp(np.asarray(shapes.box(size, 9.0).vertices), axis=0)
    np.testing.assert_allclose(extent, size, rtol=1e-6)


MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
SHEAR = np.array([[2, 0.5, 0, 1], [0, 1, 0.3, 2], [0, 0, 0.5, 3], [0, 0, 0, 1]])
TURN = np.eye(4)
TURN[:3, :3] = rotation(jnp.array([1.0, 2.0, 3.0]), 1.0)


@pytest.mark.parametrize("matrix", [np.eye(4), MIRROR, SHEAR, SHEAR @ MIRROR, TURN])
def test_a_placed_mesh_keeps_its_frames(matrix):
    mesh = shapes.box((1.0, 2.0, 3.0))
    placed = shapes.place(mesh, jnp.asarray(matrix, jnp.float32), 7)
    points = np.asarray(mesh.vertices) @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(placed.vertices, points, atol=1e-6)
    assert (placed.material == 7).all() and placed.material.dtype == jnp.int32
    flat = np.asarray(face_normals(placed.vertices, placed.faces))
    for corner in range(3):
        np.testing.assert_allclose(np.asarray(placed.normals)[np.asarray(placed.faces)[:, corner]], flat, atol=1e-6)
    # The bitangent is carried along like a direction on the surface, up to what is normal or along the tangent.
    n, t = np.asarray(placed.normals), np.asarray(placed.tangents)
    b = np.cross(mesh.normals, mesh.tangents[:, :3]) * np.asarray(mesh.tangents)[:, 3:] @ matrix[:3, :3].T
    assert ((np.cross(n, t[:, :3]) * t[:, 3:] * b).sum(1) > 0.3).all()
    np.testing.assert_allclose((n * t[:, :3]).sum(1), 0, atol=1e-6)


def test_a_mesh_can_be_flattened_and_differentiated():
    mesh = shapes.box()
    flat = shapes.place(mesh, jnp.diag(jnp.array([1.0, 0.0, 1.0, 1.0])))
    assert set(np.asarray(jnp.abs(flat.normals)).sum(1).tolist()) == {0.0, 1.0}

    def height(matrix):
        moved = shapes.place(mesh, matrix)
        return moved.vertices[:, 1].sum() + moved.normals[:, 1].sum() + moved.tangents[:, 0].sum()

    gradient = jax.grad(height)(jnp.eye(4))
    assert jnp.isfinite(gradient).all() and gradient[1, 3] == 24


def test_merging():
    ball, slab = shapes.icosphere(1.0, 0), replace(shapes.plane(), material=jnp.full(2, 5, jnp.int32))
    both = shapes.merge([ball, slab])
    v, f = ball.vertices.shape[0], ball.faces.shape[0]
    np.testing.assert_array_equal(both.vertices[both.faces[f:]], slab.vertices[slab.faces])
    np.testing.assert_array_equal(both.faces[:f], ball.faces)
    np.testing.assert_array_equal(both.tangents[v:], slab.tangents)
    assert both.material.tolist() == [0] * f + [5, 5]


def test_merging_nothing():
    empty = shapes.merge([])
    assert empty.vertices.shape == (0, 3) and empty.tangents.shape == (0, 4) and empty.uvs.shape == (0, 2)
    assert empty.faces.shape == (0, 3) and empty.faces.dtype == jnp.int32 and empty.material.shape == (0,)
    np.testing.assert_array_equal(shapes.merge([empty, shapes.plane()]).faces, shapes.plane().faces)
