"""Visibility without the rasterizer: faces by the double-precision twin, which compiles nothing."""

import jax
import jax.numpy as jnp
import numpy as np
from reference import raster

from jaxraster.buffers import Stats, Visibility
from jaxraster.visibility.barycentric import barycentric


def faces_seen(clip, faces, *, height: int, width: int) -> jax.Array:
    """Which face each pixel sees, -1 for none."""
    clip, faces = np.asarray(clip), np.asarray(faces)
    whole = np.flatnonzero(np.isfinite(clip[faces]).all(axis=(1, 2)))
    owner, _, _ = raster.cast(clip, faces[whole], height, width)
    return jnp.asarray(np.append(whole, -1)[owner].astype(np.int32))


def visible(clip, faces, face) -> Visibility:
    """The differentiable half of visibility, for given faces."""
    beta, depth = barycentric(clip, faces, face)
    stats = Stats(non_finite=jnp.int32(0), degenerate=jnp.int32(0), out_of_range=jnp.int32(0))
    nearness = jax.lax.bitcast_convert_type(depth.astype(jnp.float32), jnp.int32)
    return Visibility(face=face, barycentric=beta, depth=depth, nearness=nearness, stats=stats)
