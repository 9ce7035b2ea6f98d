"""Surroundings made ready: blurred by the lobe exactly, for every roughness, from pictures of any size."""

import functools
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.environment import blur, octahedral, prefilter
from jaxraster.environment.equirect import directions, solid_angles
from jaxraster.environment.irradiance import CELLS, coefficients
from jaxraster.environment.prefilter import LEVELS, alphas, cells, level
from jaxraster.environment.prepare import prepare
from jaxraster.math.harmonics import harmonics, irradiance
from jaxraster.scene import Directional, EnvironmentMap

HEIGHT = 64
RNG = np.random.default_rng(0)
blurred = jax.jit(blur.blurred)
mirrored = jax.jit(prefilter.mirrored, static_argnums=1)
# What a lobe leaves of the slope of linear surroundings, by roughness: its mean cosine, by quadrature.
SLOPES = {0.25: 0.976093, 0.5: 0.867396, 0.75: 0.745131, 1.0: 0.666667}


def unit(count: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def single(x) -> jax.Array:
    return jnp.asarray(x, jnp.float32)


@functools.cache
def linear() -> tuple[EnvironmentMap, np.ndarray]:
    """Surroundings 2 + b·d, and b of three channels."""
    b = unit(3, 7).T
    return prepare(single(2 + np.asarray(directions(HEIGHT, 2 * HEIGHT)) @ b)), b


def chain(ready: EnvironmentMap, direction, alpha) -> np.ndarray:
    """The prefiltered radiance, in double precision."""
    alpha = jnp.broadcast_to(single(alpha), (len(direction),))
    return np.asarray(mirrored(ready.specular, ready.texels.shape[0], single(direction), alpha), np.float64)


def lobe(cosine: np.ndarray, alpha: float) -> np.ndarray:
    """D (n·l) for n = v = r, not normalised: D = α²/(π ((α² - 1) (n·h)² + 1)²), (n·h)² = (1 + cosine)/2."""
    square = 0.5 + 0.5 * cosine
    return np.maximum(cosine, 0) / ((1 - square) + alpha * alpha * square) ** 2


# -- Blur --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.3, 0.7, 1.0])
@pytest.mark.parametrize("shape", [(16, 32), (8, 5)])
def test_blurred_is_the_weighed_mean_over_all_texels(shape, alpha):
    """Against the plain sum over all pairs of directions, in double precision."""
    texels = RNG.uniform(0, 3, (*shape, 3)) ** 4
    theta, phi = (np.arange(shape[0]) + 0.5) * np.pi / shape[0], (np.arange(shape[1]) + 0.5) * 2 * np.pi / shape[1]
    s, c = np.sin(theta)[:, None], np.cos(theta)[:, None]
    points = np.stack(np.broadcast_arrays(s * np.cos(phi), c, s * np.sin(phi)), axis=-1).reshape(-1, 3)
    weights = lobe(points @ points.T, alpha) * np.repeat(np.sin(theta), shape[1])
    expected = weights @ texels.reshape(-1, 3) / weights.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(blurred(single(texels), single(alpha)).reshape(-1, 3), expected, rtol=2e-5)


@pytest.mark.parametrize("roughness", SLOPES)
def test_linear_surroundings_lose_a_known_part_of_their_slope(roughness):
    """a + k b·r, k the mean cosine of the lobe; ⅔ at roughness 1, as of irradiance over π."""
    d = np.asarray(directions(HEIGHT, 2 * HEIGHT), np.float64)
    b = unit(3, 8).T
    expected = 5 + SLOPES[roughness] * d @ b
    np.testing.assert_allclose(blurred(single(5 + d @ b), single(roughness**2)), expected, atol=6e-4)


def test_a_pole_is_as_any_other_place():
    """A glowing cap about +Y and the same about +X, blurred alike at the same angles from their middles."""
    d = np.asarray(directions(HEIGHT, 2 * HEIGHT), np.float64)
    about = [blurred(single(np.repeat(d[..., axis, None] > 0.5, 3, axis=2)), single(0.2)) for axis in (1, 0)]
    pole = np.asarray(about[0])[:, 0, 0]
    side = np.asarray(about[1])[HEIGHT // 2, HEIGHT:, 0]
    angles = np.arange(HEIGHT)
    # Columns are at half texels from the axis, half a row aside of it.
    np.testing.assert_allclose(np.interp(angles, angles, pole), side, atol=0.02)
    assert pole[0] > 0.9 and pole[-1] < 0.02


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 5), (64, 128), (100, 37)])
def test_resizing_keeps_the_mean_of_all_directions(shape):
    texels = RNG.uniform(0, 9, (*shape, 3))
    small = np.asarray(blur.resized(single(texels), 16, 32), np.float64)

    def mean(picture):
        bands = np.asarray(solid_angles(*picture.shape[:2]), np.float64)
        return np.einsum("h,hwc->c", bands, picture) / (4 * np.pi)

    np.testing.assert_allclose(mean(small), mean(texels), rtol=2e-6)
    assert small.min() >= texels.min() - 1e-5 and small.max() <= texels.max() + 1e-5


# -- Levels ------------------------------------------------------------------------------------------------------------


def test_levels_lie_where_they_are_said_to():
    np.testing.assert_allclose(level(single(alphas())), np.arange(LEVELS), atol=2e-6)
    assert alphas()[0] == 0 and alphas()[-1] == 1 and alphas()[4] == pytest.approx(0.25**2)
    assert (np.diff(level(jnp.linspace(0, 1, 300))) > 0).all()


def test_roughness_beyond_both_ends_is_that_of_the_ends():
    """Also what is no number reads some level; just inside of the ends nothing steps."""
    outside = level(single([-1.0, 0.0, 1.0, 7.0]))
    np.testing.assert_allclose(outside, [0, 0, LEVELS - 1, LEVELS - 1], atol=1e-6)
    ready, r = linear()[0], unit(50)
    for beyond, end, inside in ((-1.0, 0.0, 1e-7), (7.0, 1.0, 1 - 1e-6)):
        np.testing.assert_array_equal(chain(ready, r, beyond), chain(ready, r, end))
        np.testing.assert_allclose(chain(ready, r, inside), chain(ready, r, end), atol=1e-4)
    assert chain(ready, r, np.nan).shape == (50, 3)


def test_no_level_is_larger_than_it_needs():
    for height in (1, 2, 63, 64, 500, 512, 4096):
        counts = cells(height)
        assert len(counts) == LEVELS and counts == sorted(counts, reverse=True)
        assert counts[0] <= 256 and counts[-1] == 32
    assert cells(512)[0] == cells(4096)[0] == 256 and cells(64)[0] == 32


def test_mixing_two_levels_leaves_as_little_as_is_said():
    """By degree l of the surroundings' harmonics the lobe keeps k_l; natural surroundings have a power of 1/l^1.5 in
    all harmonics of a degree together."""
    x, weight = np.polynomial.legendre.leggauss(1500)
    degrees = np.unique(np.geomspace(1, 256, 40).astype(int))

    def kept(alpha):
        if alpha == 0:
            return np.ones(len(degrees))
        # Crowd the points where the lobe is: tan θ = α t of the half vector.
        t = np.tan((0.5 + 0.5 * x) * np.arctan(1 / alpha))
        q = (alpha * t) ** 2 / (1 + (alpha * t) ** 2)
        mass = weight * lobe(1 - 2 * q, alpha) * t / (1 + (alpha * t) ** 2) ** 2 * (1 + t * t)
        return legendre(degrees, 1 - 2 * q) @ mass / mass.sum()

    def legendre(degrees, c):
        rows, before, now = {}, np.ones_like(c), c
        for l in range(1, degrees.max() + 1):
            rows[l] = now
            before, now = now, ((2 * l + 1) * c * now - l * before) / (l + 1)
        return np.stack([rows[l] for l in degrees])

    levels = np.stack([kept(alpha) for alpha in alphas()])
    power = np.gradient(degrees.astype(float)) * degrees**-1.5
    worst = {}
    for roughness in (0.03, 0.05, 0.07, 0.1, 0.15, 0.22, 0.3, 0.4, 0.5, 0.55, 0.75, 0.85):
        at = float(level(single(roughness**2)))
        i, f = int(at), at - int(at)
        off = (1 - f) * levels[i] + f * levels[i + 1] - kept(roughness**2)
        worst[roughness] = np.sqrt((power * off**2).sum() / power.sum())
    print(worst)
    assert max(worst.values()) < 0.035 and max(w for r, w in worst.items() if r > 0.2) < 0.012


def test_a_constant_is_exact_at_every_level():
    for shape, value in (((HEIGHT, 2 * HEIGHT), (0.25, 1.0, 6e4)), ((1, 1), (3.0, 0.0, 1e-3))):
        ready = prepare(jnp.broadcast_to(single(value), (*shape, 3)))
        for rows in (ready.specular, ready.irradiance):
            np.testing.assert_allclose(
                np.asarray(rows).reshape(-1, 3), np.broadcast_to(value, (rows.size // 3, 3)), rtol=3e-6
            )
        normals = single(unit(20))
        np.testing.assert_allclose(irradiance(ready.harmonics, normals), np.broadcast_to(value, (20, 3)), rtol=3e-6)


@pytest.mark.parametrize("index", range(LEVELS))
def test_linear_surroundings_in_the_chain(index):
    """At a level's own roughness the slope is the lobe's mean cosine, as near as cells are flat."""
    ready, b = linear()
    alpha = alphas()[index]
    if alpha:
        q = np.linspace(0, 0.5, 400001) ** 2 * 2
        mass = lobe(1 - 2 * q, alpha) * np.gradient(q)
        slope = (mass * (1 - 2 * q)).sum() / mass.sum()
    else:
        slope = 1.0
    r = unit(500, 9)
    np.testing.assert_allclose(chain(ready, r, alpha), 2 + slope * r @ b, atol=2e-3)


def test_roughness_one_is_irradiance_over_pi():
    """The chain's last level, the map of irradiance and nine coefficients agree."""
    texels = single(RNG.uniform(0, 2, (HEIGHT, 2 * HEIGHT, 3)) ** 3)
    ready, n = prepare(texels), unit(200, 2)
    rough = chain(ready, n, 1.0)
    by_map = octahedral.lookup(ready.irradiance, single(n), CELLS)
    np.testing.assert_allclose(by_map, rough, rtol=2e-3)
    np.testing.assert_allclose(irradiance(ready.harmonics, single(n)), rough, rtol=0.02)
    # And both with the sum over all texels.
    d = np.asarray(directions(HEIGHT, 2 * HEIGHT), np.float64).reshape(-1, 3)
    bands = np.repeat(np.asarray(solid_angles(HEIGHT, 2 * HEIGHT), np.float64), 2 * HEIGHT)
    expected = (np.maximum(n @ d.T, 0) * bands) @ np.asarray(texels, np.float64).reshape(-1, 3) / np.pi
    np.testing.assert_allclose(rough, expected, rtol=2e-3)


def test_a_mirror_shows_the_picture():
    """Level 0 at the texels' own directions, of a picture as smooth as its resolution allows."""
    d = np.asarray(directions(HEIGHT, 2 * HEIGHT), np.float64)
    texels = np.stack([np.sin(5 * d[..., 0]), d[..., 1] * d[..., 2], np.cos(6 * d[..., 1])], axis=-1) + 2
    ready = prepare(single(texels))
    some = RNG.integers(0, d.shape[0] * d.shape[1], 400)
    np.testing.assert_allclose(chain(ready, d.reshape(-1, 3)[some], 0.0), texels.reshape(-1, 3)[some], atol=0.03)


@pytest.mark.parametrize("columns", [32, 64, 5, -77])
def test_rolled_columns_are_turned_surroundings(columns):
    """A roll to the right turns +X towards +Z. By quarter turns the octahedron is what it was; else its cells move, on
    which noise that changes from texel to texel is seen through narrow lobes."""
    texels = single(RNG.uniform(0, 1, (HEIGHT, 2 * HEIGHT, 3)))
    plain, rolled = prepare(texels), prepare(jnp.roll(texels, columns, axis=1))
    angle = columns * np.pi / HEIGHT
    x, y, z = unit(300, 3).T
    back = np.stack([np.cos(angle) * x + np.sin(angle) * z, y, np.cos(angle) * z - np.sin(angle) * x], axis=-1)
    for alpha, tolerance in ((alphas()[3], 0.05), (0.3, 2e-3), (1.0, 2e-4)):
        got, expected = chain(rolled, np.stack([x, y, z], axis=-1), alpha), chain(plain, back, alpha)
        np.testing.assert_allclose(got, expected, atol=tolerance if columns % 32 else 2e-6)
    got = irradiance(rolled.harmonics, single(np.stack([x, y, z], axis=-1)))
    np.testing.assert_allclose(got, irradiance(plain.harmonics, single(back)), atol=1e-5)


# -- Coefficients and the whole ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 5), (8, 16)])
def test_coefficients_are_integrals_over_the_texels(shape):
    """Against Gauss's quadrature with 20 nodes a texel and axis, in double precision."""
    texels = np.random.default_rng(5).uniform(0, 1, (*shape, 3))
    node, weight = np.polynomial.legendre.leggauss(20)
    # The angles of the nodes, and their shares, of each row and each column of texels: [texels, nodes].
    (theta, d_theta), (phi, d_phi) = (
        ((np.arange(count)[:, None] + 0.5 + 0.5 * node) * (extent / count), 0.5 * weight * extent / count)
        for count, extent in zip(shape, (np.pi, 2 * np.pi))
    )
    theta, phi = theta[:, :, None, None], phi - np.pi
    parts = np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)
    with jax.enable_x64(True):
        basis = np.asarray(harmonics(jnp.asarray(np.stack(np.broadcast_arrays(*parts), axis=-1))))
    expected = np.einsum("hiwjk,hi,i,j,hwc->kc", basis, np.sin(theta)[:, :, 0, 0], d_theta, d_phi, texels)
    np.testing.assert_allclose(coefficients(single(texels)), expected, rtol=1e-5, atol=2e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (7, 3), (HEIGHT, 2 * HEIGHT)])
@pytest.mark.parametrize("kind", ["black", "one texel"])
def test_all_is_finite_and_positive(shape, kind):
    """Also for a single texel of 6e4 in the dark: nothing below 0 but roundings of what is strongest."""
    texels = np.zeros((*shape, 3), np.float32)
    texels[0, 0] = 0.0 if kind == "black" else 6e4
    ready = prepare(single(texels))
    for leaf in jax.tree.leaves(ready):
        assert np.isfinite(leaf).all()
    least = min(float(ready.specular.min()), float(ready.irradiance.min()))
    assert least >= -1e-6 * float(ready.specular.max())


@pytest.mark.parametrize(
    ("texels", "message"),
    [
        (np.ones((8, 16), np.float32), r"prepare: texels must be float \[h, w, 3\], got float32 \[8, 16\]"),
        (np.ones((8, 16, 3), np.int32), "prepare: texels must be float .* got int32"),
        ([[1.0, 1.0, 1.0]], "prepare: texels must be float .* got list; make it an array"),
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(texels, message):
    with pytest.raises((TypeError, ValueError), match=message):
        inspect.unwrap(prepare)(texels)


def test_suns_and_rotation_are_kept():
    suns = Directional(direction=single(unit(2)), irradiance=jnp.ones((2, 3)))
    ready = prepare(jnp.ones((2, 4, 3)), suns, 0.5)
    assert ready.suns.direction.shape == (2, 3) and float(ready.rotation) == 0.5
    assert prepare(jnp.ones((2, 4, 3))).suns.irradiance.shape == (0, 3)


def test_a_batch_is_prepared_one_by_one():
    texels = single(RNG.uniform(0, 5, (2, 4, 8, 3)))
    together = jax.vmap(prepare)(texels)
    for i in range(2):
        for one, all_of_them in zip(jax.tree.leaves(prepare(texels[i])), jax.tree.leaves(together)):
            np.testing.assert_allclose(all_of_them[i], one, rtol=1e-5, atol=1e-5)


def test_gradients_reach_the_texels():
    """All is linear in them: the gradient of any sum, times any texels, is that sum of these."""
    texels, other = (single(RNG.uniform(0, 2, (4, 8, 3))) for _ in range(2))
    shapes = jax.eval_shape(prepare, texels)
    weights = {
        name: single(RNG.normal(size=getattr(shapes, name).shape)) for name in ("harmonics", "irradiance", "specular")
    }

    def total(texels):
        ready = prepare(texels)
        return sum(jnp.vdot(weight, getattr(ready, name)) for name, weight in weights.items())

    slope = jax.jit(jax.grad(total))(texels)
    scale = float(jnp.abs(slope * other).sum())
    assert np.isfinite(slope).all() and scale > 100
    np.testing.assert_allclose(jnp.vdot(slope, other), total(other), atol=1e-5 * scale)
    _, forward = jax.jvp(total, (texels,), (other,))
    np.testing.assert_allclose(forward, total(other), atol=1e-5 * scale)
