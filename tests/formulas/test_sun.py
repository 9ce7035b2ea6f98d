"""Suns cut out of pictures: no light lost, found wherever they are, and none where there is none."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.environment.equirect import directions, lookup, solid_angles, turned
from jaxraster.environment.sun import SHARE, STRONG, cut_suns
from jaxraster.light.sunlit import sunlit
from jaxraster.scene import Directional, Environment, EnvironmentMap
from jaxraster.stack import stack_lights

HEIGHT, WIDTH = 128, 256
D, BANDS = (np.asarray(f(HEIGHT, WIDTH), np.float64) for f in (directions, solid_angles))
RNG = np.random.default_rng(5)
CLOUDS = RNG.uniform(0.5, 1.5, (HEIGHT, WIDTH, 3)).astype(np.float32)


def energy(texels) -> np.ndarray:
    return np.einsum("h,hwc->c", np.asarray(solid_angles(*texels.shape[:2]), np.float64), np.float64(texels))


def with_disc(center, radius: float, radiance, texels=CLOUDS) -> np.ndarray:
    """A disc about a direction, its radius in degrees, painted over a picture."""
    inside = D @ (np.asarray(center) / np.linalg.norm(center)) >= np.cos(np.radians(radius)) - 1e-6
    return np.where(inside[..., None], np.float32(radiance), texels)


PLACES = {
    "mid": (0.3, 0.8, 0.5),
    "seam": (-1.0, 0.4, 0.0),
    "pole": (0.0, 1.0, 0.0),
    "beside a pole": (0.02, 1.0, 0.01),
    "below": (0.1, -1.0, 0.1),
}


@pytest.mark.parametrize("radius", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("place", PLACES)
def test_a_sun_is_cut_and_no_light_is_lost(place, radius):
    """One texel, or a disc of many, in every channel to float error; the direction is that of its light."""
    middle = np.unravel_index(
        np.argmax(D @ (np.asarray(PLACES[place]) / np.linalg.norm(PLACES[place]))), (HEIGHT, WIDTH)
    )
    towards = D[middle] if radius == 0 else np.asarray(PLACES[place]) / np.linalg.norm(PLACES[place])
    texels = with_disc(towards, radius, (9e4, 7e4, 5e4))
    left, suns = cut_suns(texels)
    assert suns.direction.shape == (1, 3) and left.dtype == np.float32
    total = energy(left) + np.asarray(suns.irradiance, np.float64).sum(axis=0)
    np.testing.assert_allclose(total, energy(texels), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(suns.direction[0]), 1, atol=1e-6)
    # Half a texel is 0.7°, by which a disc of few texels may lie beside what it is to be.
    assert -np.asarray(suns.direction[0]) @ towards > np.cos(np.radians(0.1 if radius == 0 else 0.7))
    # What is left in its place is as what surrounds it, and the rest is untouched.
    changed = (left != texels).any(axis=-1)
    np.testing.assert_allclose(left[changed], np.broadcast_to(left[changed][:1], left[changed].shape))
    assert left.min() >= 0.5 and left.max() <= 1.5 and 0.8 < left[changed].mean() < 1.2


def test_several_suns_come_strongest_first_and_no_more_than_asked_for():
    texels = with_disc(
        (1.0, 0.5, 0.0), 1.0, 2e4, with_disc((0.0, 0.5, 1.0), 1.0, 1e4, with_disc((0.0, 1.0, -1.0), 1.0, 3e4))
    )
    left, suns = cut_suns(texels)
    strength = np.asarray(suns.irradiance)[:, 1]
    assert len(strength) == 3 and (np.diff(strength) < 0).all() and left.max() <= 1.5
    left, suns = cut_suns(texels, most=1)
    assert suns.irradiance.shape == (1, 3) and left.max() == 2e4


def one_texel(share: float) -> np.ndarray:
    """Constant but for a texel that gives nearly that share of all light, 190 times as bright as the mean."""
    texels = np.ones((HEIGHT, WIDTH, 3), np.float32)
    texels[70, 20] = share * 4 * np.pi / BANDS[70]
    return texels


STRIP = np.ones((1, 64, 3), np.float32)
STRIP[0, 3] = 1e6
SUNLESS = {
    "black": np.zeros((64, 128, 3), np.float32),
    "constant": np.full((64, 128, 3), 7.0, np.float32),
    "noise": CLOUDS,
    "overcast": ((1 + 2 * np.maximum(D[..., 1:2], 0)) / 3 * np.ones(3)).astype(np.float32),
    "a window": with_disc((1.0, 0.2, 0.0), 8.0, 5e3),
    "a long lamp": np.where((np.abs(D[..., 1:2] - 0.5) < 0.01) & (D[..., :1] > 0.8), np.float32(1e4), CLOUDS),
    "too weak": one_texel(0.9 * SHARE),
    "too faint": with_disc((1.0, 0.2, 0.0), 2.5, 0.9 * STRONG),
    "1 x 1": np.full((1, 1, 3), 5.0, np.float32),
    "a column": np.ones((16, 1, 3), np.float32),
}


def test_a_sun_gives_a_share_of_all_light():
    assert cut_suns(one_texel(1.1 * SHARE))[1].irradiance.shape == (1, 3)


@pytest.mark.parametrize("name", SUNLESS)
def test_there_is_no_sun_where_there_is_none(name):
    left, suns = cut_suns(SUNLESS[name])
    assert suns.direction.shape == suns.irradiance.shape == (0, 3)
    np.testing.assert_array_equal(left, SUNLESS[name])


@pytest.mark.parametrize(
    "texels",
    [
        STRIP,
        STRIP.transpose(1, 0, 2),
        np.where(np.arange(64)[:, None, None] == 0, 1e30, np.zeros((64, 32, 3), np.float32)),
    ],
)
def test_odd_pictures_leave_numbers_that_are_finite(texels):
    texels = texels.astype(np.float32)
    left, suns = cut_suns(texels)
    assert np.isfinite(left).all() and (left >= 0).all() and all(jnp.isfinite(x).all() for x in jax.tree.leaves(suns))
    total = energy(left) + np.asarray(suns.irradiance, np.float64).sum(axis=0)
    np.testing.assert_allclose(total, energy(texels), rtol=1e-5)


def test_texels_that_are_not_finite_stay_and_count_for_nothing():
    texels = with_disc((1.0, 0.5, 0.0), 1.0, 2e4)
    broken = texels.copy()
    broken[100, 7], broken[101, 9, 1] = np.nan, np.inf
    (left, suns), (_, expected) = cut_suns(broken), cut_suns(texels)
    np.testing.assert_allclose(suns.irradiance, expected.irradiance, rtol=1e-6)
    assert (np.isnan(left) == np.isnan(broken)).all()
    np.testing.assert_array_equal(np.isfinite(left).all(axis=-1).sum(), HEIGHT * WIDTH - 2)


def test_a_real_sky_loses_its_sun_and_no_light(assets):
    from jaxraster.io.light import read_light

    texels, _ = read_light(assets / "environments" / "spiaggia_di_mondello_1k.hdr")
    left, suns = cut_suns(texels)
    assert suns.direction.shape == (1, 3)
    irradiance = np.asarray(suns.irradiance[0], np.float64)
    np.testing.assert_allclose(energy(left) + irradiance, energy(texels), rtol=1e-6)
    # About half of its light, from 25° above the horizon.
    np.testing.assert_allclose(irradiance / energy(texels), [0.503, 0.505, 0.405], atol=0.002)
    np.testing.assert_allclose(suns.direction[0], [-0.728, -0.427, -0.536], atol=1e-3)


# -- The lights of a scene with those suns -----------------------------------------------------------------------------


def surroundings(suns: Directional, rotation: float = 0.0) -> Environment:
    nothing = jnp.zeros((1, 1))
    texels = jnp.ones((4, 8, 3))
    map = EnvironmentMap(
        texels=texels,
        rotation=jnp.float32(rotation),
        suns=suns,
        harmonics=jnp.zeros((9, 3)),
        irradiance=nothing,
        specular=nothing,
    )
    black = jnp.zeros(3)
    return Environment(up=jnp.array([0.0, 1.0, 0.0]), sky=black, ground=black, map=map)


def test_suns_join_the_directional_lights_where_the_turned_picture_shows_them():
    texels = with_disc((1.0, 0.5, 0.3), 1.0, 1e5)
    _, suns = cut_suns(texels)
    lights = stack_lights(
        directional=[((0.0, -1.0, 0.0), (2.0, 2.0, 2.0))], point=[((0.0, 1.0, 0.0), (3.0, 3.0, 3.0), np.inf)]
    )
    for angle in (0.0, 1.0, -2.5):
        lit = sunlit(lights, surroundings(suns, angle))
        assert lit.directional.direction.shape == (2, 3) and lit.point is lights.point
        np.testing.assert_array_equal(lit.directional.direction[0], [0, -1, 0])
        np.testing.assert_array_equal(lit.directional.irradiance[1], suns.irradiance[0])
        towards = -lit.directional.direction[1:]
        assert lookup(jnp.asarray(texels), turned(towards, -angle))[0, 0] > 0.9e5
    # Half a turn is a turn back: the light comes from the other side, from as high.
    half = sunlit(lights, surroundings(suns, np.pi)).directional.direction[1]
    np.testing.assert_allclose(half, suns.direction[0] * jnp.array([-1.0, 1.0, -1.0]), atol=1e-6)


def test_lights_without_suns_are_the_same_object():
    lights = stack_lights(directional=[((0.0, -1.0, 0.0), (2.0, 2.0, 2.0))])
    none = Directional(direction=jnp.zeros((0, 3)), irradiance=jnp.zeros((0, 3)))
    assert sunlit(lights, surroundings(none)) is lights
    assert sunlit(lights, dataclasses.replace(surroundings(none), map=None)) is lights


def test_slopes_reach_suns_and_rotation():
    _, suns = cut_suns(with_disc((1.0, 0.5, 0.3), 1.0, 1e5))

    def toward_x(angle, irradiance):
        around = surroundings(dataclasses.replace(suns, irradiance=irradiance))
        around = dataclasses.replace(around, map=dataclasses.replace(around.map, rotation=angle))
        lit = sunlit(stack_lights(), around).directional
        return lit.direction[0, 0] + jnp.sum(lit.irradiance)

    slope, ones = jax.grad(toward_x, (0, 1))(jnp.float32(0.0), suns.irradiance)
    np.testing.assert_allclose(slope, suns.direction[0, 2], rtol=1e-5)
    np.testing.assert_array_equal(ones, np.ones((1, 3)))
