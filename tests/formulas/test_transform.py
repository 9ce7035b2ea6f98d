"""Poses and projections: against NumPy in double precision, at the ugly points, and on numbers that make no camera."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxraster.math.transform import (
    frame,
    invert_rigid,
    look_at,
    orbit,
    orthographic,
    perspective,
    perspective_divide,
    rotation,
    transform_points,
)
from jaxraster.scene import Camera
from jaxraster.visibility.project import project

RNG = np.random.default_rng(7)
AXES = np.concatenate([np.eye(3), -np.eye(3)])


def rodrigues(axis, angle):
    """A rotation as the exponential series of its generator, in double precision."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    generator = angle * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    total = term = np.eye(3)
    for i in range(1, 60):
        term = term @ generator / i
        total = total + term
    return total


def depth_of(matrix, z):
    """Reversed depth of points straight ahead at distances z, as float32 computes it."""
    z = jnp.asarray(z, jnp.float32)
    points = jnp.stack([jnp.zeros_like(z), jnp.zeros_like(z), -z], axis=-1)
    return np.asarray(perspective_divide(transform_points(matrix, points))[:, 2])


def assert_rigid(pose, atol):
    pose = np.asarray(pose, float)
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=atol)
    assert np.linalg.det(pose[:3, :3]) > 0
    assert pose[3].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize(
    ("eye", "target", "up"),
    [
        ((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((3.0, -2.0, 1.0), (-1.0, 4.0, 7.0), (0.0, 1.0, 0.0)),
        ((1e-12, 2e-12, 0.0), (0.0, 0.0, 3e-12), (0.0, 0.0, 1.0)),
        ((1e15, 2e15, 0.0), (0.0, 0.0, 3e15), (0.0, 0.0, 1e9)),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (0.0, 1e-3, 1.0)),
    ],
)
def test_look_at_looks_down_minus_z_with_up_upwards(eye, target, up):
    pose = np.asarray(look_at(eye, target, up), float)
    assert_rigid(pose, 1e-6)
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    np.testing.assert_allclose(-pose[:3, 2], forward, atol=1e-6)
    np.testing.assert_array_equal(pose[:3, 3], np.float32(eye))
    # Up has a part along the picture's +Y and none along its +X.
    up = np.array(up) / np.linalg.norm(up)
    assert abs(up @ pose[:3, 0]) < 1e-6 and up @ pose[:3, 1] > 0


@pytest.mark.parametrize("forward", AXES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_look_at_along_up_takes_any_perpendicular(forward, sign):
    eye = np.array([0.5, 0.25, -2.0])
    pose = look_at(eye, eye + 2 * forward, sign * forward)
    assert_rigid(pose, 1e-6)
    np.testing.assert_allclose(-np.asarray(pose)[:3, 2], forward, atol=1e-6)


def test_look_at_bends_smoothly_near_up():
    """A sine of 1e-4 between up and the line of sight is still a direction, not the fallback."""
    for angle in (0.0, 1.0, 2.5):
        up = (1e-4 * np.cos(angle), 1.0, 1e-4 * np.sin(angle))
        pose = np.asarray(look_at((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), up), float)
        np.testing.assert_allclose(pose[:3, 1], [np.cos(angle), 0, np.sin(angle)], atol=1e-5)


UGLY_POSES = {
    "eye is target": ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), (0.0, 1.0, 0.0)),
    "up is forward": ((0.0, 3.0, 0.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    "no up": ((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("ugly", UGLY_POSES)
def test_look_at_is_finite_where_it_is_traced(ugly):
    """What no one could refuse, because it was traced, has no NaN in value or gradient, in either mode."""
    arguments = tuple(jnp.array(v) for v in UGLY_POSES[ugly])
    value, forward = jax.jvp(jax.jit(look_at), arguments, tuple(jnp.ones(3) for _ in arguments))
    backward = jax.grad(lambda *a: look_at(*a).sum(), argnums=(0, 1, 2))(*arguments)
    assert all(np.isfinite(x).all() for x in (value, forward, *backward))


@pytest.mark.parametrize(
    ("azimuth", "elevation", "away"),
    [
        (0.0, 0.0, (0, 0, 1)),
        (np.pi / 2, 0.0, (1, 0, 0)),
        (np.pi, 0.0, (0, 0, -1)),
        (0.3, np.pi / 2, (0, 1, 0)),
        (0.3, -np.pi / 2, (0, -1, 0)),
        (0.7, 0.4, (np.cos(0.4) * np.sin(0.7), np.sin(0.4), np.cos(0.4) * np.cos(0.7))),
    ],
)
def test_orbit_stands_on_a_sphere_about_its_target(azimuth, elevation, away):
    target = (1.0, -2.0, 0.5)
    pose = np.asarray(orbit(azimuth, elevation, 3.0, target), float)
    assert_rigid(pose, 1e-6)
    np.testing.assert_allclose(pose[:3, 3], np.add(target, np.multiply(3.0, away)), atol=1e-6)
    np.testing.assert_allclose(pose[:3, 2], away, atol=1e-6)


@pytest.mark.parametrize("far", [1000.0, 2.0, np.inf])
@pytest.mark.parametrize("near", [0.1, 1e-3, 1.5])
def test_depth_is_1_at_near_and_falls_to_0_at_far(near, far):
    matrix = perspective(0.8, near, far)
    z = np.geomspace(near, min(far, 1e6), 20_001).astype(np.float32)
    depth = depth_of(matrix, z)
    assert depth[0] == pytest.approx(1.0, abs=2e-7)
    # The two terms of z_clip cancel at the far plane: what is left is a rounding of near, over far.
    expected = 0.0 if np.isfinite(far) else near / 1e6
    assert depth[-1] == pytest.approx(expected, rel=1e-6, abs=2.0**-23 * near / min(far, 1e6))
    assert (np.diff(depth) <= 0).all() and len(np.unique(depth)) > 19_000
    np.testing.assert_array_equal(matrix[3], [0, 0, -1, 0])


def test_infinite_far_is_the_limit():
    """Depth is near / z to one rounding, and a far plane at 1e9 is no different."""
    z = np.geomspace(0.1, 1e6, 1000).astype(np.float32)
    np.testing.assert_allclose(depth_of(perspective(1.0, 0.1), z), np.float32(0.1) / z.astype(float), rtol=2.0**-23)
    np.testing.assert_allclose(perspective(1.0, 0.1, 1e12), perspective(1.0, 0.1), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(("z", "resolution"), [(1.0, 7.5e-8), (10.0, 9.3e-7), (100.0, 5.8e-6), (900.0, 7.4e-6)])
def test_reversed_depth_resolves_what_float32_can(z, resolution):
    """One ulp of depth is this far in metres, and the computed depth orders planes four ulps of z or of depth apart."""
    near, far = 0.1, 1000.0
    exact = near * (far - z) / ((far - near) * z)
    slope = near * far / ((far - near) * z * z)
    assert np.spacing(np.float32(exact)) / slope == pytest.approx(resolution, rel=0.02)
    step = 4 * max(np.spacing(np.float32(z)), resolution)
    depth = depth_of(perspective(1.0, near, far), z + step * np.arange(2000))
    assert (np.diff(depth) < 0).all()


def test_orthographic_is_linear_and_reversed():
    matrix = np.asarray(orthographic(2.0, -1.0, 9.0), float)
    points = np.array([[2.0, -2.0, 1.0], [-2.0, 2.0, -9.0], [0.0, 0.0, -4.0]])
    clip = np.asarray(transform_points(jnp.asarray(matrix, jnp.float32), jnp.asarray(points, jnp.float32)))
    np.testing.assert_allclose(clip, [[1, -1, 1, 1], [-1, 1, 0, 1], [0, 0, 0.5, 1]], atol=1e-7)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (480, 640), (31, 31), (1, 7)])
@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_every_shape_of_picture_keeps_the_vertical_view_and_square_pixels(kind, width, height):
    """The picture's upper edge is at tan(fov / 2), its right edge width / height times as far out."""
    half = np.tan(0.35) if kind == "perspective" else 1.7
    lens = perspective(0.7, 0.1, 50.0) if kind == "perspective" else orthographic(1.7, 0.1, 50.0)
    distance = 4.0 if kind == "perspective" else 1.0
    edge = half * distance
    points = jnp.array([[0.0, edge, -distance], [edge * width / height, 0.0, -distance]], jnp.float32)
    camera = Camera(world_from_view=jnp.eye(4), clip_from_view=lens)
    clip = np.asarray(project(points, camera, height=height, width=width))
    np.testing.assert_allclose(clip[:, :2] / clip[:, 3:], [[0, 1], [1, 0]], atol=1e-6)


def test_rotation_is_the_exponential():
    axes = [*RNG.normal(size=(20, 3)), *AXES, [1e-20, 2e-20, 0.0], [3e15, 0.0, 1e15]]
    for axis, angle in zip(axes, np.linspace(-7, 7, len(axes))):
        np.testing.assert_allclose(rotation(axis, angle), rodrigues(axis, angle), atol=1e-6)
    np.testing.assert_array_equal(rotation((0.0, 0.0, 0.0), 1.0), np.eye(3))
    # A small angle is not lost against 1: 1 - cos would be.
    np.testing.assert_allclose(rotation((0.0, 0.0, 1.0), 1e-5)[0, 1], -1e-5, rtol=1e-6)


def test_frame_is_orthonormal_and_right_handed_everywhere():
    directions = RNG.normal(size=(10_000, 3))
    ring = np.stack([np.cos(np.arange(8)), np.sin(np.arange(8)), np.zeros(8)], axis=-1)
    near_pole = np.array([[1e-4, 0, -1], [0, -3e-4, -1], [1e-20, 0, -1], [1e-4, 1e-4, 1], [1, 0, -1e-30], [1, 0, -0.0]])
    directions = np.concatenate([directions, AXES, ring, near_pole])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    normal = jnp.asarray(directions, jnp.float32)
    tangent, bitangent = (np.asarray(v, float) for v in jax.jit(frame)(normal))
    basis = np.stack([tangent, bitangent, np.asarray(normal, float)], axis=-1)
    np.testing.assert_allclose(np.swapaxes(basis, 1, 2) @ basis, np.broadcast_to(np.eye(3), basis.shape), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(basis), 1, atol=1e-6)


def test_frame_has_finite_gradients_at_the_poles_and_the_seam():
    normal = jnp.asarray(np.concatenate([AXES, [[1.0, 0.0, -0.0]]]), jnp.float32)
    _, forward = jax.jvp(frame, (normal,), (jnp.ones_like(normal),))
    backward = jax.grad(lambda n: sum(v.sum() for v in frame(n)))(normal)
    assert all(np.isfinite(v).all() for v in (*forward, backward))


def test_invert_rigid_undoes_a_pose():
    poses = np.stack([np.eye(4)] * 50)
    poses[:, :3, :3] = [rodrigues(RNG.normal(size=3), angle) for angle in np.linspace(0, 6, 50)]
    poses[:, :3, 3] = RNG.normal(size=(50, 3)) * 10
    inverse = np.asarray(invert_rigid(jnp.asarray(poses, jnp.float32)), float)
    np.testing.assert_allclose(inverse, np.linalg.inv(poses), atol=1e-5)
    np.testing.assert_array_equal(inverse[:, 3], poses[:, 3])


def test_points_lie_within_a_hundredth_of_a_pixel_at_4096():
    """A camera 140 m from the origin: pose, product and transform in float32 against all of it in float64."""
    eye, target, points = (90.0, 40.0, 100.0), (0.3, 1.0, -0.2), RNG.uniform(-20, 20, (10_000, 3))
    size = {"height": 2304, "width": 4096}
    pixels = []
    for dtype in (np.float32, np.float64):
        with jax.enable_x64(dtype == np.float64):
            camera = Camera(world_from_view=look_at(eye, target), clip_from_view=perspective(0.3, 0.1))
            clip = np.asarray(project(jnp.asarray(points.astype(np.float32), dtype), camera, **size), float)
        pixels.append(clip[:, :2] / clip[:, 3:] * [2048, 1152])
    assert np.abs(pixels[1]).max() > 1000
    assert np.abs(pixels[0] - pixels[1]).max() <= 0.01


def test_points_transform_under_any_batch():
    matrices, points = RNG.normal(size=(2, 3, 4, 4)), RNG.normal(size=(2, 3, 5, 3))
    expected = np.einsum("...ij,...nj->...ni", matrices[..., :3], points) + matrices[..., None, :, 3]
    arguments = (jnp.asarray(a, jnp.float32) for a in (matrices, points))
    np.testing.assert_allclose(transform_points(*arguments), expected, rtol=1e-5, atol=1e-5)


def test_dividing_by_no_w_gives_0():
    clip = jnp.array([[2.0, 4.0, 6.0, 2.0], [1.0, 1.0, 1.0, 0.0]])
    assert perspective_divide(clip).tolist() == [[1, 2, 3], [0, 0, 0]]
    gradient = jax.grad(lambda c: perspective_divide(c).sum())(clip)
    np.testing.assert_allclose(gradient, [[0.5, 0.5, 0.5, -3.0], [0, 0, 0, 0]], rtol=1e-6)


K = np.array([[510.0, 3.5, 331.25], [0.0, 490.0, 222.5], [0.0, 0.0, 1.0]])
R, T = rodrigues((0.3, -1.0, 0.5), 2.1), np.array([0.4, -0.3, 5.0])
SMOOTH = {
    "look_at": (look_at, (3.0, -2.0, 1.0), (-1.0, 4.0, 7.0), (0.1, 1.0, 0.3)),
    "orbit": (orbit, 0.7, 0.4, 3.0, (1.0, 2.0, 3.0)),
    "perspective": (perspective, 0.9, 0.2, 30.0),
    "infinite perspective": (functools.partial(perspective, far=np.inf), 0.9, 0.2),
    "orthographic": (orthographic, 2.0, 0.5, 7.0),
    "from_opencv": (functools.partial(Camera.from_opencv, width=640, height=480), K, R, T),
    "from_pytorch3d": (
        lambda r, t, f, p: Camera.from_pytorch3d(r, t, focal_length=f, principal_point=p, image_size=(480, 640)),
        *(R, T, (1.2, 1.3), (0.2, -0.1)),
    ),
    "rotation": (rotation, (0.3, -0.5, 0.8), 1.2),
    "rotation by nothing": (rotation, (0.3, -0.5, 0.8), 0.0),
    "frame": (frame, (0.48, -0.6, 0.64)),
    "frame below": (frame, (0.48, -0.6, -0.64)),
    "invert_rigid": (invert_rigid, np.block([[R, T[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])),
    "transform_points": (transform_points, RNG.normal(size=(4, 4)), RNG.normal(size=(3, 3))),
    "perspective_divide": (perspective_divide, RNG.uniform(1, 2, (3, 4))),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_gradients_are_finite_differences(name):
    """Forward, backward and central differences agree in float64, in every number that goes in."""
    function, *arguments = SMOOTH[name]
    with jax.enable_x64(True):
        flat, unravel = ravel_pytree([jnp.asarray(a, jnp.float64) for a in arguments])
        of_flat = jax.jit(lambda x: ravel_pytree(function(*unravel(x)))[0])
        forward, backward = jax.jacfwd(of_flat)(flat), jax.jacrev(of_flat)(flat)
        assert forward.dtype == np.float64
        steps = 1e-5 * np.eye(flat.size)
        numeric = np.stack([(of_flat(flat + step) - of_flat(flat - step)) / 2e-5 for step in steps], axis=-1)
    np.testing.assert_allclose(forward, numeric, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(backward, forward, rtol=1e-12, atol=1e-12)


def test_the_far_plane_may_be_infinite_in_gradients():
    gradient = jax.grad(lambda *a: perspective(*a).sum(), argnums=(0, 1, 2))(0.9, 0.2, np.inf)
    assert np.isfinite(gradient).all() and gradient[1] == 1 and gradient[2] == 0


def test_a_zero_axis_has_no_gradient():
    axis = jnp.zeros(3)
    assert jax.grad(lambda a: rotation(a, 0.5).sum())(axis).tolist() == [0, 0, 0]
    assert np.isfinite(jax.jvp(rotation, (axis, jnp.array(0.5)), (jnp.ones(3), jnp.array(1.0)))[1]).all()


NAN, INF = float("nan"), float("inf")
REFUSED = {
    "eye is target": (look_at, ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0)), r"look_at: eye and target must differ, got .*3\."),
    "eye rounds to target": (look_at, ((1e8, 0.0, 0.0), (1e8 + 1, 0.0, 0.0)), "eye and target must differ"),
    "eye NaN": (look_at, ((NAN, 0.0, 0.0), (0.0, 0.0, 0.0)), "must be finite, got eye .nan"),
    "eye beyond float32": (look_at, ((1e300, 0.0, 0.0), (0.0, 0.0, 0.0)), r"finite, got eye .1e\+300"),
    "up infinite": (look_at, ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, INF, 0.0)), "finite, .*up .*inf"),
    "distance 0": (orbit, (0.0, 0.0, 0.0), "orbit: 0 < distance < ∞ must hold, got distance 0.0"),
    "distance negative": (orbit, (0.0, 0.0, -1.0), "got distance -1.0"),
    "azimuth NaN": (orbit, (NAN, 0.0, 1.0), "azimuth and elevation must be finite, got azimuth nan"),
    "fov 0": (perspective, (0.0,), "perspective: 0 < fov_y < π must hold, got fov_y 0.0"),
    "fov π": (perspective, (float(np.pi),), "fov_y < π"),
    "fov in degrees": (perspective, (45.0,), "got fov_y 45.0"),
    "fov NaN": (perspective, (NAN,), "got fov_y nan"),
    "near 0": (perspective, (1.0, 0.0), "perspective: 0 < near < far must hold, got near 0.0, far inf"),
    "near negative": (perspective, (1.0, -0.1), "got near -0.1"),
    "near is far": (perspective, (1.0, 2.0, 2.0), "got near 2.0, far 2.0"),
    "near beyond far": (perspective, (1.0, 5.0, 2.0), "got near 5.0, far 2.0"),
    "near infinite": (perspective, (1.0, INF, INF), "got near inf"),
    "far NaN": (perspective, (1.0, 0.1, NAN), "got near 0.1, far nan"),
    "height 0": (orthographic, (0.0, 0.1, 9.0), "orthographic: 0 < half_height < ∞ must hold, got half_height 0.0"),
    "orthographic far infinite": (orthographic, (1.0, 0.1, INF), "near < far < ∞ must hold, got .*far inf"),
    "orthographic far is near": (orthographic, (1.0, 2.0, 2.0), "got near 2.0, far 2.0"),
    "axis NaN": (rotation, ((NAN, 0.0, 0.0), 1.0), "rotation: axis and angle must be finite"),
    "angle infinite": (rotation, ((1.0, 0.0, 0.0), INF), "angle inf"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_numbers_that_make_no_camera_raise_one_line(case):
    function, arguments, message = REFUSED[case]
    with pytest.raises(ValueError, match=message) as caught:
        function(*arguments)
    assert "\n" not in str(caught.value)


def test_what_is_traced_passes():
    """Under jit only the numbers written down are judged."""
    assert not np.isfinite(jax.jit(perspective)(1.0, 5.0, 5.0)).all()
    with pytest.raises(ValueError, match=r"0 < fov_y < π must hold, got fov_y 4\.0"):
        jax.jit(lambda near: perspective(4.0, near))(0.1)
