"""A camera and lights for models that bring none of their own."""

import math

import numpy as np
from jaxtyping import Float

from ..math.transform import orbit, perspective
from ..scene import Camera, Environment, Lights, Mesh
from ..stack import stack_lights
from .asset import floats

AZIMUTH, ELEVATION, FOV_Y = 0.5, 0.25, math.radians(40)  # rad: a three-quarter view from slightly above
MARGIN = 1.05  # of the sphere's radius, so that it does not touch the picture's edge
KEY = (3.0, 2.85, 2.6)  # lx: warm white
KEY_IN_VIEW = (0.5, -0.7, -0.5)  # from the upper left front
SKY, GROUND = (0.45, 0.5, 0.58), (0.22, 0.2, 0.17)


def frame_camera(mesh: Mesh) -> Camera:
    """A camera that sees a sphere around all triangles whole, in any picture at least as wide as high.

    The sphere's centre is the bounding box's. distance = radius / sin(fov / 2). The near plane lies at a hundredth of
    the distance and the far one nowhere, so that the camera may be moved about the model as it is.
    """
    points = np.asarray(mesh.vertices, np.float64)[np.unique(mesh.faces)]
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = MARGIN * float(np.sqrt(np.max(np.sum((points - center) ** 2, axis=1)))) or 1.0
    # Far from the origin, or next to nothing: keep so large that eye and target differ in float32.
    radius = max(radius, 1e-5 * float(np.abs(center).max()), 1e-30)
    distance = radius / math.sin(0.5 * FOV_Y)
    return Camera(
        world_from_view=orbit(AZIMUTH, ELEVATION, distance, center.astype(np.float32)),
        clip_from_view=perspective(FOV_Y, 0.01 * distance),
    )


def key_light(direction: Float[np.ndarray, "3"]) -> Lights:
    """One warm directional light that travels along `direction`, of any length but 0."""
    return stack_lights(directional=[(direction, KEY)])


def key_direction(camera: Camera) -> Float[np.ndarray, "3"]:
    """The direction of light that comes from the upper left, behind the camera."""
    return np.asarray(camera.world_from_view, np.float64)[:3, :3] @ KEY_IN_VIEW


def sky(strength: float = 1.0) -> Environment:
    """A bluish sky over warm ground; none at strength 0."""
    up = floats((0.0, 1.0, 0.0), 3)
    return Environment(up=up, sky=strength * floats(SKY, 3), ground=strength * floats(GROUND, 3))
