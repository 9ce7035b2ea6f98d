"""Layers: peeling finds every fragment once, front to back, whichever path its triangle takes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import raster as twin

import jaxraster as jr
from jaxraster.visibility import raster

HEIGHT, WIDTH, NUM_FACES, MOST = 37, 50, 40, 41


def scene(seed: int, size: float):
    """Overlapping triangles in front of the camera, some of them exact copies of others."""
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-1.1, 1.1, (NUM_FACES, 1, 2))
    corners = centre + rng.normal(0, size, (NUM_FACES, 3, 2))
    depth = np.broadcast_to(rng.uniform(0.1, 0.9, (NUM_FACES, 1, 1)), (NUM_FACES, 3, 1))
    clip = np.concatenate([corners, depth, np.ones_like(depth)], axis=-1).astype(np.float32)
    clip[1::5] = clip[::5]
    return jnp.asarray(clip.reshape(-1, 4)), jnp.arange(3 * NUM_FACES, dtype=jnp.int32).reshape(-1, 3)


def layers(clip, faces, count):
    """The first so many layers' faces, and the last one."""
    layer = jr.rasterize(clip, faces, height=HEIGHT, width=WIDTH)
    found = [layer]
    for _ in range(count - 1):
        found.append(jr.peel(clip, faces, found[-1]))
    return found


@pytest.mark.parametrize("small", [0, raster.SMALL, 2**20], ids=["large", "mixed", "small"])
@pytest.mark.parametrize("size", [0.12, 0.6])
def test_every_fragment_is_found_once_in_order(small, size, monkeypatch):
    """Depths are constant over each triangle, so that NumPy knows the order: by depth, then by id."""
    monkeypatch.setattr(raster, "SMALL", small)
    clip, faces = scene(3, size)
    points, depth = twin.snapped(np.asarray(clip), HEIGHT, WIDTH)
    cover = np.stack(
        [twin.rasterize(points, depth, np.asarray(faces)[i : i + 1], HEIGHT, WIDTH)[2] for i in range(NUM_FACES)]
    )
    order = np.lexsort((np.arange(NUM_FACES), -np.asarray(depth)[::3]))
    ranked = np.where(cover[order] > 0, np.arange(NUM_FACES)[:, None, None], NUM_FACES)
    ranked = np.append(order, -1)[np.sort(ranked, axis=0)]
    deepest = int((cover.sum(axis=0)).max())
    found = layers(clip, faces, deepest + 1)
    assert deepest > 2
    for expected, layer in zip(ranked, found):
        assert (np.asarray(layer.face) == expected).all()
        assert ((np.asarray(layer.depth) > 0) == (expected >= 0)).all()
    assert (np.asarray(found[-1].face) == -1).all()


def test_layers_through_the_camera_plane_are_found_once():
    """Cut triangles too: no face twice at a pixel, and never a nearer one behind a farther one."""
    rng = np.random.default_rng(0)
    world = jnp.asarray(rng.normal(0, 3, (3 * NUM_FACES, 4)), jnp.float32).at[:, 2].multiply(0.1)
    faces = jnp.arange(3 * NUM_FACES, dtype=jnp.int32).reshape(-1, 3)
    found = layers(world, faces, 8)
    face, near = (np.stack([np.asarray(getattr(layer, name)) for layer in found]) for name in ("face", "nearness"))
    assert (np.diff(near, axis=0) <= 0).all() and (face[2] >= 0).any()
    for i in range(len(found)):
        for j in range(i):
            assert not ((face[i] == face[j]) & (face[i] >= 0)).any()


def test_batches_of_layers_equal_one_by_one():
    clips, faces = jnp.stack([scene(seed, 0.3)[0] for seed in (1, 2)]), scene(1, 0.3)[1]
    first = jr.rasterize(clips, faces, height=HEIGHT, width=WIDTH)
    second = jr.peel(clips, faces, first)
    mapped = jax.jit(jax.vmap(lambda clip, seen: jr.peel(clip, faces, seen)))(clips, first)
    for i in range(2):
        alone = layers(clips[i], faces, 2)[1]
        for batch in (second, mapped):
            assert all((a[i] == b).all() for a, b in zip(jax.tree.leaves(batch), jax.tree.leaves(alone)))


def test_gradients_reach_the_layer_behind():
    clip, faces = scene(1, 0.3)

    def thickness(clip):
        first = jr.rasterize(clip, faces, height=HEIGHT, width=WIDTH)
        second = jr.peel(clip, faces, first)
        return jnp.sum(jnp.where(second.face >= 0, first.depth - second.depth, 0.0))

    gradient = jax.grad(thickness)(clip)
    assert np.isfinite(np.asarray(gradient)).all() and (np.asarray(gradient)[:, 2] != 0).any()
