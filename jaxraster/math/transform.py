"""Poses and projections: where the camera stands, and how view space becomes clip space.

View space looks down -Z with +Y up. Projections have reversed depth (clip z = w at the near plane, 0 at the far) and
are for a square picture; see `Camera`. Angles in radians, lengths in metres. Numbers that make no camera raise a
`ValueError`, unless they are traced.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .safe import divide, dot, normalize

Length = float | Float[Array, ""]
Vector = Float[Array, "3"] | np.ndarray | tuple | list  # what a caller may write down for three numbers
Pair = Float[Array, "2"] | np.ndarray | tuple | list  # ... for two
Matrix = Float[Array, "3 3"] | np.ndarray | list  # ... for three rows of three


def _require(rule: str, holds: Callable[..., bool], **values) -> None:
    """Raise one line with the numbers where they break a rule; pass what is traced, which has no numbers yet."""
    if any(isinstance(value, jax.core.Tracer) for value in values.values()):
        return
    # Judge what is computed with: two points may differ in double precision alone.
    with np.errstate(over="ignore"):
        rounded = [np.asarray(value).astype(jnp.result_type(float)) for value in values.values()]
    if not holds(*rounded):
        # As lists: how arrays print is a setting of the whole process.
        numbers = ", ".join(f"{name} {np.asarray(value).tolist()}" for name, value in values.items())
        raise ValueError(f"{rule}, got {numbers}")


def _finite(*values: np.ndarray) -> bool:
    return all(np.isfinite(value).all() for value in values)


def _calibrates(K: np.ndarray) -> bool:
    return _finite(K) and bool(K[0, 0] > 0 < K[1, 1] and K[1, 0] == 0) and K[2].tolist() == [0, 0, 1]


def _rotates(R: np.ndarray) -> bool:
    # A hundredth is far above what estimation and storage round, and far below what a scale or a shear adds.
    return _finite(R) and bool(np.abs(R @ R.T - np.eye(3)).max() < 0.01 and np.linalg.det(R) > 0)


def _shaped(where: str, shape: tuple[int, ...], **values) -> None:
    """Raise one line for the first of the values that has another shape."""
    for name, value in values.items():
        if np.shape(value) != shape:
            hint = "; map over a batch with jax.vmap" if np.ndim(value) > len(shape) else ""
            raise ValueError(f"{where}: {name} must be {list(shape)}, got {list(np.shape(value))}{hint}")


def multiply(a: Float[Array, "*b n k"], b: Float[Array, "*b k m"]) -> Float[Array, "*b n m"]:
    """a @ b in full float precision: an accelerator's default (TF32) would move a vertex by pixels."""
    return jnp.matmul(a, b, precision="highest")


def transform_points(matrix: Float[Array, "*b 4 4"], points: Float[Array, "*b n 3"]) -> Float[Array, "*b n 4"]:
    """Homogeneous images of points: matrix · (p, 1), written out as multiply-adds."""
    columns = jnp.swapaxes(matrix, -1, -2)[..., None, :, :]
    x, y, z = (points[..., i, None] for i in range(3))
    return x * columns[..., 0, :] + y * columns[..., 1, :] + z * columns[..., 2, :] + columns[..., 3, :]


def invert_rigid(matrix: Float[Array, "*b 4 4"]) -> Float[Array, "*b 4 4"]:
    """The inverse of a rotation and translation: (R, t) becomes (Rᵀ, -Rᵀ t). Gradient: of this formula."""
    rotation = jnp.swapaxes(matrix[..., :3, :3], -1, -2)
    translation = -jnp.sum(rotation * matrix[..., None, :3, 3], axis=-1)
    top = jnp.concatenate([rotation, translation[..., None]], axis=-1)
    return jnp.concatenate([top, matrix[..., 3:, :]], axis=-2)


def frame(normal: Float[Array, "*b 3"]) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Two unit vectors that make a right-handed orthonormal frame with a unit normal.

    Source: Duff et al. 2017, "Building an Orthonormal Basis, Revisited"; the sign keeps 1 + |z| away from 0.
    Gradient: exact except across z = 0, where the frame jumps.
    """
    x, y, z = (normal[..., i] for i in range(3))
    sign = jnp.where(z < 0, -1.0, 1.0).astype(z.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    bitangent = jnp.stack([b, sign + y * y * a, -y], axis=-1)
    return tangent, bitangent


def look_at(eye: Vector, target: Vector, up: Vector = (0.0, 1.0, 0.0)) -> Float[Array, "4 4"]:
    """`world_from_view` of a camera at `eye` that looks at `target` with `up` upwards in its picture.

    Where `up` is parallel to the line of sight, any perpendicular one is taken. Eye and target must differ.
    """
    _require("look_at: eye, target and up must be finite", _finite, eye=eye, target=target, up=up)
    _require("look_at: eye and target must differ", lambda a, b: (a != b).any(), eye=eye, target=target)
    eye, target, up = (jnp.asarray(v, dtype=jnp.result_type(float)) for v in (eye, target, up))
    back = normalize(eye - target)
    right = jnp.cross(up, back)
    # The sine below which float32 leaves the direction of `right` fewer than 8 sure bits.
    parallel = dot(right, right) <= 1e-10 * dot(up, up)
    right = normalize(jnp.where(parallel, frame(back)[0], right))
    top = jnp.stack([right, jnp.cross(back, right), back, eye], axis=-1)
    return jnp.concatenate([top, jnp.array([[0.0, 0.0, 0.0, 1.0]], top.dtype)])


def orbit(
    azimuth: Length, elevation: Length, distance: Length, target: Vector = (0.0, 0.0, 0.0)
) -> Float[Array, "4 4"]:
    """`world_from_view` of a camera on a sphere about `target`, looking at it.

    Azimuth 0 stands on +Z and grows towards +X; elevation π/2 is straight above.
    """
    _require("orbit: azimuth and elevation must be finite", _finite, azimuth=azimuth, elevation=elevation)
    _require("orbit: 0 < distance < ∞ must hold", lambda d: 0 < d < np.inf, distance=distance)
    azimuth, elevation = jnp.asarray(azimuth, float), jnp.asarray(elevation, float)
    horizontal = jnp.cos(elevation)
    away = jnp.stack([horizontal * jnp.sin(azimuth), jnp.sin(elevation), horizontal * jnp.cos(azimuth)])
    target = jnp.asarray(target, away.dtype)
    return look_at(target + distance * away, target)


def perspective(fov_y: Length, near: Length = 0.1, far: Length = jnp.inf) -> Float[Array, "4 4"]:
    """`clip_from_view` of a pinhole with vertical field of view `fov_y`; `far` may be infinite.

    z_clip = a·z + n(1 + a) with a = n/(f - n), w = -z: 1 at z = -n, 0 at z = -f.
    """
    _require("perspective: 0 < fov_y < π must hold", lambda angle: 0 < angle < np.pi, fov_y=fov_y)
    _require("perspective: 0 < near < far must hold", lambda n, f: 0 < n < f, near=near, far=far)
    fov_y, near, far = (jnp.asarray(v, dtype=jnp.result_type(float)) for v in (fov_y, near, far))
    a = near / (far - near)
    scale = 1.0 / jnp.tan(0.5 * fov_y)
    zero, one = jnp.zeros_like(a), jnp.ones_like(a)
    rows = [[scale, zero, zero, zero], [zero, scale, zero, zero], [zero, zero, a, near * (1.0 + a)]]
    return jnp.stack([jnp.stack(row) for row in [*rows, [zero, zero, -one, zero]]])


def orthographic(half_height: Length, near: Length, far: Length) -> Float[Array, "4 4"]:
    """`clip_from_view` of a parallel projection that shows ±`half_height` metres vertically; `far` is finite."""
    _require("orthographic: 0 < half_height < ∞ must hold", lambda h: 0 < h < np.inf, half_height=half_height)
    _require("orthographic: near < far < ∞ must hold", lambda n, f: -np.inf < n < f < np.inf, near=near, far=far)
    half_height, near, far = (jnp.asarray(v, dtype=jnp.result_type(float)) for v in (half_height, near, far))
    scale, depth = 1.0 / half_height, 1.0 / (far - near)
    zero, one = jnp.zeros_like(scale), jnp.ones_like(scale)
    rows = [[scale, zero, zero, zero], [zero, scale, zero, zero], [zero, zero, depth, far * depth]]
    return jnp.stack([jnp.stack(row) for row in [*rows, [zero, zero, zero, one]]])


def parts_from_opencv(
    K: Matrix,
    R: Matrix,
    t: Vector,
    *,
    width: int,
    height: int,
    near: Length,
    far: Length,
    pixel_center: float,
) -> tuple[Float[Array, "4 4"], Float[Array, "4 4"]]:
    """`(world_from_view, clip_from_view)` of OpenCV's camera, u ~ K (R x + t); see `Camera.from_opencv`."""
    _shaped("from_opencv", (3, 3), K=K, R=R)
    _shaped("from_opencv", (3,), t=t)
    _require("from_opencv: width and height must be above 0", lambda w, h: w > 0 < h, width=width, height=height)
    _require("from_opencv: K must be [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx and fy above 0", _calibrates, K=K)
    _require("from_opencv: R must be a rotation", _rotates, R=R)
    _require("from_opencv: t must be finite", _finite, t=t)
    K, R, t = (jnp.asarray(m, dtype=jnp.result_type(float)) for m in (K, R, t))
    # Turn the pose: OpenCV's camera looks down +Z with y down, ours down -Z with y up.
    flip = jnp.array([1.0, -1.0, -1.0], K.dtype)
    view_from_world = jnp.concatenate([R, t[:, None]], axis=1) * flip[:, None]
    bottom = jnp.array([[0.0, 0.0, 0.0, 1.0]], K.dtype)
    world_from_view = invert_rigid(jnp.concatenate([view_from_world, bottom]))
    # Rescale pixels to [-1, 1], v upwards, and undo the height/width that `render` will apply to the first row.
    cx, cy = K[0, 2] + (0.5 - pixel_center), K[1, 2] + (0.5 - pixel_center)
    aspect = width / height
    zero = jnp.zeros_like(cx)
    clip_from_view = perspective(0.5 * jnp.pi, near, far)
    x_row = jnp.stack([2.0 * K[0, 0] / width, -2.0 * K[0, 1] / width, 1.0 - 2.0 * cx / width, zero]) * aspect
    y_row = jnp.stack([zero, 2.0 * K[1, 1] / height, 2.0 * cy / height - 1.0, zero])
    return world_from_view, jnp.stack([x_row, y_row, clip_from_view[2], clip_from_view[3]])


def opencv_from_pytorch3d(
    R: Matrix,
    T: Vector,
    *,
    image_size: tuple[int, int],
    focal_length: Length | Pair,
    principal_point: Pair,
    in_ndc: bool,
) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"], Float[Array, "3"]]:
    """`(K, R, t)`, its first pixel's centre at 0.5, of PyTorch3D's camera; see `Camera.from_pytorch3d`.

    In NDC, where the shorter of w and h is 2 and x grows to the left, x = f X/Z + p: in pixels from the left,
    w/2 - x min(w, h)/2.
    """
    sized = "from_pytorch3d: image_size must be (height, width), both above 0"
    _require(sized, lambda size: size.shape == (2,) and (size > 0).all(), image_size=image_size)
    _shaped("from_pytorch3d", (3, 3), R=R)
    _shaped("from_pytorch3d", (3,), T=T)
    _shaped("from_pytorch3d", (2,), principal_point=principal_point)
    if np.ndim(focal_length) > 0:
        _shaped("from_pytorch3d", (2,), focal_length=focal_length)
    _require("from_pytorch3d: R must be a rotation", _rotates, R=R)
    _require("from_pytorch3d: T and principal_point must be finite", _finite, T=T, principal_point=principal_point)
    focused = "from_pytorch3d: focal_length must be finite and above 0"
    _require(focused, lambda f: _finite(f) and (f > 0).all(), focal_length=focal_length)
    R, T, focal, point = (jnp.asarray(v, jnp.result_type(float)) for v in (R, T, focal_length, principal_point))
    if in_ndc:
        height, width = image_size
        half = 0.5 * min(height, width)
        focal, point = half * focal, 0.5 * jnp.array([width, height], point.dtype) - half * point
    K = jnp.eye(3, dtype=R.dtype).at[[0, 1], [0, 1]].set(focal).at[:2, 2].set(point)
    # Turn x to the right and y down.
    turn = jnp.array([-1.0, -1.0, 1.0], R.dtype)
    return K, turn[:, None] * R.T, turn * T


def rotation(axis: Vector, angle: Length) -> Float[Array, "3 3"]:
    """The right-handed rotation by `angle` about `axis` (Rodrigues); the identity for a zero axis.

    Gradient: exact in both; 0 in the axis where it is zero.
    """
    _require("rotation: axis and angle must be finite", _finite, axis=axis, angle=angle)
    x, y, z = normalize(jnp.asarray(axis, dtype=jnp.result_type(float)))
    zero = jnp.zeros_like(x)
    cross = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    angle = jnp.asarray(angle, cross.dtype)
    half = jnp.sin(0.5 * angle)
    return jnp.eye(3, dtype=cross.dtype) + jnp.sin(angle) * cross + 2.0 * half * half * multiply(cross, cross)


def perspective_divide(clip: Float[Array, "*b 4"]) -> Float[Array, "*b 3"]:
    """(x, y, z) / w, and 0 where w is 0."""
    return divide(clip[..., :3], jnp.broadcast_to(clip[..., 3:], clip[..., :3].shape))
