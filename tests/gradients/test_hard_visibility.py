"""The theorem of hard visibility: coverage has no gradient in the vertices, everything inside a triangle has all of it.

A picture of one constant colour changes when its triangle moves, yet its derivative is exactly zero wherever there is
one. What is interpolated inside the triangles, and their depth, match finite differences in double precision.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.buffers import Visibility
from jaxraster.math.transform import look_at, perspective
from jaxraster.scene import Camera
from jaxraster.visibility.barycentric import interpolate
from jaxraster.visibility.project import project
from jaxraster.visibility.raster import rasterize

HEIGHT, WIDTH = 24, 32
FACES = np.array([[0, 1, 2], [3, 4, 5], [2, 1, 6]], np.int32)
# Two overlapping triangles, one of them through the camera plane, and a neighbour that shares an edge.
VERTICES = [
    [-1, -1, 0],
    [1, -0.9, 0.3],
    [0.1, 1, -0.5],
    [-0.8, 0.2, 0.6],
    [0.9, 0.6, 4.5],
    [0.8, -0.5, -1],
    [1.3, 1, -1],
]


def camera(dtype=jnp.float32):
    pose = look_at((0.3, 0.4, 4.0), (0.0, 0.0, 0.0))
    return jax.tree.map(
        lambda m: m.astype(dtype), Camera(world_from_view=pose, clip_from_view=perspective(0.7, 0.1, 50.0))
    )


def see(vertices) -> Visibility:
    clip = project(vertices, camera(vertices.dtype), height=HEIGHT, width=WIDTH)
    return rasterize(clip, jnp.asarray(FACES), height=HEIGHT, width=WIDTH)


def constant_image(vertices):
    """Every triangle red, the background black."""
    red = jnp.broadcast_to(jnp.array([0.9, 0.1, 0.05], vertices.dtype), (len(VERTICES), 3))
    return interpolate(red, jnp.asarray(FACES), see(vertices))


FLAT = {"face": lambda v: see(v).face.astype(v.dtype), "constant image": constant_image}


@pytest.mark.parametrize("name", FLAT)
def test_coverage_has_exactly_no_gradient(name):
    vertices = jnp.array(VERTICES, jnp.float32)
    function = FLAT[name]
    image = function(vertices)
    rng = np.random.default_rng(0)
    weights = jnp.array(rng.normal(size=image.shape), jnp.float32)
    # It is a picture that depends on the vertices: half a pixel to the side changes it.
    moved = function(vertices + jnp.array([[0.04, 0, 0]], jnp.float32))
    assert int((moved != image).sum()) > 5
    reverse = jax.jit(jax.grad(lambda v: jnp.sum(weights * function(v))))(vertices)
    assert (np.asarray(reverse) == 0.0).all()
    forward = jax.jit(lambda v, t: jax.jvp(function, (v,), (t,))[1])
    for _ in range(3):
        tangent = jnp.array(rng.normal(size=vertices.shape), jnp.float32)
        assert (np.asarray(forward(vertices, tangent)) == 0.0).all()


def smooth(vertices):
    """All that is differentiable about visibility, [h, w, 9]."""
    visibility = see(vertices)
    colors = jnp.asarray(np.random.default_rng(3).uniform(size=(len(VERTICES), 4)), vertices.dtype)
    values = interpolate(colors, jnp.asarray(FACES), visibility)
    parts = [visibility.barycentric, visibility.depth[..., None], values]
    return jnp.concatenate(parts, axis=-1), visibility.face


def test_the_inside_matches_finite_differences_in_both_modes():
    with jax.enable_x64(True):
        vertices = jnp.array(VERTICES, jnp.float64)
        values, face = jax.jit(smooth)(vertices)
        assert values.dtype == jnp.float64
        assert len(np.unique(face)) == 4
        rng = np.random.default_rng(1)
        step = 1e-6
        evaluate = jax.jit(smooth)
        forward = jax.jit(lambda v, t: jax.jvp(lambda u: smooth(u)[0], (v,), (t,))[1])
        reverse = jax.jit(lambda v, w: jax.vjp(lambda u: smooth(u)[0], v)[1](w)[0])
        for _ in range(4):
            tangent = jnp.array(rng.normal(size=vertices.shape))
            ahead, face_ahead = evaluate(vertices + step * tangent)
            behind, face_behind = evaluate(vertices - step * tangent)
            # Where a pixel's triangle changes, or its centre lies beyond the true edge, there is no derivative.
            clamped = (values[..., :3] == 0).any(axis=-1) & (face >= 0)
            same = ((face == face_ahead) & (face == face_behind) & ~clamped)[..., None]
            assert same.mean() > 0.97
            difference = (ahead - behind) / (2 * step)
            exact = forward(vertices, tangent)
            assert float(jnp.abs(exact).max()) > 0.1
            assert float(jnp.abs(jnp.where(same, exact - difference, 0)).max()) < 1e-7 * float(jnp.abs(exact).max())
            # <w, J t> = <Jᵀ w, t> ties reverse mode to forward mode.
            weights = jnp.array(rng.normal(size=values.shape))
            one, other = float(jnp.sum(weights * exact)), float(jnp.sum(reverse(vertices, weights) * tangent))
            assert one == pytest.approx(other, rel=1e-10)


def test_a_broken_triangle_leaks_into_no_gradient():
    """NaN in one triangle's corner: all other vertices keep the gradients they had without it."""
    vertices = jnp.array(VERTICES, jnp.float32)
    total = jax.jit(jax.grad(lambda v: jnp.sum(smooth(v)[0])))
    kept = np.array([0, 1, 2, 6])
    broken = total(vertices.at[4].set(jnp.nan))
    moved_away = total(vertices.at[3:6].add(jnp.array([[0, 0, 500]], jnp.float32)))
    assert np.isfinite(np.asarray(broken)[kept]).all()
    assert np.abs(np.asarray(broken)[kept] - np.asarray(moved_away)[kept]).max() < 1e-4
    assert np.abs(np.asarray(broken)[kept]).max() > 0.1


def test_hidden_triangles_have_no_gradient():
    vertices = jnp.array(VERTICES, jnp.float32)
    behind = vertices.at[3:6].set(jnp.array([[-0.2, -0.5, -3], [0.2, -0.5, -3], [0, -0.3, -3]], jnp.float32))
    assert 1 not in np.asarray(see(behind).face)
    gradient = jax.grad(lambda v: jnp.sum(smooth(v)[0] ** 2))(behind)
    assert (np.asarray(gradient)[3:6] == 0).all() and np.abs(np.asarray(gradient)).max() > 0
