"""What scenes are put together from: rows of materials and lights, placed meshes, a camera.

All of it runs on the host: building a scene compiles next to nothing.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from ..math.transform import look_at, perspective
from ..scene import (
    TEXTURE_SLOTS,
    Camera,
    Directional,
    Environment,
    Lights,
    Materials,
    Mesh,
    Point,
    Spot,
)

# Reflectance at normal incidence of gold, linear. Source: Lagarde 2011, "Feeding a physically based shading model".
GOLD = (1.0, 0.765557, 0.336057)


def materials(*rows: dict) -> Materials:
    """Rough white dielectrics without textures, but for what each row says."""
    floats = {"metallic": 0.0, "roughness": 1.0, "normal_scale": 1.0, "occlusion_strength": 1.0}
    floats |= {"base_color": (1.0, 1.0, 1.0), "emissive": (0.0, 0.0, 0.0)}

    def column(name, default, dtype):
        return jnp.asarray(np.array([row.get(name, default) for row in rows], dtype))

    columns = {name: column(name, default, np.float32) for name, default in floats.items()}
    columns["base_color"] = jnp.concatenate([columns["base_color"], jnp.ones((len(rows), 1), jnp.float32)], axis=1)
    textures = {f"{slot}_texture": column(f"{slot}_texture", -1, np.int32) for slot in TEXTURE_SLOTS}
    return Materials(**columns, **textures, double_sided=column("double_sided", False, bool))


def lights(directional: Sequence = (), point: Sequence = (), spot: Sequence = ()) -> Lights:
    """Lights from rows in the order of each kind's fields; directions need not be unit."""

    def columns(kind, rows, **sizes):
        values = {}
        for i, (name, size) in enumerate(sizes.items()):
            value = np.array([row[i] for row in rows], np.float64).reshape(-1, *([3] * size))
            if name == "direction":
                value = value / np.linalg.norm(value, axis=1, keepdims=True)
            values[name] = jnp.asarray(value.astype(np.float32))
        return kind(**values)

    return Lights(
        directional=columns(Directional, directional, direction=1, irradiance=1),
        point=columns(Point, point, position=1, intensity=1, range=0),
        spot=columns(Spot, spot, position=1, direction=1, intensity=1, range=0, inner=0, outer=0),
    )


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
