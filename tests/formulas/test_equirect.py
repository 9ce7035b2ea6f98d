"""Pictures of all directions: projection, solid angles, bilinear lookup over seam and poles, turning."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pointwise import check_finite, check_slopes

from jaxraster.environment.equirect import directions, lookup, solid_angles, turned, uv
from jaxraster.math.angle import turns

LOOKUP, UV = jax.jit(lookup), jax.jit(uv)
RNG = np.random.default_rng(1)
AXES = np.concatenate([np.eye(3), -np.eye(3)])
# Beside each pole and each half of the seam, in all directions, at distances down to nothing.
TINY = np.array([0.0, 1e-30, 1e-20, 1e-12, 1e-7, 1e-6, 1e-3])
AROUND = np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4])
POLES = np.array([(r * x, sign, r * z) for sign in (1, -1) for r in TINY for x, z in AROUND])
SEAM = np.array([(-1.0, y, sign * z) for y in (0.0, 0.5, -2.0) for sign in (1, -1) for z in TINY])


def unit(count: int) -> np.ndarray:
    d = RNG.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def picture(height: int, width: int) -> np.ndarray:
    return RNG.uniform(0.0, 2.0, (height, width, 3)).astype(np.float32)


def twin(texels: np.ndarray, d: np.ndarray) -> np.ndarray:
    """In double precision, of the picture with a row beyond each pole and columns beyond the seam written out."""
    height, width, _ = texels.shape
    across = np.roll(texels, width // 2, axis=1)
    whole = np.concatenate([across[:1], texels, across[-1:]]).astype(np.float64)
    whole = np.concatenate([whole[:, -1:], whole, whole[:, :1]], axis=1)
    d = np.float64(np.float32(d))
    x = (np.arctan2(d[:, 2], d[:, 0]) / (2 * np.pi) + 0.5) * width + 0.5
    y = np.arccos(d[:, 1] / np.linalg.norm(d, axis=1)) / np.pi * height + 0.5
    i, j = (np.minimum(np.floor(c).astype(int), n) for c, n in ((y, height), (x, width)))
    total = 0.0
    for low in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - low - (y - i)) * np.abs(1 - right - (x - j))
            total = total + weight[:, None] * whole[i + low, j + right]
    return total


def test_the_axes_lie_where_the_conventions_say():
    """+X in the middle, +Z a quarter to the right of it, -X on the seam, +Y on top."""
    u, v = (np.asarray(x) for x in UV(jnp.asarray(AXES, jnp.float32)))
    np.testing.assert_allclose(u[[0, 2, 5]], [0.5, 0.75, 0.25], atol=1e-7)
    assert u[3] in (0, 1)
    np.testing.assert_allclose(v, [0.5, 0, 0.5, 0.5, 1, 0.5], atol=1e-7)
    middle = np.asarray(directions(1, 4))
    assert (middle[0, :, 1] == 0).all() and (middle[0, 1:3, 0] > 0).all() and (middle[0, 2:, 2] > 0).all()


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 8), (8, 1), (3, 7), (64, 128)])
def test_directions_are_unit_and_lie_at_texel_centres(height, width):
    d = np.asarray(directions(height, width))
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1, atol=2e-7)
    u, v = (np.asarray(x) for x in UV(jnp.asarray(d)))
    np.testing.assert_allclose(u, np.broadcast_to((np.arange(width) + 0.5) / width, u.shape), atol=2e-7)
    np.testing.assert_allclose(v, np.broadcast_to((np.arange(height)[:, None] + 0.5) / height, v.shape), atol=2e-7)
    np.testing.assert_allclose(LOOKUP(picture_ := jnp.asarray(picture(height, width)), d), picture_, atol=2e-4)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 9), (9, 1), (37, 5), (512, 1024), (4096, 8192)])
def test_solid_angles_are_those_of_bands_and_add_up_to_the_sphere(height, width):
    bands = np.asarray(solid_angles(height, width), np.float64)
    np.testing.assert_allclose(bands.sum() * width, 4 * np.pi, rtol=1e-7)
    edges = np.cos(np.linspace(0, np.pi, height + 1))
    # The difference of cosines in double precision loses half of its digits at the poles of the largest.
    np.testing.assert_allclose(bands, (edges[:-1] - edges[1:]) * 2 * np.pi / width, rtol=1e-6)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 6), (6, 1), (5, 12), (64, 128)])
def test_lookup_is_bilinear_around_the_seam_and_over_the_poles(height, width):
    texels, d = picture(height, width), np.concatenate([unit(2000), AXES, POLES[16:], SEAM])
    # u is good to 6e-8, which is some of a texel's width.
    np.testing.assert_allclose(LOOKUP(jnp.asarray(texels), jnp.asarray(d, jnp.float32)), twin(texels, d), atol=1e-4)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 6), (6, 1), (7, 9)])
def test_what_is_constant_is_constant_in_every_direction(height, width):
    d = jnp.asarray(np.concatenate([unit(5000), AXES, POLES, SEAM]), jnp.float32)
    seen = LOOKUP(jnp.full((height, width, 3), 3.7), d)
    np.testing.assert_allclose(seen, np.full(d.shape, 3.7), rtol=3e-7)


def test_there_is_no_step_at_the_seam_nor_over_a_pole():
    texels = jnp.asarray(picture(8, 16))
    left, right = (jnp.asarray(SEAM * (1, 1, s), jnp.float32)[SEAM[:, 2] == 1e-6] for s in (1, -1))
    np.testing.assert_allclose(LOOKUP(texels, left), LOOKUP(texels, right), atol=1e-4)
    here = POLES[np.abs(np.hypot(POLES[:, 0], POLES[:, 2]) - 1e-6) < 1e-9]
    np.testing.assert_allclose(
        *(LOOKUP(texels, jnp.asarray(here * (s, 1, s), jnp.float32)) for s in (1, -1)), atol=1e-4
    )


@pytest.mark.parametrize("columns", [1, 5, -3, 32])
def test_turning_by_whole_columns_rolls_the_picture(columns):
    """Right-handed about +Y: what was towards +X is then towards -Z, which is to the left."""
    texels, width = picture(16, 32), 32
    d = jnp.asarray(unit(4000), jnp.float32)
    angle = 2 * np.pi * columns / width
    seen = LOOKUP(jnp.asarray(texels), turned(d, -angle))
    np.testing.assert_allclose(seen, LOOKUP(jnp.asarray(np.roll(texels, -columns, axis=1)), d), atol=3e-5)
    np.testing.assert_allclose(
        turned(jnp.eye(3), jnp.float32(np.pi / 2)), [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-7
    )


def test_lookup_is_finite_at_poles_and_seam_and_where_there_is_no_direction():
    """Value and both Jacobians; length does not matter from 1e-12 to 1e12."""
    texels = jnp.asarray(picture(4, 8))
    nowhere = [[0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], [np.inf, 0.0, 0.0], [0.0, -np.inf, 1.0]]
    d = np.concatenate([POLES, SEAM, AXES, nowhere])
    check_finite(lambda d: lookup(texels, d), d)
    up = LOOKUP(texels, jnp.asarray([[0.0, 1.0, 0.0]]))[0]
    for one in LOOKUP(texels, jnp.asarray(nowhere, jnp.float32)):
        np.testing.assert_array_equal(one, up)
    some = unit(50)
    for scale in (1e-12, 1e12):
        seen = LOOKUP(texels, jnp.asarray(some * scale, jnp.float32))
        np.testing.assert_allclose(seen, LOOKUP(texels, jnp.asarray(some, jnp.float32)), atol=1e-5)


def test_gradients_are_exact():
    """In directions, differences of values; in texels, the weights, which add up to one for each lookup."""
    texels, d = picture(4, 8), unit(40)
    check_slopes(lambda d: lookup(jnp.asarray(texels, d.dtype), d), d, rtol=1e-5)
    seen = jnp.asarray(np.concatenate([d, POLES, SEAM]), jnp.float32)
    slope = jax.jit(jax.grad(lambda t: lookup(t, seen).sum()))(jnp.asarray(texels))
    np.testing.assert_allclose(slope.sum(), 3 * len(seen), rtol=1e-5)


def test_the_angle_is_that_of_the_library():
    """Everywhere to 3e-8 of a turn, of denormals and of the largest numbers, with its sign at -0; slopes exactly."""
    turn = np.linspace(-np.pi, np.pi, 100001)
    y, x = (np.float32(f(turn)) for f in (np.sin, np.cos))
    twin = np.arctan2(np.float64(y), np.float64(x)) / (2 * np.pi)
    np.testing.assert_allclose(jax.jit(turns)(jnp.asarray(y), jnp.asarray(x)), twin, atol=5e-8)
    ends = np.float32([0.0, -0.0, 1e-30, -1e-30, 1.0, -1.0, 3e38, -3e38])
    y, x = (np.ravel(a) for a in np.meshgrid(ends, ends))
    np.testing.assert_allclose(
        jax.jit(turns)(jnp.asarray(y), jnp.asarray(x)),
        np.where((x == 0) & (y == 0), 0, np.arctan2(y, x) / (2 * np.pi)),
        atol=5e-8,
    )
    y, x = unit(30)[:, :2].T
    check_slopes(turns, y, x)
    check_finite(turns, *(np.ravel(a) for a in np.meshgrid(ends[:6], ends[:6])))
