"""Normals and tangents: known answers, any scale, degenerate triangles, gradients, and an artist's tangents."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.geometry import normals as plain

face_normals, vertex_normals, vertex_tangents = map(
    jax.jit, (plain.face_normals, plain.vertex_normals, plain.vertex_tangents)
)

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]], np.float32)
ONE = jnp.array([[0, 1, 2]], jnp.int32)
QUAD = jnp.array([[0, 1, 2], [0, 2, 3]], jnp.int32)
S = np.float32(np.sqrt(0.5))


def _cube() -> tuple[jax.Array, jax.Array]:
    """[-1, 1]³ by eight shared corners, each side cut along whichever diagonal its corners' order gives."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    faces = []
    for axis in range(3):
        for sign in (-1, 1):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            ring = [(-1, -1), (1, -1), (1, 1), (-1, 1)][:: 1 if sign > 0 else -1]
            q = []
            for s, t in ring:
                p = np.zeros(3)
                p[[axis, a, b]] = sign, s, t
                q.append(int(np.flatnonzero((corners == p).all(1))[0]))
            faces += [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]
    return jnp.asarray(corners), jnp.array(faces, jnp.int32)


@pytest.mark.parametrize("scale", [1e-25, 1e-20, 1e-3, 1.0, 1e5, 1e20, 1e37])
def test_a_face_normal_does_not_depend_on_scale(scale):
    n = face_normals(jnp.asarray(TRIANGLE * np.float32(scale)), ONE)
    np.testing.assert_allclose(n, [[0, -S, S]], atol=2e-7)


def test_a_face_normal_far_from_the_origin():
    far = TRIANGLE * np.float32(0.25) + np.float32([1e6, -1e6, 1e6])
    np.testing.assert_allclose(face_normals(jnp.asarray(far), ONE), [[0, -S, S]], atol=2e-7)


DEGENERATE = {
    "a point": [[1, 2, 3]] * 3,
    "first twice": [[0.1, 0.2, 0.3], [0.1, 0.2, 0.3], [0.7, -0.3, 0.9]],
    "last twice": [[0.1, 0.2, 0.3], [0.7, -0.3, 0.9], [0.7, -0.3, 0.9]],
    "collinear": [[0, 0, 0], [0.1, 0.7, 0.3], [0.3, 2.1, 0.9]],
    "denormal": [[0, 0, 0], [1e-39, 0, 0], [0, 1e-39, 0]],
    "overflowing": [[-3e38, 0, 0], [3e38, 0, 0], [0, 1, 0]],
    "not a number": [[0, 0, 0], [1, np.nan, 0], [0, 1, 0]],
    "infinite": [[0, 0, 0], [np.inf, 0, 0], [0, 1, 0]],
}


def _both(vertices):
    return plain.face_normals(vertices, ONE), plain.vertex_normals(vertices, ONE)


FORWARD, REVERSE = jax.jit(jax.jacfwd(_both)), jax.jit(jax.jacrev(_both))


@pytest.mark.parametrize("name", DEGENERATE)
def test_a_degenerate_triangle_has_no_normal_and_no_gradient(name):
    vertices = jnp.array(DEGENERATE[name], jnp.float32)
    assert (face_normals(vertices, ONE) == 0).all()
    np.testing.assert_array_equal(vertex_normals(vertices, ONE), [[0, 1, 0]] * 3)
    for forward, reverse in zip(jax.tree.leaves(FORWARD(vertices)), jax.tree.leaves(REVERSE(vertices))):
        assert (forward == 0).all() and (reverse == 0).all()


def test_a_degenerate_neighbour_changes_nothing():
    good = jnp.asarray(TRIANGLE)
    both = jnp.concatenate([good, jnp.array([[jnp.nan, 0.0, 0.0]])])
    faces = jnp.array([[0, 1, 2], [0, 1, 3], [1, 1, 2]], jnp.int32)
    np.testing.assert_allclose(vertex_normals(both, faces)[:3], vertex_normals(good, ONE), atol=1e-7)
    slope = jax.jit(jax.grad(lambda v, f: plain.vertex_normals(v, f)[:3, 1].sum()))
    alone, gradient = slope(good, ONE), slope(both, faces)
    np.testing.assert_allclose(gradient[:3], alone, atol=1e-6)
    assert (gradient[3] == 0).all() and jnp.abs(alone).max() > 0.1


def test_a_cubes_corners_point_along_its_diagonals():
    vertices, faces = _cube()
    np.testing.assert_allclose(vertex_normals(vertices, faces), vertices / np.sqrt(3), atol=3e-7)


def test_an_unused_vertex_points_up():
    vertices = jnp.concatenate([jnp.asarray(TRIANGLE), jnp.full((1, 3), 7.0)])
    np.testing.assert_array_equal(vertex_normals(vertices, ONE)[3], [0, 1, 0])


def test_nothing_has_no_normals():
    none, faces = jnp.zeros((0, 3)), jnp.zeros((0, 3), jnp.int32)
    assert face_normals(none, faces).shape == vertex_normals(none, faces).shape == (0, 3)
    assert vertex_tangents(none, none, jnp.zeros((0, 2)), faces).shape == (0, 4)


def test_a_batch_is_its_members():
    vertices, faces = _cube()
    batch = jnp.stack([vertices, vertices**2 * jnp.array([[3.0, 2.0, 1.0]]) + 0.1 * vertices])
    for function in (face_normals, vertex_normals):
        together, mapped = function(batch, faces), jax.vmap(function, (0, None))(batch, faces)
        for i in (0, 1):
            np.testing.assert_allclose(together[i], function(batch[i], faces), atol=1e-6)
            np.testing.assert_allclose(mapped[i], together[i], atol=1e-6)


def test_derivatives_agree_with_finite_differences():
    # Take a point where every corner is shared by triangles of different planes and sizes, in float64.
    with jax.enable_x64(True):
        vertices, faces = _cube()
        rng = np.random.default_rng(1)
        vertices = jnp.asarray(np.asarray(vertices, float) + 0.2 * rng.standard_normal((8, 3)))
        uvs = jnp.asarray(rng.uniform(size=(8, 2)))
        weights = jnp.asarray(rng.standard_normal((8, 7)))

        @jax.jit
        def loss(v):
            n = plain.vertex_normals(v, faces)
            return (jnp.concatenate([n, plain.vertex_tangents(v, n, uvs, faces)], axis=1) * weights).sum()

        step = jnp.asarray(rng.standard_normal((8, 3)))
        value, forward = jax.jit(lambda v: jax.jvp(loss, (v,), (step,)))(vertices)
        reverse = (jax.jit(jax.grad(loss))(vertices) * step).sum()
        central = (loss(vertices + 1e-6 * step) - loss(vertices - 1e-6 * step)) / 2e-6
    assert abs(float(forward)) > 0.1 and np.isfinite(value)
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)
    np.testing.assert_allclose(forward, central, rtol=1e-6)


# A picture on a wall that faces +Z, seen upright: u to the right (+X), v down (-Y). A normal map's red then leans to +X
# and its green to +Y, the picture's top.
WALL = jnp.array([[0, 1, 0], [0, 0, 0], [2, 0, 0], [2, 1, 0]], jnp.float32)
UPRIGHT = jnp.array([[0, 0], [0, 1], [1, 1], [1, 0]], jnp.float32)
TOWARDS_Z = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (4, 3))


@pytest.mark.parametrize(
    ("uvs", "tangent", "bitangent"),
    [
        (UPRIGHT, [1, 0, 0], [0, 1, 0]),
        (UPRIGHT * jnp.array([[-1.0, 1.0]]), [-1, 0, 0], [0, 1, 0]),  # mirrored left to right
        (UPRIGHT * jnp.array([[1.0, -1.0]]), [1, 0, 0], [0, -1, 0]),  # upside down in a mirror
        (-UPRIGHT, [-1, 0, 0], [0, -1, 0]),  # turned by half
        (UPRIGHT[:, ::-1], [0, -1, 0], [-1, 0, 0]),  # transposed
        (UPRIGHT * 1e-20, [1, 0, 0], [0, 1, 0]),
        (UPRIGHT * 1e20, [1, 0, 0], [0, 1, 0]),
        (UPRIGHT * jnp.array([[100.0, 0.01]]) + 7.0, [1, 0, 0], [0, 1, 0]),
    ],
)
def test_the_frame_of_an_upright_picture(uvs, tangent, bitangent):
    t = vertex_tangents(WALL, TOWARDS_Z, uvs, QUAD)
    np.testing.assert_allclose(t[:, :3], [tangent] * 4, atol=1e-6)
    np.testing.assert_allclose(t[:, 3:] * np.cross(TOWARDS_Z, t[:, :3]), [bitangent] * 4, atol=1e-6)


SLOPES = jax.jit(jax.grad(lambda v, n, uv: plain.vertex_tangents(v, n, uv, QUAD).sum(), (0, 1, 2)))


@pytest.mark.parametrize("uvs", [0.0 * UPRIGHT, UPRIGHT[:, :1] * jnp.array([[0.1, 0.3]]), UPRIGHT * jnp.nan])
def test_uvs_without_area_still_give_a_frame(uvs):
    normals = jnp.array([[0, 0, 1], [0, 0, -1], [0, S, S], [S, -S, 0]], jnp.float32)

    t = vertex_tangents(WALL, normals, uvs, QUAD)
    np.testing.assert_allclose(np.linalg.norm(t[:, :3], axis=1), 1.0, atol=3e-7)
    np.testing.assert_allclose((t[:, :3] * normals).sum(1), 0.0, atol=3e-7)
    assert (t[:, 3] == 1).all()
    for gradient in SLOPES(WALL, normals, uvs):
        assert jnp.isfinite(gradient).all()


def test_tangents_are_perpendicular_to_tilted_normals():
    normals = jnp.array([[0.6, 0, 0.8], [0, 0.6, 0.8], [S, 0, S], [1, 0, 0]], jnp.float32)
    t = vertex_tangents(WALL, normals, UPRIGHT, QUAD)
    np.testing.assert_allclose((t[:, :3] * normals).sum(1), 0.0, atol=2e-7)
    np.testing.assert_allclose(t[0, :3], [0.8, 0, -0.6], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(t[:, :3], axis=1), 1.0, atol=3e-7)


def _helmet(folder):
    """Each primitive of the helmet as (positions, normals, tangents, uvs, faces)."""
    gltf = json.loads((folder / "FlightHelmet.gltf").read_text())
    blob = (folder / "FlightHelmet.bin").read_bytes()

    def read(index):
        a = gltf["accessors"][index]
        view = gltf["bufferViews"][a["bufferView"]]
        kind = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}[a["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[a["type"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        return np.frombuffer(blob, kind, a["count"] * width, start).reshape(-1, width)

    for mesh in gltf["meshes"]:
        for primitive in mesh["primitives"]:
            a = primitive["attributes"]
            faces = read(primitive["indices"]).reshape(-1, 3).astype(np.int32)
            yield [*map(read, (a["POSITION"], a["NORMAL"], a["TANGENT"], a["TEXCOORD_0"])), faces]


def test_tangents_agree_with_an_artists(assets):
    # Join the six primitives, so that everything compiles once.
    parts, offset = [], 0
    for *attributes, faces in _helmet(assets / "FlightHelmet"):
        parts.append([*attributes, faces + offset])
        offset += len(attributes[0])
    vertices, normals, authored, uvs, faces = (jnp.asarray(np.concatenate(column)) for column in zip(*parts))
    normals = normals / jnp.linalg.norm(normals, axis=1, keepdims=True)
    ours = vertex_tangents(vertices, normals, uvs, faces)
    cosine = np.clip((np.asarray(ours)[:, :3] * authored[:, :3]).sum(1), -1, 1)
    angle = np.degrees(np.arccos(cosine))
    assert np.median(angle) < 0.5 and np.percentile(angle, 95) < 6
    assert (ours[:, 3] == authored[:, 3]).mean() > 0.999
    # Compare the smooth normals too: the model's are its artist's, so only the bulk can agree.
    angle = np.degrees(np.arccos(np.clip((vertex_normals(vertices, faces) * normals).sum(1), -1, 1)))
    assert np.median(angle) < 5
