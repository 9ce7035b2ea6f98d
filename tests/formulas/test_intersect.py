"""Places of hits and their gradients, rays that leave them, and which triangles can never be hit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxraster.geometry import shapes
from jaxraster.geometry.bvh import build
from jaxraster.geometry.intersect import Rays, canonical, intersection, spawn
from jaxraster.visibility.trace import occluded, trace

COUNT = 2048


def triangles(scale, rng, sliver=1.0, count=COUNT):
    """A triangle for each ray, about as far from the origin as it is large, its height `sliver` times its length."""
    a = rng.normal(size=(count, 3))
    u, v = rng.normal(size=(2, count, 3))
    v = rng.normal(size=(count, 1)) * u + sliver * v
    vertices = scale * np.stack([a, a + u, a + v], axis=1)
    return jnp.asarray(vertices.reshape(-1, 3), jnp.float32), jnp.arange(3 * count, dtype=jnp.int32).reshape(-1, 3)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_the_place_of_a_hit_is_that_of_double_precision(scale):
    rng = np.random.default_rng(0)
    vertices, faces = triangles(scale, rng)
    corners = np.asarray(vertices, np.float64).reshape(-1, 3, 3)
    weights, origin = rng.dirichlet([2, 2, 2], COUNT), (5 * scale * rng.normal(size=(COUNT, 3))).astype(np.float32)
    point = (corners * weights[..., None]).sum(axis=1)
    direction = ((point - origin) / rng.uniform(0.5, 2, (COUNT, 1))).astype(np.float32)
    rays = Rays(origin=jnp.asarray(origin), direction=jnp.asarray(direction))
    t, barycentric = intersection(vertices, faces, jnp.arange(COUNT, dtype=jnp.int32), rays)
    # Solve in double precision for what the rounded rays meet.
    system = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], -direction.astype(float)], axis=-1)
    beta = np.linalg.solve(system, (origin - corners[:, 0])[..., None])[..., 0]
    # Nearly edge-on, roundings grow.
    clear = np.linalg.cond(system / scale) < 100
    assert clear.mean() > 0.8
    np.testing.assert_allclose(np.asarray(t)[clear], beta[clear, 2], rtol=1e-4)
    np.testing.assert_allclose(np.asarray(barycentric)[clear, 1:], beta[clear, :2], atol=2e-4)
    np.testing.assert_allclose(np.asarray(barycentric).sum(axis=-1)[clear], 1.0, rtol=1e-5)


def test_its_gradients_are_finite_differences():
    vertices = jnp.array([[0.1, 0.2, 2.0], [1.3, -0.2, 2.4], [0.3, 1.1, 1.7]])
    faces, face = jnp.array([[0, 1, 2]]), jnp.array([0])

    def function(vertices, origin, direction):
        vertices, origin, direction = map(jnp.asarray, (vertices, origin, direction))
        return intersection(vertices, faces, face, Rays(origin=origin, direction=direction))

    arguments = vertices, jnp.array([[0.4, 0.1, -0.3]]), jnp.array([[0.1, 0.2, 1.7]])
    check_grads(function, arguments, order=1, modes=("fwd", "rev"), atol=2e-2, rtol=2e-2, eps=1e-2)


@pytest.mark.parametrize("face", [-1, 1])
def test_no_face_and_a_face_without_area_give_finite_gradients(face):
    vertices, faces = jnp.eye(3), jnp.array([[0, 1, 2], [0, 1, 1]])

    def total(vertices, origin):
        rays = Rays(origin=origin, direction=jnp.ones((1, 3)))
        t, barycentric = intersection(vertices, faces, jnp.array([face]), rays)
        left = spawn(vertices, faces, jnp.array([face]), barycentric, jnp.ones((1, 3)))
        return jnp.where(jnp.isfinite(t), t, 0.0).sum() + barycentric.sum() + left.origin.sum()

    for gradient in jax.grad(total, argnums=(0, 1))(vertices, jnp.zeros((1, 3))):
        assert np.all(np.isfinite(gradient))


def test_spawned_rays_carry_the_gradient_of_their_place():
    vertices, faces, face = jnp.eye(3), jnp.array([[0, 1, 2]]), jnp.array([0])
    weights, direction = jnp.array([[0.5, 0.3, 0.2]]), jnp.array([[1.0, 2.0, 3.0]])
    gradient = jax.grad(lambda v: spawn(v, faces, face, weights, direction).origin[0, 0])(vertices)
    np.testing.assert_allclose(gradient[:, 0], weights[0], rtol=1e-6)
    gradient = jax.grad(lambda d: spawn(vertices, faces, face, weights, d).direction.sum())(direction)
    assert gradient.tolist() == [[1.0, 1.0, 1.0]]


@pytest.mark.parametrize("scale", [1e-8, 1e-4, 1.0, 1e4, 1e8])
@pytest.mark.parametrize("sliver", [1.0, 1e-2, 1e-5])
def test_no_spawned_ray_meets_its_own_triangle(scale, sliver):
    """To both sides, at any angle down to a thousandth of a radian; each ray against all triangles, none its own."""
    rng = np.random.default_rng(1)
    vertices, faces = triangles(scale, rng, sliver, 128)
    face = jnp.asarray(np.arange(COUNT) % 128, jnp.int32)
    weights = jnp.asarray(rng.dirichlet([1, 1, 1], COUNT), jnp.float32)
    corners = np.asarray(vertices, np.float64).reshape(-1, 3, 3)[np.asarray(face)]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(u, v)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = rng.normal(size=(COUNT, 1)) * u / np.linalg.norm(u, axis=1, keepdims=True) + rng.normal(
        size=(COUNT, 1)
    ) * v / (np.linalg.norm(v, axis=1, keepdims=True))
    steep = 10 ** rng.uniform(-3, 1, (COUNT, 1)) * rng.choice([-1, 1], (COUNT, 1))
    rays = spawn(vertices, faces, face, weights, jnp.asarray(along + steep * normal, jnp.float32))
    hits = trace(rays, build(vertices, faces))
    assert int((hits.face == face).sum()) == 0


@pytest.mark.parametrize("sliver", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_places_on_slivers_are_moved_by_no_more_than_a_thousandth_of_their_length(sliver):
    vertices, faces = jnp.array([[0.0, 0, 0], [10, 0, 0], [5, 10 * sliver, 0]]), jnp.array([[0, 1, 2]])
    weights, up = jnp.array([[0.25, 0.25, 0.5]]), jnp.array([[0.0, 0.0, 1.0]])
    moved = spawn(vertices, faces, jnp.array([0]), weights, up).origin[0, 2]
    assert 10 * 2.0**-20 < moved <= 10 * (2.0**-20 + 2.0**-10) * (1 + 1e-6)


def test_rays_leave_a_convex_body_unhindered():
    sphere = shapes.icosphere(1.0, 2)
    vertices, faces = sphere.vertices + jnp.array([[100.0, 0.0, 0.0]]), sphere.faces
    rng = np.random.default_rng(2)
    face = jnp.asarray(rng.integers(0, len(faces), COUNT), jnp.int32)
    weights = jnp.asarray(rng.dirichlet([1, 1, 1], COUNT), jnp.float32)
    corners = np.asarray(vertices)[np.asarray(faces)[np.asarray(face)]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    direction = rng.normal(size=(COUNT, 3))
    direction *= np.sign((direction * normal).sum(axis=1, keepdims=True))
    tree = build(vertices, faces)
    rays = spawn(vertices, faces, face, weights, jnp.asarray(direction, jnp.float32))
    assert not np.any(occluded(rays, tree))
    # ... and to the inside all of them are stopped.
    rays = spawn(vertices, faces, face, weights, jnp.asarray(-direction, jnp.float32))
    assert np.all(occluded(rays, tree))


def test_what_can_never_be_hit_is_counted_and_zero():
    vertices = jnp.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [jnp.nan, 0, 0], [2e12, 0, 0], [0.1, 0.3, 0.7]])
    faces = jnp.array([[2, 1, 0], [0, 1, 3], [1, 1, 2], [0, 1, 4], [0, 1, 5], [0, 1, 7], [-1, 1, 2], [6, 6, 6]])
    corners, stats = canonical(vertices, faces)
    assert (int(stats.degenerate), int(stats.non_finite), int(stats.out_of_range)) == (3, 2, 2)
    assert corners[0].tolist() == [[0, 0, 0], [0, 1, 0], [1, 0, 0]] and not np.any(corners[1:])


def test_corners_are_ordered_whatever_the_face_says():
    vertices = jnp.array([[1.0, 2, 3], [1, 2, -3], [1, -2, 9]])
    orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]]
    corners, _ = canonical(vertices, jnp.array(orders))
    for each in corners:
        assert each.tolist() == [[1, -2, 9], [1, 2, -3], [1, 2, 3]]
