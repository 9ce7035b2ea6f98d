"""The depth that decides: what the rasterizer compares is the plane's depth to a few roundings, small triangles too."""

import jax.numpy as jnp
import numpy as np

from jaxraster.visibility.fixed_point import difference_of_products, sign, to_float
from jaxraster.visibility.raster import rasterize, rasterize_depth

SIZE = 64


def layer(cells, offset=0.0):
    """A sheet of small triangles over the whole picture, tilted both ways."""
    ticks = np.linspace(-1.1, 1.1, cells + 1)
    x, y = (v.reshape(-1) for v in np.meshgrid(ticks, ticks))
    clip = np.stack([x, y, 0.5 + 0.1 * x - 0.05 * y - offset, np.ones_like(x)], axis=-1)
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    faces = np.concatenate([np.stack([i, i + 1, i + cells + 2], 1), np.stack([i, i + cells + 2, i + cells + 1], 1)])
    return clip.astype(np.float32), faces.astype(np.int32)


def test_limbs_become_floats_without_cancelling():
    rng = np.random.default_rng(0)
    a, b, c, d = (
        np.round(rng.uniform(-1, 1, 5000) * 2.0 ** rng.uniform(0, 24, 5000)).astype(np.int64) for _ in range(4)
    )
    # Products that nearly cancel leave small differences of either sign.
    c[::2], d[::2] = a[::2], b[::2] + rng.integers(-3, 4, 2500)
    exact = a * b - c * d
    limbs = difference_of_products(*(jnp.asarray(v.astype(np.int32)) for v in (a, b, c, d)))
    value = np.asarray(to_float(limbs), np.float64)
    assert (np.abs(value - exact) <= np.abs(exact) * 2.0**-22).all()
    assert (np.asarray(sign(limbs)) == np.sign(exact)).all()
    assert (exact < 0).mean() > 0.3 and (np.abs(exact) < 2**20).mean() > 0.1


def test_small_triangles_keep_the_depth_of_their_plane():
    clip, faces = layer(100)
    depth = np.asarray(rasterize_depth(jnp.array(clip), jnp.array(faces), height=SIZE, width=SIZE), np.float64)
    x = (np.arange(SIZE) + 0.5) * 2 / SIZE - 1
    plane = 0.5 + 0.1 * x[None, :] + 0.05 * x[:, None]
    # Snapping moves a corner by 1/512 px, that is the plane by 0.15 · 2/64 · 1/512.
    assert np.abs(depth - plane).max() < 1.2e-5


def test_the_nearer_of_two_close_sheets_is_seen():
    clip, faces = layer(100)
    behind, _ = layer(100, offset=4e-5)
    both = jnp.concatenate([jnp.array(behind), jnp.array(clip)])
    face = rasterize(both, jnp.concatenate([faces, faces + len(clip)]), height=SIZE, width=SIZE).face
    assert (np.asarray(face) >= len(faces)).all()
