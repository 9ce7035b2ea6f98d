"""Clear coats and sheen over a material: energy, what they leave of it, and the picture."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small import camera, scene

import jaxraster as jr
from jaxraster.brdf.gltf import gltf
from jaxraster.brdf.standard import standard
from jaxraster.buffers import Coat, Surface
from jaxraster.light.ambient import Ambient, ambient
from jaxraster.light.emission import Emission, emission
from jaxraster.scene import Environment

BRDFS = {"standard": jax.jit(standard), "gltf": jax.jit(gltf)}
SIDE = 96
ANGLES = np.array([0.02, 0.1, 0.3, 0.6, 1.0])  # n·v


def surfaces(n_dot_v, *, diffuse=0.5, f0=0.04, alpha=0.25, coat=None, sheen=None) -> Surface:
    """A surface seen at each of the cosines, with a coat (weight, alpha) and sheen (red, green, blue, alpha)."""
    n_dot_v = jnp.asarray(n_dot_v, jnp.float32)
    view = jnp.stack([jnp.sqrt(1 - n_dot_v**2), jnp.zeros_like(n_dot_v), n_dot_v], axis=-1)
    one, normal = jnp.ones_like(n_dot_v), jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), view.shape)
    return Surface(
        mask=one > 0,
        position=jnp.zeros_like(view),
        normal=normal,
        geometric_normal=normal,
        view=view,
        uv=jnp.zeros((*one.shape, 2)),
        diffuse_color=diffuse * jnp.ones_like(view),
        f0=f0 * jnp.ones_like(view),
        f90=one,
        alpha=alpha * one,
        emissive=jnp.ones_like(view),
        occlusion=one,
        coat=None if coat is None else Coat(weight=coat[0] * one, alpha=coat[1] * one, normal=normal),
        sheen=None if sheen is None else jnp.broadcast_to(jnp.array(sheen, jnp.float32), (*one.shape, 4)),
    )


def hemisphere() -> jax.Array:
    """Directions whose mean, of f times n·l times π over n·l, is the albedo: cosine-weighted midpoints."""
    u, v = (np.mgrid[:SIDE, :SIDE].reshape(2, -1) + 0.5) / SIDE
    r, phi = np.sqrt(u), 2 * np.pi * v
    return jnp.asarray(np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u)], axis=-1), jnp.float32)


def albedo(brdf, **options) -> np.ndarray:
    """What is returned of uniform light at each of the angles."""
    l = hemisphere()
    at = jax.tree.map(lambda x: jnp.repeat(x, len(l), axis=0), surfaces(ANGLES, **options))
    every = jnp.tile(l, (len(ANGLES), 1))
    returned = sum(brdf(at, every)) * (np.pi / every[:, 2:])
    return np.asarray(returned.reshape(len(ANGLES), -1, 3).mean(axis=1, dtype=jnp.float32))


@pytest.mark.parametrize("name", BRDFS)
def test_what_is_not_there_changes_no_bit(name):
    l = hemisphere()[::101]
    bare = surfaces(np.full(len(l), 0.4))
    over = surfaces(np.full(len(l), 0.4), coat=(0.0, 0.01), sheen=(0.0, 0.0, 0.0, 0.3))
    for one, other in zip(BRDFS[name](bare, l), BRDFS[name](over, l)):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("diffuse", [0.0, 1.0])
def test_a_coat_returns_its_share_and_takes_no_more_from_the_base(diffuse):
    """Of black, the share mirrored: less what its single bounce loses; of white, all."""
    bare = albedo(BRDFS["standard"], diffuse=diffuse)
    coated = albedo(BRDFS["standard"], diffuse=diffuse, coat=(1.0, 0.25))
    share = (0.04 + 0.96 * (1 - ANGLES) ** 5)[:, None]
    returned = coated - (1 - share) * bare
    assert np.all(returned <= share * 1.01) and np.all(returned >= 0.5 * share)
    assert np.all(coated <= 1.005)


@pytest.mark.parametrize("sheen", [(1.0, 1.0, 1.0, 1.0), (0.9, 0.2, 0.1, 0.25)])
def test_sheen_takes_from_the_base_what_it_returns(sheen):
    """White light on white cloth does not grow, but for the tenth that the published scaling lets through."""
    assert np.all(albedo(BRDFS["standard"], diffuse=1.0, sheen=sheen)[1:] <= 1.1)
    black = albedo(BRDFS["standard"], diffuse=0.0, f0=0.0, sheen=sheen)[:, 0]
    assert np.all(np.diff(black) < 0) and black[0] > 4 * black[-1]  # brighter towards grazing angles


@pytest.mark.parametrize("options", [{"coat": (1.0, 0.04)}, {"sheen": (1.0, 1.0, 1.0, 0.5)}, {"coat": (0.5, 0.2)}])
def test_white_in_uniform_surroundings_stays_white(options):
    tone = Environment(up=jnp.array([0.0, 0.0, 1.0]), sky=jnp.full(3, 0.7), ground=jnp.full(3, 0.7))
    light = sum(ambient(surfaces(ANGLES, diffuse=1.0, **options), tone, Ambient()))
    np.testing.assert_allclose(light, 0.7, rtol=2e-6)


def test_a_coat_keeps_its_share_of_what_glows_below():
    glow = emission(surfaces(ANGLES, coat=(1.0, 0.1)), Emission())
    np.testing.assert_allclose(glow[:, 0], 1 - (0.04 + 0.96 * (1 - ANGLES) ** 5), rtol=1e-5)


@pytest.mark.parametrize("options", [{"coat": (1.0, 0.002)}, {"sheen": (1.0, 0.5, 0.2, 0.0)}])
@pytest.mark.parametrize("place", [0.0, 1e-6, 1.0])
def test_gradients_are_finite_at_grazing_angles_and_head_on(options, place):
    l = jnp.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [-0.6, 0.0, 0.8]])

    at = surfaces(np.full(4, place), **options)
    moved = {name: getattr(at, name) for name in ("view", "normal", "alpha", "coat", "sheen")}

    def total(moved, l):
        return sum(jnp.sum(part) for part in standard(replace(at, **moved), l))

    for gradient in jax.tree.leaves(jax.grad(total, argnums=(0, 1))(moved, l)):
        assert np.all(np.isfinite(gradient))


def test_a_coated_picture_has_a_second_highlight():
    """Red and rough below, a colourless highlight on top; weight 0 is the picture without a coat."""

    def picture(coat):
        row = {"base_color": (0.8, 0.05, 0.05, 1.0), "metallic": 0.0, "roughness": 0.9} | coat
        world = scene(rows=(row,) * 5, directional=[((1.0, -2.0, 3.0), 3.0)], sky=0.2, ground=0.1)
        plan = jr.Plan(width=48, height=36, light_kinds=("directional",), texture_slots=())
        return np.asarray(jax.jit(jr.render)(world, camera(), plan).hdr)

    bare, coated = picture({}), picture({"clearcoat": (1.0, 0.1)})
    np.testing.assert_array_equal(bare, picture({"clearcoat": (0.0, 0.1)}))
    # The floor mirrors this light into the camera.
    brightest = np.unravel_index((coated - bare)[..., 2].argmax(), coated.shape[:2])
    assert coated[brightest][2] > 3 * bare[..., 2].max() and coated[brightest][2] > 0.7 * coated[brightest][0]
