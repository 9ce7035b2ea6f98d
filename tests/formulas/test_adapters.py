"""Other tools' conventions: their published formulas, written out in double precision, against what is made here."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxraster.buffers import Stats, Visibility
from jaxraster.camera import Camera
from jaxraster.math.transform import orbit, perspective
from jaxraster.scene import CLAMP, FIRST, LINEAR, NEAREST, REPEAT
from jaxraster.stack import pack_textures
from jaxraster.surface.texture import texture
from jaxraster.visibility.barycentric import interpolate
from jaxraster.visibility.nvdiffrast import from_nvdiffrast, to_nvdiffrast
from jaxraster.visibility.project import project
from jaxraster.visibility.raster import rasterize

RNG = np.random.default_rng(11)
SIZE = {"height": 48, "width": 64}
draw = jax.jit(functools.partial(rasterize, **SIZE))


def turned() -> np.ndarray:
    """A random rotation."""
    q = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    return q * np.linalg.det(q)


K = np.array([[510.0, 3.5, 331.25], [0.0, 490.0, 222.5], [0.0, 0.0, 1.0]])
R, T = turned(), np.array([0.4, -0.3, 5.0])
POINTS = RNG.uniform(-1.5, 1.5, (500, 3))


def assert_seen(camera, width, height, pixels, z, atol):
    """All points are seen at these pixels, counted from the top left corner, and distances, between 0.5 and 40."""
    points = jnp.asarray(POINTS, camera.world_from_view.dtype)
    clip = np.asarray(project(points, camera, height=height, width=width), float).T
    x, y, depth = clip[:3] / clip[3]
    np.testing.assert_allclose(np.stack([(x + 1) * width, (1 - y) * height], axis=-1) / 2, pixels, atol=atol)
    np.testing.assert_allclose(clip[3], z, rtol=1e-6)
    np.testing.assert_allclose(depth, 0.5 * (40 - z) / (39.5 * z), atol=1e-6)


@pytest.mark.parametrize("pixel_center", [0.0, 0.5])
@pytest.mark.parametrize("scale", [1.0, 0.125])
@pytest.mark.parametrize(("dtype", "atol"), [(np.float32, 5e-4), (np.float64, 1e-10)])
def test_from_opencv_is_the_pinhole(pixel_center, scale, dtype, atol):
    """u ~ K (R x + t), with skew and an off-centre principal point, for two sizes of picture of one shape."""
    u, v, z = K @ (R @ POINTS.T + T[:, None])
    # Count from the picture's corner, in pixels of this picture.
    pixels = (np.stack([u / z, v / z], axis=-1) + 0.5 - pixel_center) * scale
    sizes = {"width": 640, "height": 480, "near": 0.5, "far": 40.0}
    with jax.enable_x64(dtype == np.float64):
        calibration = (jnp.asarray(m, dtype) for m in (K, R, T))
        camera = Camera.from_opencv(*calibration, **sizes, pixel_center=pixel_center)
        assert camera.world_from_view.dtype == camera.clip_from_view.dtype == dtype
        assert_seen(camera, int(640 * scale), int(480 * scale), pixels, z, atol)


def test_calibrated_points_are_drawn_on_their_pixels():
    """Squares of 1.2 pixels about known points cover the pixels whose centres they hold, and no others."""
    rng = np.random.default_rng(5)
    lens = np.array([[70.0, 1.5, 30.0], [0.0, 60.0, 25.0], [0.0, 0.0, 1.0]])
    camera = Camera.from_opencv(lens, R, T, **SIZE)
    column, row = np.meshgrid(np.arange(4, 64, 8), np.arange(4, 48, 8))
    # Odd 32nds of a pixel, so that no point lies where snapping could decide.
    points = np.stack([column, row], axis=-1).reshape(-1, 1, 2) + (rng.integers(-32, 32, (48, 1, 2)) + 0.5) / 16
    pixels = points + np.array([(-0.6, -0.6), (0.6, -0.6), (0.6, 0.6), (-0.6, 0.6)])
    rays = np.concatenate([pixels, np.ones((48, 4, 1))], axis=-1) @ np.linalg.inv(lens).T
    world = (rays * rng.uniform(2, 20, (48, 1, 1)) - T) @ R
    faces = (4 * np.arange(48)[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    clip = project(jnp.asarray(world.reshape(-1, 3), jnp.float32), camera, **SIZE)
    drawn = np.asarray(draw(clip, jnp.asarray(faces)).face) // 2

    # OpenCV counts from the centre of the first pixel.
    away = np.abs(np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1) - points[:, None]).max(axis=-1)
    assert np.abs(away - 0.6).min() > 1 / 256  # what snapping could decide
    np.testing.assert_array_equal(drawn, np.where((away < 0.6).any(axis=0), (away < 0.6).argmax(axis=0), -1))
    assert len(np.unique(drawn)) == 49


@pytest.mark.parametrize(("width", "height"), [(640, 480), (480, 640), (31, 31)])
@pytest.mark.parametrize(
    ("focal", "point", "in_ndc"),
    [
        (1.7, (0.0, 0.0), True),
        ((1.2, 0.9), (0.2, 0.5), True),
        (1 / np.tan(np.radians(60) / 2), (0.0, 0.0), True),
        ((310.0, 330.0), (114.75, 31.5), False),
        (76.5, (0.0, 0.0), False),
    ],
)
def test_from_pytorch3d_is_their_perspective_camera(width, height, focal, point, in_ndc):
    """Rows times R; screen to NDC for what is in pixels; NDC, +X left and +Y up, to pixels from the top left."""
    X, Y, Z = (POINTS @ R + T).T
    half = min(width, height) / 2
    (fx, fy), (px, py) = np.broadcast_to(focal, 2), point
    if not in_ndc:
        fx, fy, px, py = fx / half, fy / half, -(px - width / 2) / half, -(py - height / 2) / half
    x, y = fx * X / Z + px, fy * Y / Z + py
    pixels = np.stack([width / 2 - half * x, height / 2 - half * y], axis=-1)
    lens = {"focal_length": focal, "principal_point": point, "in_ndc": in_ndc, "near": 0.5, "far": 40.0}
    for x64, atol in ((False, 5e-4), (True, 1e-10)):
        with jax.enable_x64(x64):
            camera = Camera.from_pytorch3d(R, T, image_size=(height, width), **lens)
            assert_seen(camera, width, height, pixels, Z, atol)


def test_their_field_of_view_spans_the_shorter_side():
    """`FoVPerspectiveCameras` maps x / z = tan(fov / 2) to 1 in NDC, which is `perspective` in wide pictures."""
    fov, planes = 0.7, {"near": 0.2, "far": 9.0}
    camera = Camera.from_pytorch3d(R, T, focal_length=1 / np.tan(fov / 2), image_size=(48, 64), **planes)
    np.testing.assert_allclose(camera.clip_from_view, perspective(fov, **planes), atol=1e-6)


@pytest.mark.parametrize(("distance", "elevation", "azimuth"), [(3.0, 20.0, 50.0), (1.5, -70.0, 200.0)])
def test_look_at_view_transform_is_orbit(distance, elevation, azimuth):
    """R of their spherical angles, in degrees, has the view's axes for columns: left, up and forward."""
    e, a = np.radians([elevation, azimuth])
    eye = distance * np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    forward = -eye / distance
    left = np.cross([0.0, 1.0, 0.0], forward) / np.cos(e)
    rotation = np.stack([left, np.cross(forward, left), forward], axis=1)
    camera = Camera.from_pytorch3d(rotation, -eye @ rotation, image_size=(4, 4))
    np.testing.assert_allclose(camera.world_from_view, orbit(a, e, distance), atol=1e-6)


BATCHED = {
    "opencv": functools.partial(Camera.from_opencv, **SIZE),
    "pytorch3d": lambda focal, *pose: Camera.from_pytorch3d(*pose, focal_length=focal, image_size=(48, 64)),
}


@pytest.mark.parametrize("tool", BATCHED)
def test_cameras_are_made_in_batches(tool):
    make = BATCHED[tool]
    focal = 50 * RNG.uniform(1, 2, (3, 2))
    lenses = focal if tool == "pytorch3d" else np.stack([np.diag([*f, 1.0]) for f in focal])
    arguments = (lenses, np.stack([turned() for _ in range(3)]), RNG.normal(size=(3, 3)))
    arguments = tuple(jnp.asarray(a, jnp.float32) for a in arguments)
    batch = jax.jit(jax.vmap(make))(*arguments)
    for i in range(3):
        one, member = make(*(a[i] for a in arguments)), jax.tree.map(lambda leaf, i=i: leaf[i], batch)
        jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-6), member, one)
    assert project(jnp.zeros((3, 5, 3)), batch, **SIZE).shape == (3, 5, 4)


def documented_rast(pos, tri, height, width):
    """(u, v, z/w, id + 1) by homogeneous edge functions, row 0 at the bottom; and where that is sure to be drawn so.

    Unsure is what snapping to 1/256 pixel could decide: near a triangle's edge, or where another one is as near.
    """
    x, y = np.meshgrid((2 * np.arange(width) + 1) / width - 1, (2 * np.arange(height) + 1) / height - 1)
    rast, sure = np.zeros((height, width, 4)), np.ones((height, width), bool)
    nearest = np.full((height, width), np.inf)
    for index, corners in enumerate(pos[tri]):
        qx, qy = (corners[:, i, None, None] - corners[:, 3, None, None] * c for i, c in enumerate((x, y)))
        b = np.stack([qx[i] * qy[j] - qy[i] * qx[j] for i, j in ((1, 2), (2, 0), (0, 1))])
        b = b / b.sum(axis=0)
        z = np.tensordot(corners[:, 2], b, 1) / np.tensordot(corners[:, 3], b, 1)
        inside = (b > 0).all(axis=0)
        sure &= ~((np.abs(b) < 0.003).any(axis=0) & (b > -0.003).all(axis=0)) & ~(inside & (np.abs(z - nearest) < 0.01))
        here = inside & (z < nearest)
        rast[here] = np.stack([b[0], b[1], z, np.full_like(z, index + 1)], axis=-1)[here]
        nearest[here] = z[here]
    return rast, sure


POS = np.concatenate([RNG.uniform(-1.5, 1.5, (60, 2)), RNG.uniform(-0.9, 0.9, (60, 1)), np.ones((60, 1))], axis=1)
POS = (POS * RNG.uniform(1, 3, (60, 1))).astype(np.float32)
TRI = RNG.permutation(60).reshape(20, 3)
CLIP = jnp.asarray(POS).at[:, 2].set(0.5 * (POS[:, 3] - POS[:, 2]))


def test_a_script_of_nvdiffrast_finds_its_own_rast():
    expected, sure = documented_rast(POS.astype(float), TRI, **SIZE)
    rast = np.asarray(to_nvdiffrast(draw(CLIP, jnp.asarray(TRI))))
    assert sure.mean() > 0.8 and len(np.unique(expected[sure][:, 3])) > 10 and (expected[sure][:, 3] == 0).any()
    np.testing.assert_array_equal(rast[sure][:, 3], expected[sure][:, 3])
    np.testing.assert_allclose(rast[sure], expected[sure], atol=1e-5)


def made_up(*shape) -> Visibility:
    """Some of everything: nothing, faces of all sizes, and depths from the near plane to where float32 ends."""
    face = RNG.choice([-1, 0, 1, 2**24 - 1, 2**24, 889_192_446], shape)
    weights = RNG.dirichlet([0.5, 0.5, 0.5], shape)
    depth = 2.0 ** RNG.uniform(-40, 0, shape) * RNG.choice([1.0, 0.5], shape)
    depth.flat[:2] = 1.0
    none = jnp.zeros(shape[:-2], jnp.int32)
    seen = np.where(face < 0, 0.0, depth).astype(np.float32)
    return Visibility(
        face=jnp.asarray(face, jnp.int32),
        barycentric=jnp.asarray(np.where(face[..., None] < 0, 0.0, weights), jnp.float32),
        depth=jnp.asarray(seen),
        nearness=jnp.asarray(seen.view(np.int32)),
        stats=Stats(non_finite=none, degenerate=none, out_of_range=none),
    )


def test_visibility_survives_the_round_trip():
    """Faces and two weights bit by bit; the third within what its sum with them rounds, depth as OpenGL resolves it."""
    visibility = made_up(300, 40)
    back = from_nvdiffrast(to_nvdiffrast(visibility))
    np.testing.assert_array_equal(back.face, visibility.face)
    np.testing.assert_array_equal(back.barycentric[..., :2], visibility.barycentric[..., :2])
    np.testing.assert_allclose(back.barycentric, visibility.barycentric, rtol=0, atol=2.0**-22)
    assert (back.barycentric >= 0).all()
    near = np.asarray(visibility.depth) >= 0.25
    np.testing.assert_array_equal(back.depth[near], visibility.depth[near])
    np.testing.assert_allclose(back.depth, visibility.depth, rtol=0, atol=2.0**-26)
    np.testing.assert_array_equal(back.depth > 0, visibility.face >= 0)


def test_what_was_drawn_survives_the_round_trip():
    visibility = draw(CLIP, jnp.asarray(TRI))
    back = from_nvdiffrast(to_nvdiffrast(visibility))
    np.testing.assert_array_equal(back.face, visibility.face)
    np.testing.assert_allclose(back.barycentric, visibility.barycentric, rtol=0, atol=2.0**-22)
    np.testing.assert_allclose(back.depth, visibility.depth, rtol=0, atol=2.0**-26)
    assert jax.tree.leaves(back.stats) == [0, 0, 0]


NUMBERS = {
    -1: 0.0,
    0: 1.0,
    2**24 - 3: 16777214.0,
    2**24 - 2: 16777215.0,
    2**24 - 1: 16777216.0,
    2**24: 16777218.0,
    2**24 + 1: 16777220.0,
    2**24 + 2: 16777222.0,
    889_192_446: float(np.finfo(np.float32).max),
}


def test_large_ids_are_written_as_bits():
    """The float after 2²⁴ stands for the number after 2²⁴, and so on to the last one that is finite."""
    face = jnp.array([[*NUMBERS]], jnp.int32)
    visibility = replace(made_up(1, len(NUMBERS)), face=face)
    rast = to_nvdiffrast(visibility)
    assert rast[0, :, 3].tolist() == [*NUMBERS.values()]
    np.testing.assert_array_equal(from_nvdiffrast(rast).face, face)
    assert from_nvdiffrast(rast.at[..., 3].set(-3.0)).face.max() == -1


def test_pictures_come_in_batches():
    visibility = made_up(2, 3, 5, 7)
    rast = jax.jit(to_nvdiffrast)(visibility)
    assert rast.shape == (2, 3, 5, 7, 4)
    np.testing.assert_array_equal(rast, jax.vmap(jax.vmap(to_nvdiffrast))(visibility))
    np.testing.assert_array_equal(rast[:, :, 0, :, :2], visibility.barycentric[:, :, 4, :, :2])
    whole, mapped = jax.jit(from_nvdiffrast)(rast), jax.vmap(jax.vmap(from_nvdiffrast))(rast)
    assert whole.stats.degenerate.shape == (2, 3)
    jax.tree.map(np.testing.assert_array_equal, whole, mapped)


def test_rast_is_float32_whatever_the_precision():
    with jax.enable_x64(True):
        visibility = made_up(2, 2)
        wide = replace(visibility, depth=visibility.depth.astype(float), face=visibility.face.astype(int))
        np.testing.assert_array_equal(to_nvdiffrast(wide), to_nvdiffrast(visibility))


def test_gradients_pass_through_rast():
    """Weights sum to 1, so that gradients which differ by the same number in all three are the same."""
    tri, attributes = jnp.asarray(TRI), jnp.asarray(RNG.normal(size=(60, 2)), jnp.float32)
    pull, visibility = jnp.asarray(RNG.normal(size=(48, 64, 3)), jnp.float32), draw(CLIP, tri)

    def loss(barycentric, depth, through):
        seen = through(replace(visibility, barycentric=barycentric, depth=depth))
        return jnp.sum(pull * jnp.concatenate([interpolate(attributes, tri, seen), seen.depth[..., None]], axis=-1))

    def gradient(through):
        weights, depth = jax.grad(loss, (0, 1))(visibility.barycentric, visibility.depth, through)
        covered = np.asarray(visibility.face) >= 0
        return (weights - jnp.mean(weights, axis=-1, keepdims=True))[covered], depth[covered]

    direct, passed = gradient(lambda seen: seen), gradient(lambda seen: from_nvdiffrast(to_nvdiffrast(seen)))
    assert (direct[0] != 0).all() and (direct[1] != 0).all()
    jax.tree.map(functools.partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-6), passed, direct)


IMAGE = RNG.uniform(size=(3, 5, 4)).astype(np.float32)
UV = RNG.uniform(-2, 3, (200, 2)).astype(np.float32)


def sampled(uv, filters, wrap):
    """`texture` without a footprint."""
    packed = pack_textures([IMAGE], [(wrap, wrap)], [filters])
    return texture(packed, 0, jnp.asarray(uv), jnp.zeros((len(uv), 2, 2)))


def bilinear(x, y, boundary):
    """The image at columns x and rows y, texel centres at whole numbers."""
    total = 0.0
    for i, j in np.ndindex(2, 2):
        column, row = np.floor(x).astype(int) + i, np.floor(y).astype(int) + j
        weight = (1 - np.abs(x - column)) * (1 - np.abs(y - row))
        total = total + weight[:, None] * IMAGE[boundary(row, 3), boundary(column, 5)]
    return total


@pytest.mark.parametrize(("wrap", "boundary"), [(REPEAT, np.mod), (CLAMP, lambda i, n: np.clip(i, 0, n - 1))])
def test_texture_filters_are_nvdiffrasts(wrap, boundary):
    """'linear' and 'nearest', 'wrap' and 'clamp', of an array whose row 0 is at the second coordinate 0."""
    x, y = (UV * np.float64([5, 3])).T
    linear = sampled(UV, (LINEAR, LINEAR, FIRST), wrap)
    np.testing.assert_allclose(linear, bilinear(x - 0.5, y - 0.5, boundary), atol=1e-5)
    nearest = sampled(UV, (NEAREST, NEAREST, FIRST), wrap)
    column, row = (boundary(np.floor(c).astype(int), n) for c, n in ((x, 5), (y, 3)))
    np.testing.assert_array_equal(nearest, IMAGE[row, column])


def test_texture_levels_are_within_half_of_nvdiffrasts():
    """Theirs follows the footprint's major axis, this one the longer of its two sides: up to √2 shorter."""
    packed = pack_textures([np.zeros((64, 64, 4), np.float32)])
    number = np.repeat(np.arange(7.0, dtype=np.float32), 4 ** np.arange(6, -1, -1))
    counted = replace(packed, texels=jnp.asarray(np.repeat(number[:, None], 4, axis=1)))
    footprint = RNG.normal(size=(300, 2, 2)) * 2.0 ** -RNG.uniform(0, 8, (300, 1, 1))
    level = texture(counted, 0, jnp.zeros((300, 2)), jnp.asarray(footprint, jnp.float32))
    major = np.linalg.norm(64 * footprint, ord=2, axis=(1, 2))
    beyond = np.clip(np.log2(major), 0, 6) - np.asarray(level[:, 0], float)
    assert beyond.min() > -1e-5 and beyond.max() < 0.5 + 1e-5 and beyond.max() > 0.3


def test_textures_of_pytorch3d_need_other_uvs():
    """`TexturesUV`: the image upside down, sampled with texel centres at -1 and 1, clamped to the border."""
    u, v = np.clip(UV, 0, 1).T.astype(float)
    expected = bilinear(4 * u, 2 * (1 - v), lambda i, n: np.clip(i, 0, n - 1))
    moved = np.stack([(4 * u + 0.5) / 5, (2 * (1 - v) + 0.5) / 3], axis=-1).astype(np.float32)
    np.testing.assert_allclose(sampled(moved, (LINEAR, LINEAR, FIRST), CLAMP), expected, atol=1e-5)


def opencv(k=K, r=R, t=T, **options):
    return Camera.from_opencv(k, r, t, **{"width": 640, "height": 480, **options})


def pytorch3d(r=R, t=T, **options):
    return Camera.from_pytorch3d(r, t, **{"image_size": (480, 640), **options})


REFUSED = {
    "K in metres": (lambda: opencv(2 * K), r"from_opencv: K must be \[\[fx, s, cx\], .*, got K \[\[1020"),
    "K transposed": (lambda: opencv(K.T), "K must be"),
    "K of four rows": (lambda: opencv(np.eye(4)), r"from_opencv: K must be \[3, 3\], got \[4, 4\]$"),
    "focal length 0": (lambda: opencv(np.diag([0.0, 1.0, 1.0])), "fx and fy above 0"),
    "R a reflection": (lambda: opencv(r=-R), "from_opencv: R must be a rotation, got R"),
    "R scaled": (lambda: opencv(r=2 * R), "R must be a rotation"),
    "R with t": (lambda: opencv(r=np.eye(3, 4)), r"R must be \[3, 3\], got \[3, 4\]$"),
    "t a column": (lambda: opencv(t=T[:, None]), r"t must be \[3\], got \[3, 1\]; map over a batch with jax.vmap"),
    "t NaN": (lambda: opencv(t=np.array([0.0, np.nan, 0.0])), "from_opencv: t must be finite"),
    "empty picture": (lambda: opencv(width=0), "width and height must be above 0, got width 0, height 480"),
    "near beyond far": (lambda: opencv(near=2.0, far=1.0), "0 < near < far must hold, got near 2.0, far 1.0"),
    "a batch of R": (
        lambda: pytorch3d(R[None], T[None]),
        r"from_pytorch3d: R must be \[3, 3\], got \[1, 3, 3\]; map over a batch with jax.vmap",
    ),
    "rows scaled": (lambda: pytorch3d(2 * R), "from_pytorch3d: R must be a rotation, got R"),
    "T NaN": (lambda: pytorch3d(t=np.array([0.0, np.nan, 0.0])), "T and principal_point must be finite"),
    "no focal length": (lambda: pytorch3d(focal_length=0.0), "focal_length must be finite and above 0, got .* 0.0"),
    "three focal lengths": (lambda: pytorch3d(focal_length=np.ones(3)), r"focal_length must be \[2\], got \[3\]"),
    "one size": (lambda: pytorch3d(image_size=512), r"image_size must be \(height, width\), both above 0, got .* 512"),
    "no size": (lambda: pytorch3d(image_size=(480, 0)), r"both above 0, got image_size \[480, 0\]"),
    "another buffer": (lambda: to_nvdiffrast(np.zeros((2, 2, 4))), "visibility must be a Visibility, got ndarray"),
    "three channels": (
        lambda: from_nvdiffrast(np.zeros((2, 2, 3), np.float32)),
        r"from_nvdiffrast: rast must be float32 \[..., h, w, 4\], got float32 \[2, 2, 3\]",
    ),
    "double precision": (lambda: from_nvdiffrast(np.zeros((2, 2, 4))), r"must be float32 .*, got float64 \[2, 2, 4\]"),
}


@pytest.fixture
def without_the_type_checker():
    """Users do not have the one that these tests run under."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_tool_says_is_refused_in_one_line(case, without_the_type_checker):
    call, message = REFUSED[case]
    with pytest.raises((ValueError, TypeError), match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
