"""World space to clip space.

Gradient: exact in vertices, pose and projection.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..check import fit, fit_record
from ..math.transform import invert_rigid, multiply, transform_points
from ..scene import Camera


def clip_from_world(camera: Camera, *, height: int, width: int) -> Float[Array, "*b 4 4"]:
    """The camera's whole transform for a picture of this shape: x is scaled by height/width."""
    projection = camera.clip_from_view.at[..., 0, :].multiply(height / width)
    return multiply(projection, invert_rigid(camera.world_from_view))


def project(vertices: Float[Array, "*b v 3"], camera: Camera, *, height: int, width: int) -> Float[Array, "*b v 4"]:
    """Clip positions with reversed depth: z in [0, w], w at the near plane. What `rasterize` asks for.

    Example:
        >>> from jaxraster import Camera, look_at, perspective
        >>> camera = Camera(world_from_view=look_at((0, 0, 2), (0, 0, 0)), clip_from_view=perspective(1.5707963, 1.0))
        >>> project(jnp.zeros((1, 3)), camera, height=480, width=640).tolist()
        [[0.0, 0.0, 1.0, 2.0]]
    """
    fit("project: vertices", vertices, Float[Array, "*b v 3"])
    fit_record("project: camera", camera, Camera, batched=True)
    vertices, camera = jax.tree.map(jnp.asarray, (vertices, camera))
    return transform_points(clip_from_world(camera, height=height, width=width), vertices)
