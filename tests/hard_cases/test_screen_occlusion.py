"""Inputs that break ambient occlusion on the screen: nothing there, planes, borders, odd numbers."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_case import case
from height_fields import FLOOR, SIDE, WALL, camera, cast, seen

from jaxraster.camera import Camera
from jaxraster.screen.denoise import denoise
from jaxraster.screen.height_field import height_field
from jaxraster.screen.horizon import HorizonAO, horizon
from jaxraster.screen.ssao import SSAO, ssao

SIZE = 48
METHODS = {"horizon": (horizon, HorizonAO(radius=0.5, slices=1, steps=2)), "ssao": (ssao, SSAO(radius=0.5))}
FAR = HorizonAO(radius=jnp.inf, falloff=0.0)
ABOVE = camera((2.5, 2.5, 2.5))
ROOM = cast([FLOOR, WALL, SIDE], ABOVE, SIZE)
BOTH = pytest.mark.parametrize("name", METHODS)


def sums(method):
    """The sum of all that a method finds, and its gradient in places, normals and knobs."""

    def total(position, normal, settings, surface, seen_by):
        found = method(replace(surface, position=position, normal=normal), seen_by, settings)
        return jnp.sum(found.visibility) + jnp.sum(found.bent_normal), found

    return jax.jit(jax.value_and_grad(total, (0, 1, 2), has_aux=True))


SUMS = {name: sums(method) for name, (method, _) in METHODS.items()}
HORIZON = jax.jit(horizon)


def finite(name, surface, seen_by=ABOVE, **settings):
    """What the method finds, all finite, as is its gradient."""
    knobs = jax.tree.map(jnp.float32, replace(METHODS[name][1], **settings))
    (_, found), slopes = SUMS[name](surface.position, surface.normal, knobs, surface, seen_by)
    bad = [name for name, leaf in zip(("position", "normal"), slopes) if not np.isfinite(leaf).all()]
    assert bad == [] and all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((found, slopes[2]))), slopes[2]
    return found, slopes


@case("A1", "pixels where there is nothing", "1 there, and the rest as if they were far away")
@BOTH
def test_the_background_is_open_and_casts_no_halo(name):
    origin, direction = (
        np.zeros((SIZE, SIZE, 3)),
        np.dstack([*np.meshgrid(*([np.linspace(-0.3, 0.3, SIZE)] * 2)), -np.ones((SIZE, SIZE))]),
    )
    square = np.abs(direction[..., :2]).max(axis=-1) < 0.2
    card = seen(origin, direction, np.where(square, 2.0, np.inf), np.broadcast_to([0.0, 0.0, 1.0], direction.shape))
    ahead = camera((0, 0, 0), (0, 0, -1), 2 * np.degrees(np.arctan(0.3 * SIZE / (SIZE - 1))))
    found, _ = finite(name, card, ahead)
    np.testing.assert_allclose(found.visibility, 1, atol=1e-4)
    nothing, _ = finite(name, replace(card, mask=jnp.zeros_like(card.mask)), ahead)
    assert (nothing.visibility == 1).all() and (nothing.bent_normal == card.normal).all()


@case("A2", "planes seen at 0 to 85°, from 1e-2 to 1e5 away, in both projections", "open, and the bent normal theirs")
@pytest.mark.parametrize("half_height", [None, 1.0], ids=["perspective", "parallel"])
def test_a_plane_does_not_occlude_itself(half_height):
    for tilt in (0, 30, 60, 80, 85):
        for distance in (1e-2, 1.0, 1e5):
            t = np.radians(tilt)
            eye = np.array([0, np.cos(t), np.sin(t)]) * distance
            lens = None if half_height is None else half_height * distance
            above = camera(eye, half_height=lens, far=10 * distance)
            plane = cast([FLOOR], above, SIZE)
            found = HORIZON(plane, above, FAR)
            np.testing.assert_allclose(found.visibility, 1, atol=2e-3)
            np.testing.assert_allclose(found.bent_normal, plane.normal, atol=2e-3)


@case("A3", "a radius of 0 and one of 1e9, one sample or step", "finite; open where the radius is 0")
@BOTH
def test_any_radius_and_count_is_finite(name):
    found, _ = finite(name, ROOM, radius=0.0)
    np.testing.assert_allclose(found.visibility, 1, atol=1e-6)
    finite(name, ROOM, radius=1e9)
    method, settings = METHODS[name]
    few = {"slices": 1, "steps": 1} if name == "horizon" else {"samples": 1}
    shown = jax.jit(method)(ROOM, ABOVE, replace(settings, **few)).visibility
    assert np.isfinite(shown).all() and shown.min() < 0.95


@case("A4", "normals that are 0, edge-on, or face away", "finite; open where there is no normal")
@BOTH
def test_normals_that_are_none_give_finite_light(name):
    finite(
        name, replace(ROOM, normal=jnp.stack([-ROOM.view[..., 1], ROOM.view[..., 0], 0 * ROOM.view[..., 2]], axis=-1))
    )
    finite(name, replace(ROOM, normal=-ROOM.normal))
    found, _ = finite(name, replace(ROOM, normal=jnp.zeros_like(ROOM.normal)))
    if name == "horizon":
        np.testing.assert_allclose(found.visibility, 1, atol=1e-6)


@case("A5", "the border of a picture, and pictures of one pixel, row or column", "not darker than the middle")
@BOTH
def test_the_border_is_as_bright_as_the_middle(name):
    plane = cast([FLOOR], camera((0, 2, 2)), SIZE)
    shown = np.asarray(finite(name, plane, camera((0, 2, 2)))[0].visibility)
    border = np.ones((SIZE, SIZE), bool)
    border[4:-4, 4:-4] = False
    assert abs(shown[border].mean() - shown[~border].mean()) < 0.01
    method, settings = METHODS[name]
    for height, width in ((1, 1), (1, 5), (6, 1)):
        part = jax.tree.map(lambda leaf, height=height, width=width: leaf[:height, :width], plane)
        np.testing.assert_allclose(
            jax.jit(method)(part, camera((0, 2, 2)), settings).visibility, 1, atol=1e-5 if name == "horizon" else 0.1
        )


@case("A6", "a scene, its camera and the radius 1000 times as large, and as small", "the same to 1e-3")
@BOTH
def test_scale_does_not_matter(name):
    expected, _ = finite(name, ROOM)
    for scale in (1e-3, 1e3):
        pose = ABOVE.world_from_view.at[:3, 3].multiply(scale)
        there = Camera(world_from_view=pose, clip_from_view=ABOVE.clip_from_view.at[2, 3].multiply(scale))
        found, _ = finite(name, replace(ROOM, position=scale * ROOM.position), there, radius=0.5 * scale)
        off = np.abs(found.visibility - expected.visibility)
        assert off.mean() < 1e-4 and (off > 1e-3).mean() <= (0 if name == "horizon" else 1e-3)


@case("A7", "a pixel none of whose neighbours is on its surface", "it keeps its own light")
def test_a_pixel_alone_is_its_own_mean():
    alone = np.indices((SIZE, SIZE)).sum(axis=0) % 3 == 0
    lonely = replace(ROOM, mask=jnp.asarray(alone))
    field = height_field(lonely.mask, lonely.position, lonely.normal, lonely.normal, ABOVE)
    noise = jnp.asarray(np.random.default_rng(0).uniform(size=(SIZE, SIZE)), jnp.float32)
    (kept,) = denoise(field, (noise,))
    np.testing.assert_allclose(np.asarray(kept)[alone], np.asarray(noise)[alone], rtol=1e-6)
    # Where the surface goes on, what repeats every four pixels is gone.
    plane = cast([FLOOR], camera((0, 2, 2)), SIZE)
    field = height_field(plane.mask, plane.position, plane.normal, plane.normal, camera((0, 2, 2)))
    pattern = jnp.tile(noise[:4, :4], (SIZE // 4, SIZE // 4))
    (mean,) = denoise(field, (pattern,))
    np.testing.assert_allclose(np.asarray(mean)[2:-2, 2:-2], np.asarray(pattern)[:4, :4].mean(), rtol=1e-5)
