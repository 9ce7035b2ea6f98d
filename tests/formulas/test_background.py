"""Maps behind everything: where their texels show, turned and scaled, on top of the tones, with suns as discs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.environment.equirect import directions, lookup, turned
from jaxraster.light.background import RADIUS, Background, background, rays
from jaxraster.math.transform import look_at, perspective
from jaxraster.scene import Camera, Directional, Environment, EnvironmentMap

SIZE = {"height": 12, "width": 16}
TEXELS = jnp.asarray(np.random.default_rng(2).uniform(0.0, 3.0, (8, 16, 3)), jnp.float32)
BLACK, GREY = jnp.zeros(3), jnp.full(3, 0.5)
NO_SUNS = Directional(direction=jnp.zeros((0, 3)), irradiance=jnp.zeros((0, 3)))


def camera(towards, fov: float = 1.2) -> Camera:
    return Camera(world_from_view=look_at(np.zeros(3), np.asarray(towards)), clip_from_view=perspective(fov))


def around(texels=TEXELS, rotation=0.0, suns=NO_SUNS, tone=BLACK) -> Environment:
    empty = jnp.zeros((1, 1))
    map = EnvironmentMap(
        texels=texels,
        rotation=jnp.asarray(rotation, jnp.float32),
        suns=suns,
        harmonics=jnp.zeros((9, 3)),
        irradiance=empty,
        specular=empty,
    )
    return Environment(up=jnp.array([0.0, 1.0, 0.0]), sky=tone, ground=tone, map=map)


draw = jax.jit(lambda c, e, s: background(c, e, s, **SIZE))
HERE = camera((0.3, 0.2, 1.0))


@pytest.mark.parametrize("rotation", [0.0, 0.7, -3.0])
def test_the_map_shows_along_every_ray_turned_and_scaled(rotation):
    direction = turned(rays(HERE, **SIZE), -rotation)
    expected = np.asarray(lookup(TEXELS, direction))
    np.testing.assert_allclose(draw(HERE, around(rotation=rotation), Background()), expected, atol=1e-5)
    scaled = draw(HERE, around(rotation=rotation, tone=GREY), Background(gain=2.0))
    np.testing.assert_allclose(scaled, 2 * (expected + 0.5), atol=2e-5)


def test_blurriness_leaves_the_map_sharp():
    pictures = [draw(HERE, around(tone=GREY), Background(blurriness=b)) for b in (0.0, 1.0)]
    np.testing.assert_allclose(*pictures, atol=1e-6)


@pytest.mark.parametrize("texel", [(3, 8), (2, 0), (5, 15), (0, 4)])
def test_a_camera_that_looks_at_a_texel_sees_it_in_the_middle(texel):
    towards = np.asarray(directions(8, 16))[texel]
    # So near that all pixels lie within the texel's middle.
    seen = draw(camera(towards, fov=0.01), around(), Background())
    np.testing.assert_allclose(seen[6, 8], TEXELS[texel], atol=0.05)


def test_a_sun_is_a_disc_with_all_its_light():
    """In a picture of 2° by some 2.7° about it: the mean radiance times the angle seen is its irradiance."""
    sun = Directional(direction=jnp.array([[-0.3, -0.5, -1.0]]), irradiance=jnp.array([[4.0, 3.0, 2.0]]))
    size, towards = {"height": 96, "width": 128}, np.array([0.3, 0.5, 1.0])
    for rotation in (0.0, 2.0):
        there = np.asarray(turned(jnp.asarray(towards, jnp.float32), rotation))
        view = camera(there, fov=np.radians(2.0))
        environment = around(jnp.zeros((4, 8, 3)), rotation, replace(sun, direction=sun.direction * 3.0))
        seen = np.asarray(jax.jit(lambda c, e: background(c, e, Background(), **size))(view, environment), np.float64)
        pixel = (2 * np.tan(np.radians(1.0)) / 96) ** 2
        np.testing.assert_allclose(seen.sum(axis=(0, 1)) * pixel, [4, 3, 2], rtol=0.02)
        lit = seen[..., 0] > 0
        np.testing.assert_allclose(np.sqrt(lit.sum() * pixel / np.pi), RADIUS, rtol=0.08)
        np.testing.assert_allclose(seen[48, 64], np.array([4, 3, 2]) / (np.pi * RADIUS**2), rtol=1e-5)
        assert not lit[:, :30].any() and not lit[:10].any()


def test_gradients_are_finite_and_reach_texels_rotation_and_suns():
    sun = Directional(direction=jnp.array([[-0.3, -0.2, -1.0]]), irradiance=jnp.array([[4.0, 3.0, 2.0]]))

    def total(environment, view):
        return jnp.sum(jnp.sin(background(view, environment, Background(), **SIZE)))

    slopes = jax.jit(jax.grad(total, (0, 1)))
    for towards in ((0.3, 0.2, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)):
        environment, view = slopes(around(suns=sun), camera(towards))
        assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves((environment, view)))
        assert jnp.abs(environment.map.texels).max() > 0 and jnp.abs(environment.map.rotation) > 0


def test_maps_may_be_batched():
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), around(), around(2.0 * TEXELS, 1.0))
    pictures = jax.jit(jax.vmap(lambda e: background(HERE, e, Background(), **SIZE)))(both)
    for i, one in enumerate((around(), around(2.0 * TEXELS, 1.0))):
        np.testing.assert_allclose(pictures[i], draw(HERE, one, Background()), atol=1e-5)
