"""What surfaces receive and mirror of an environment map: uniform ones are exact, and none is ever undefined."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from hand_made import surface, towards

from benchmarks.ambient import ACROSS, drawn, shade, ways
from benchmarks.ambient import sphere as ball
from jaxraster.brdf.clearcoat import clearcoat_share
from jaxraster.buffers import Coat
from jaxraster.environment.equirect import directions
from jaxraster.environment.prepare import prepare
from jaxraster.environment.sky import sky
from jaxraster.light import ambient as ambient_file
from jaxraster.light import environment as environment_file
from jaxraster.light.ambient import Ambient
from jaxraster.light.reflection import reflection
from jaxraster.scene import Environment, EnvironmentMap

HEIGHT, BLACK, PLAIN = 64, jnp.zeros(3), Ambient()
ambient = jax.jit(ambient_file.ambient)
received = jax.jit(environment_file.received, static_argnums=2)
mirrored = jax.jit(environment_file.mirrored)
WHITE = {"metal": {"diffuse": 0.0, "f0": 1.0}, "plastic": {"diffuse": 1.0, "f0": 0.04}}


def single(x) -> jax.Array:
    return jnp.asarray(x, jnp.float32)


def around(texels, rotation=0.0) -> Environment:
    """Surroundings of a picture alone."""
    ready = prepare(single(texels), None, rotation)
    return Environment(up=single([0, 1, 0]), sky=BLACK, ground=BLACK, map=ready)


@functools.cache
def uniform() -> Environment:
    return around(np.broadcast_to([1.0, 2.0, 4.0], (HEIGHT, 2 * HEIGHT, 3)))


@functools.cache
def scenery(seed: int = 0) -> Environment:
    """Smooth surroundings with a bright patch."""
    d = np.asarray(directions(HEIGHT, 2 * HEIGHT), np.float64)
    a, b = np.random.default_rng(seed).normal(size=(2, 3, 3))
    wave = 1.2 + np.sin(3 * d @ a)[..., :3]
    return around(wave + 40 * np.exp(20 * ((d @ (b[0] / np.linalg.norm(b[0]))) - 1))[..., None])


def many(count: int = 60, seed: int = 1) -> dict:
    """Normals all around, each seen from somewhere above it, of all roughnesses."""
    rng = np.random.default_rng(seed)
    n, v = rng.normal(size=(2, count, 3))
    n, v = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (n, v))
    v *= np.sign((n * v).sum(axis=1, keepdims=True))
    return {"normal": n, "view": v, "alpha": np.linspace(0, 1, count)}


def seen(here, environment: Environment, settings: Ambient = PLAIN) -> np.ndarray:
    diffuse, specular = ambient(here, environment, settings)
    return np.asarray(diffuse) + np.asarray(specular)


SETTINGS = [Ambient(), Ambient(diffuse="map"), Ambient(specular=False), Ambient(diffuse="map", specular=False)]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda s: f"{s.diffuse}, {s.specular}")
@pytest.mark.parametrize("kind", WHITE)
def test_what_is_white_cannot_be_told_from_uniform_surroundings(kind, settings):
    """Metal or plastic of any roughness, seen from anywhere, with a white coat or without."""
    here = surface(np.zeros((60, 3)), **many(), **WHITE[kind])
    expected = np.broadcast_to([1.0, 2.0, 4.0], (60, 3))
    np.testing.assert_allclose(seen(here, uniform(), settings), expected, rtol=1e-5)
    coat = Coat(weight=jnp.ones(60), alpha=here.alpha[::-1], normal=here.normal)
    np.testing.assert_allclose(seen(replace(here, coat=coat), uniform(), settings), expected, rtol=1e-5)


def test_sheen_takes_from_the_base_what_it_gives():
    """White cloth over white, in uniform surroundings."""
    here = surface(np.zeros((60, 3)), **many(), **WHITE["plastic"])
    here = replace(here, sheen=jnp.concatenate([jnp.full((60, 3), 0.7), here.alpha[:, None]], axis=1))
    np.testing.assert_allclose(seen(here, uniform()), np.broadcast_to([1.0, 2.0, 4.0], (60, 3)), rtol=1e-5)


def test_tones_and_map_add_up():
    here = surface(np.zeros((60, 3)), **many(), diffuse=0.4, f0=0.3)
    tones = Environment(up=single([0, 1, 0]), sky=single([1, 2, 3]), ground=single([0.1, 0.2, 0.3]))
    both = replace(tones, map=scenery().map)
    np.testing.assert_allclose(seen(here, both), seen(here, tones) + seen(here, scenery()), rtol=1e-5)


def test_a_metal_ball_mirrors_what_the_map_holds_there():
    """The specular part over its albedo, that of a white metal being 1, is the map's own about r."""
    here = surface(np.zeros((60, 3)), **many(), **WHITE["metal"])
    expected = mirrored(scenery().map, reflection(here.normal, here.view, here.alpha), here.alpha)
    np.testing.assert_allclose(ambient(here, scenery(), Ambient())[1], expected, rtol=1e-5)
    assert np.std(expected) > 1


def test_a_coat_mirrors_sharply_over_a_rough_base():
    here = surface(np.zeros((60, 3)), **many(), diffuse=0.5, f0=0.04)
    coat = Coat(weight=jnp.full(60, 0.8), alpha=jnp.full(60, 0.01), normal=here.view)
    coated, plain = seen(replace(here, coat=coat), scenery()), seen(here, scenery())
    share = np.asarray(clearcoat_share(jnp.ones(60), coat.weight))[:, None]
    expected = (1 - share) * plain + share * np.asarray(mirrored(scenery().map, here.view, coat.alpha))
    np.testing.assert_allclose(coated, expected, rtol=1e-5)


def test_without_specular_irradiance_stands_in():
    """At roughness 1 the two are the same."""
    here = surface(np.zeros((60, 3)), **{**many(), "alpha": 1.0}, diffuse=0.4, f0=0.3)
    rough = seen(here, scenery(), Ambient(diffuse="map"))
    np.testing.assert_allclose(seen(here, scenery(), Ambient(diffuse="map", specular=False)), rough, rtol=2e-3)


def test_a_map_of_irradiance_follows_what_harmonics_leave_out():
    """One light from +X: nine coefficients are off by up to 3/32 of its irradiance, the map by an eighth of that, where
    the light sets."""
    texels = np.zeros((HEIGHT, 2 * HEIGHT, 3))
    texels[HEIGHT // 2 - 1 : HEIGHT // 2 + 1, HEIGHT - 1 : HEIGHT + 1] = 1.0 / (4 * (np.pi / HEIGHT) ** 2)
    n = towards(np.linspace(0, np.pi, 61))
    x = np.maximum(n[:, :1], 0) / np.pi
    got = {how: np.asarray(received(around(texels).map, single(n), how)) for how in ("harmonics", "map")}
    # Nine coefficients alone would be negative about 122° from the light.
    assert all(light.min() >= 0 for light in got.values())
    errors = {how: np.abs(light - x).max() for how, light in got.items()}
    assert errors["map"] < 3 / 32 / np.pi / 7 and 0.02 < errors["harmonics"] < 3 / 32 / np.pi * 1.05


@pytest.mark.parametrize("how", ["harmonics", "map"])
def test_rotation_turns_the_light_with_the_surroundings(how):
    """By R_y(θ), +X to (cos θ, 0, -sin θ)."""
    n, angle = many()["normal"], 0.7
    c, s = np.cos(angle), np.sin(angle)
    turned = n @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    plain, rotated = scenery().map, replace(scenery().map, rotation=single(angle))
    np.testing.assert_allclose(received(rotated, single(turned), how), received(plain, single(n), how), rtol=1e-4)
    alpha = jnp.full(60, 0.2)
    np.testing.assert_allclose(
        mirrored(rotated, single(turned), alpha), mirrored(plain, single(n), alpha), rtol=1e-3, atol=1e-4
    )


def test_light_is_linear_in_the_map_and_in_the_gain():
    here = surface(np.zeros((60, 3)), **many(), diffuse=0.4, f0=0.3, occlusion=np.linspace(0, 1, 60))
    twice = replace(scenery(), map=prepare(2 * scenery().map.texels))
    np.testing.assert_array_equal(seen(here, twice), 2 * seen(here, scenery()))
    np.testing.assert_array_equal(seen(here, scenery(), Ambient(gain=2.0)), 2 * seen(here, scenery()))


def test_a_batch_of_surroundings_is_lit_one_by_one():
    here = surface(np.zeros((60, 3)), **many(), diffuse=0.4, f0=0.3)
    each = [scenery(seed) for seed in (0, 1)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *each)
    together = jax.jit(jax.vmap(ambient_file.ambient, (None, 0, None)))(here, batch, Ambient())
    for i, one in enumerate(each):
        for got, expected in zip(together, ambient(here, one, Ambient())):
            np.testing.assert_allclose(got[i], expected, rtol=1e-5)


@pytest.mark.parametrize("settings", [Ambient(), Ambient(diffuse="map")], ids=lambda s: s.diffuse)
def test_values_and_gradients_are_finite_everywhere(settings):
    """Mirrors and the roughest, seen edge-on, at the poles and seams of the map, black or with texels of 6e4."""
    axes = np.concatenate([np.eye(3), -np.eye(3), [[0.6, 0.8, 0]]])
    cases = [(n, v, a) for n in axes for v in axes if n @ v >= 0 for a in (0.0, 1e-6, 0.25, 1.0)]
    normal, view, alpha = (single(np.array(column)) for column in zip(*cases))

    def shine(normal, view, alpha, environment: EnvironmentMap):
        here = replace(surface(np.zeros(3), f0=0.5), normal=normal, view=view, alpha=alpha)
        lit = Environment(up=single([0, 1, 0]), sky=BLACK, ground=BLACK, map=environment)
        return jnp.concatenate(ambient_file.ambient(here, lit, settings))

    modes = [jax.vmap(mode(shine, (0, 1, 2)), (0, 0, 0, None)) for mode in (jax.jacrev, jax.jacfwd)]
    both = jax.jit(lambda *a: (jax.vmap(shine, (0, 0, 0, None))(*a), *[mode(*a) for mode in modes]))
    for texels in (np.zeros((HEIGHT, 2 * HEIGHT, 3)), np.asarray(scenery().map.texels) * 6e4):
        value, reverse, forward = both(normal, view, alpha, around(texels).map)
        assert np.isfinite(value).all() and (np.asarray(value) >= 0).all()
        for r, f in zip(reverse, forward):
            assert np.isfinite(r).all() and np.isfinite(f).all()
            np.testing.assert_allclose(r, f, rtol=1e-3, atol=1e-3 * np.abs(f).max(initial=1))


def test_gradients_reach_the_texels_and_the_rotation():
    """Against central differences, of pictures of 4 x 8 texels; linear in texels, so that steps may be long."""
    rng = np.random.default_rng(3)
    # So bright that no blurred picture rings below zero, where it is cut off.
    texels, here = single(rng.uniform(2, 5, (4, 8, 3))), surface(np.zeros((60, 3)), **many(), diffuse=0.4, f0=0.3)
    weights = single(rng.normal(size=(2, 60, 3)))

    def total(texels, rotation):
        lit = Environment(up=single([0, 1, 0]), sky=BLACK, ground=BLACK, map=prepare(texels, None, rotation))
        return sum(jnp.vdot(w, part) for w, part in zip(weights, ambient_file.ambient(here, lit, Ambient())))

    value = jax.jit(total)
    slope, turn = jax.jit(jax.grad(total, (0, 1)))(texels, single(0.3))
    for row, column, channel in ((0, 0, 0), (3, 5, 1), (1, 7, 2), (2, 4, 0)):
        step = jnp.zeros_like(texels).at[row, column, channel].set(1.0)
        expected = 0.5 * (value(texels + step, single(0.3)) - value(texels - step, single(0.3)))
        np.testing.assert_allclose(slope[row, column, channel], expected, rtol=1e-3, atol=1e-4)
    expected = (value(texels, single(0.305)) - value(texels, single(0.295))) / 0.01
    np.testing.assert_allclose(turn, expected, rtol=0.05, atol=0.05)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"diffuse": "sh"}, r"Ambient\.diffuse must be one of harmonics, map, got 'sh'"),
        ({"specular": 1}, r"Ambient\.specular must be True or False, got 1"),
    ],
)
def test_settings_that_mean_nothing_are_refused(settings, message):
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        with pytest.raises(ValueError, match=message):
            Ambient(**settings)
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


def test_a_sun_that_was_not_cut_out_does_not_mirror_as_less_than_darkness():
    texels = np.full((32, 64, 3), 1e-3)
    texels[7, 13] = 1e6
    ready = prepare(single(texels))
    around = directions(HEIGHT, 2 * HEIGHT)
    for alpha in (0.01, 0.05, 0.2, 0.6, 1.0):
        assert mirrored(ready, around, jnp.full(around.shape[:-1], alpha, around.dtype)).min() >= 0


@pytest.mark.parametrize(
    ("metallic", "roughness", "most"),
    [(0.0, 0.3, 0.015), (1.0, 0.1, 0.015), (1.0, 0.5, 0.045), (1.0, 1.0, 0.055)],
)
def test_a_lit_sphere_is_what_random_directions_gather(metallic, roughness, most):
    """Of the whole BRDF, under a clear sky: the root mean square over the mean, of which 1 % is the drawing's noise.

    What stands for the sky is farther off.
    """
    texels, _ = sky((1.0, 1.0, 0.5), height=64, width=128, gain=1e-4)
    surface = ball(ACROSS, metallic, roughness)
    truth = np.asarray(drawn(surface, texels, 4096), np.float64)[surface.mask]
    off = {
        name: np.asarray(shade(surface, *way), np.float64)[surface.mask] - truth for name, way in ways(texels).items()
    }
    found = {name: np.sqrt((of**2).mean()) / truth.mean() for name, of in off.items()}
    one_tone, *alone, default, with_map = found.values()
    assert max(default, with_map) < most
    assert abs(off["harmonics and mirrored picture, the default"].mean()) < 0.01 * truth.mean()
    assert one_tone > 3 * default
    assert metallic == 0 or roughness == 1 or min(alone) > 2 * default
