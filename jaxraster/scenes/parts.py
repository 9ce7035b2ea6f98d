"""What scenes are put together from: placed meshes, an environment, a camera.

All of it runs on the host: building a scene compiles next to nothing.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from ..math.transform import look_at, perspective
from ..scene import Camera, Environment, Mesh

# Reflectance at normal incidence of gold, linear. Source: Lagarde 2011, "Feeding a physically based shading model".
GOLD = (1.0, 0.765557, 0.336057)


def environment(sky: Sequence[float], ground: Sequence[float]) -> Environment:
    """Two tones, above and below."""
    up, above, below = (jnp.asarray(tone, jnp.float32) for tone in ((0.0, 1.0, 0.0), sky, ground))
    return Environment(up=up, sky=above, ground=below)


def at(mesh: Mesh, x: float, y: float, z: float, material: int | None, *, yaw=0.0, pitch=0.0, roll=0.0) -> Mesh:
    """The mesh rolled about Z, pitched about X, turned about Y (degrees), and moved.

    On the host, unlike `shapes.place`, which would compile once for each shape's size.
    """
    rotation = np.eye(3)
    for degrees, (i, j) in ((roll, (0, 1)), (pitch, (1, 2)), (yaw, (2, 0))):
        turn = np.eye(3)
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
        rotation = turn @ rotation
    tangents = np.asarray(mesh.tangents)
    tangents = np.concatenate([tangents[:, :3] @ rotation.T, tangents[:, 3:]], axis=1)
    return replace(
        mesh,
        vertices=jnp.asarray(np.asarray(mesh.vertices) @ rotation.T + [x, y, z], jnp.float32),
        normals=jnp.asarray(np.asarray(mesh.normals) @ rotation.T, jnp.float32),
        tangents=jnp.asarray(tangents, jnp.float32),
        material=mesh.material if material is None else jnp.asarray(np.full(mesh.material.shape, material, np.int32)),
    )


def tiled(mesh: Mesh, u: float, v: float) -> Mesh:
    """The mesh with its image repeated so often along either axis."""
    return replace(mesh, uvs=jnp.asarray(np.asarray(mesh.uvs) * np.array([[u, v]], np.float32)))


def camera(eye: Sequence[float], target: Sequence[float], fov_y: float) -> Camera:
    """A camera at `eye` that looks at `target`, `fov_y` in degrees."""
    view = jax.jit(look_at)(jnp.asarray(eye, jnp.float32), jnp.asarray(target, jnp.float32))
    return Camera(world_from_view=view, clip_from_view=jax.jit(perspective)(np.radians(fov_y)))
