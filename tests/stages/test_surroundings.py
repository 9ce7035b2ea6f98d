"""Surroundings in whole pictures: what a map adds, what hides it, its suns, and batches of all of these."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import small
from small import HEIGHT, WIDTH

from jaxraster.environment.prepare import prepare
from jaxraster.light.ambient import Ambient
from jaxraster.light.background import Background
from jaxraster.plan import Plan
from jaxraster.render import render
from jaxraster.scene import Directional, EnvironmentMap, Scene
from jaxraster.screen.horizon import HorizonAO

CAMERA = small.camera()
SLANTED = (-0.4, -1.0, -0.3)
MATERIALS = [{"roughness": 0.3}, {"metallic": 1.0, "roughness": 0.1}, {}, {"roughness": 1.0}, {}]
SCENE = small.scene(MATERIALS)
NOTHING = {"texture_slots": (), "light_kinds": ("directional",), "ambient": None, "emission": None, "background": None}
BARE = Plan(width=WIDTH, height=HEIGHT, **NOTHING)
LIT = replace(BARE, ambient=Ambient(), background=Background())
HIDDEN = replace(LIT, occlusion=HorizonAO(radius=1.0, slices=1, steps=4))


@jax.jit
def frame(scene, camera, plan):
    """Light and its paths; what is not returned is not compiled."""
    drawn = render(scene, camera, plan)
    return drawn.hdr, drawn.radiance, drawn.surface.mask


def light(scene: Scene, plan: Plan):
    return frame(scene, CAMERA, plan)[0]


def surrounded(ready: EnvironmentMap, scene: Scene = SCENE) -> Scene:
    return replace(scene, environment=replace(scene.environment, map=ready))


def picture(seed: int) -> jax.Array:
    """Light from all around, smooth enough that an odd pixel does not tell."""
    values = np.random.default_rng(seed).uniform(0.2, 1.0, (4, 8, 3))
    return jnp.asarray(values.repeat(2, axis=0).repeat(2, axis=1), jnp.float32)


def test_a_constant_map_is_a_constant_environment():
    """The same light, by another way: within what the chain and the harmonics round. And both add up."""
    tone, even = jnp.array([0.3, 0.5, 0.7]), prepare(jnp.broadcast_to(jnp.array([0.3, 0.5, 0.7]), (8, 16, 3)))
    toned = replace(SCENE, environment=replace(SCENE.environment, sky=tone, ground=tone))
    by_tone = light(toned, LIT)
    np.testing.assert_allclose(light(surrounded(even), LIT), by_tone, rtol=2e-5, atol=1e-6)
    both = replace(toned, environment=replace(toned.environment, map=even))
    np.testing.assert_allclose(light(both, LIT), 2.0 * by_tone, rtol=2e-5, atol=1e-6)


def test_turning_by_whole_columns_is_rolling():
    """A quarter turn counter-clockwise moves what is along +X to -Z, a quarter of the columns back."""
    turned = light(surrounded(prepare(picture(0), rotation=np.pi / 2)), LIT)
    rolled = light(surrounded(prepare(jnp.roll(picture(0), -4, axis=1))), LIT)
    np.testing.assert_allclose(turned, rolled, rtol=1e-3, atol=1e-4)
    assert np.abs(turned - light(surrounded(prepare(picture(0))), LIT)).max() > 0.05


def test_a_sun_of_the_map_is_a_directional_light():
    sun = Directional(direction=jnp.array([SLANTED]), irradiance=jnp.array([[2.0, 1.5, 1.0]]))
    cut_out = light(surrounded(prepare(jnp.zeros((4, 8, 3)), sun)), BARE)
    own = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), SCENE.lights.directional, sun)
    lamp = light(replace(SCENE, lights=replace(SCENE.lights, directional=own)), BARE)
    assert np.asarray(cut_out).max() > 0
    np.testing.assert_allclose(cut_out, lamp, rtol=1e-6)


def test_occlusion_darkens_ambient_light_alone():
    """The floor before the wall; direct light and the background stay as they are, and nothing near changes nothing."""
    scene = surrounded(prepare(picture(1)), small.scene(MATERIALS, directional=[(SLANTED, 2.0)]))
    (free, open_, mask), (dark, hidden, _) = (frame(scene, CAMERA, plan) for plan in (LIT, HIDDEN))
    for path in ("direct_diffuse", "direct_specular", "emitted"):
        np.testing.assert_allclose(getattr(hidden, path), getattr(open_, path), rtol=1e-5, atol=1e-6)
    for path in ("indirect_diffuse", "indirect_specular"):
        bright, less = (np.asarray(getattr(one, path)).sum(axis=-1) for one in (open_, hidden))
        assert less.sum() < 0.99 * bright.sum() and (less < 0.9 * bright).any(), path
    np.testing.assert_array_equal(dark[~mask], free[~mask])
    nothing_near = replace(HIDDEN, occlusion=replace(HIDDEN.occlusion, radius=0.0))
    np.testing.assert_allclose(light(scene, nothing_near), free, rtol=2e-4, atol=1e-5)


def test_what_hides_the_sky_has_no_gradient_but_the_light_that_arrives_has():
    """Also in texels, through all that is made of them: it is linear but for a clamp far from here."""

    def brightness(texels, radius):
        plan = replace(HIDDEN, occlusion=replace(HIDDEN.occlusion, radius=radius))
        return jnp.mean(render(surrounded(prepare(texels)), CAMERA, plan).hdr)

    texels = picture(2)
    value, (slope, in_radius) = jax.jit(jax.value_and_grad(brightness, argnums=(0, 1)))(texels, jnp.float32(1.0))
    assert in_radius == 0
    assert np.isfinite(slope).all() and (np.abs(slope) > 0).mean() > 0.5
    np.testing.assert_allclose(jnp.vdot(slope, texels), value, rtol=1e-4)


def test_a_batch_of_surroundings_is_the_loop():
    maps = [prepare(picture(seed), rotation=0.3 * seed) for seed in range(2)]
    batch = jax.tree.map(lambda *parts: jnp.stack(parts), *maps)
    mapped = jax.jit(jax.vmap(lambda ready: render(surrounded(ready), CAMERA, HIDDEN).hdr))(batch)
    for drawn, ready in zip(mapped, maps):
        np.testing.assert_allclose(drawn, light(surrounded(ready), HIDDEN), rtol=1e-5, atol=1e-6)
