"""glTF's punctual lights and cameras under their nodes' transforms.

Both look along their node's -Z; scale changes neither a light's strength and range nor a camera's picture.
Source: Khronos Group, "KHR_lights_punctual"; "glTF 2.0 Specification", 2021, section 3.10.
"""

import math

import jax
import numpy as np
from jaxtyping import Array, Float

from ..math.transform import orthographic, perspective
from ..scene import Camera, Lights
from ..stack import stack_lights
from .asset import LARGEST, floats
from .gltf_node import Matrix
from .pointer import Json, fail, member, number, numbers, reference, rows, table

PUNCTUAL = "KHR_lights_punctual"
QUARTER = float(np.float32(math.pi / 2))  # as exporters write it: in float32 π/2 is rounded up


def _unit(node: Json, axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    length = np.linalg.norm(axis)
    if length == 0:
        fail(node, "its world transform leaves no direction to look in; re-export the scene")
    return axis / length


def read_lights(root: Json, placed: list[tuple[Json, Matrix]]) -> Lights | None:
    """The lights of a scene, in the order of its nodes; None if there are none."""
    kinds = rows(table(root, "extensions", PUNCTUAL), "lights")
    found = {"directional": [], "point": [], "spot": []}
    for node, matrix in placed:
        light = reference(table(node, "extensions", PUNCTUAL), "light", kinds)
        if light is None:
            continue
        kind = member(light, "type", str)
        if kind.value not in found:
            fail(kind, f"is {kind.value[:20]!r}, not one of {', '.join(found)}")
        strength = number(light, "intensity", 1.0, 0.0, LARGEST)
        color = tuple(strength * x for x in numbers(light, "color", (1.0, 1.0, 1.0), 0.0, LARGEST))
        reach = number(light, "range", math.inf, 0.0)
        position = tuple(matrix[:3, 3])
        if kind.value == "point":
            found["point"].append((position, color, reach))
            continue
        direction = tuple(_unit(node, -matrix[:3, 2]))
        if kind.value == "directional":
            found["directional"].append((direction, color))
            continue
        cone = table(light, "spot")
        outer = number(cone, "outerConeAngle", math.pi / 4, 0.0, QUARTER)
        inner = number(cone, "innerConeAngle", 0.0, 0.0, outer)
        found["spot"].append((position, direction, color, reach, inner, outer))
    return stack_lights(**found) if any(found.values()) else None


def _rigid(node: Json, matrix: Matrix) -> Matrix:
    """The pose nearest to an affine one: its line of sight and position, upright as far as that allows, unmirrored."""
    back = _unit(node, matrix[:3, 2])
    right = _unit(node, np.cross(matrix[:3, 1], back))
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, matrix[:3, 3]], axis=1)
    return pose


def _perspective(lens: Json) -> Float[Array, "4 4"]:
    fov, near = number(lens, "yfov"), number(lens, "znear")
    far = number(lens, "zfar", math.inf)
    if not (0 < fov < math.pi and 0 < near < far):
        fail(lens, f"needs 0 < yfov < π and 0 < znear < zfar, has {fov:g}, {near:g} and {far:g}")
    return jax.jit(perspective)(fov, near, far)


def _orthographic(lens: Json) -> Float[Array, "4 4"]:
    half, near, far = number(lens, "ymag"), number(lens, "znear"), number(lens, "zfar")
    number(lens, "xmag")
    if not (half != 0 and 0 <= near < far):
        fail(lens, f"needs ymag other than 0 and 0 <= znear < zfar, has {half:g}, {near:g} and {far:g}")
    return jax.jit(orthographic)(abs(half), near, far)


_LENSES = {"perspective": _perspective, "orthographic": _orthographic}


def read_cameras(root: Json, placed: list[tuple[Json, Matrix]]) -> tuple[Camera, ...]:
    """The cameras of a scene, in the order of its nodes; their aspect ratio is left to the picture."""
    kinds, cameras = rows(root, "cameras"), []
    for node, matrix in placed:
        camera = reference(node, "camera", kinds)
        if camera is None:
            continue
        kind = member(camera, "type", str)
        if kind.value not in _LENSES:
            fail(kind, f"is {kind.value[:20]!r}, not one of {', '.join(_LENSES)}")
        pose = floats(_rigid(node, matrix), 4, 4)
        lens = table(camera, kind.value)
        projection = _LENSES[kind.value](lens)
        # Numbers that differ in double precision may not in float32.
        scales = (projection[0, 0], projection[1, 1], projection[2, 3])
        if not np.isfinite(projection).all() or not min(scales) > 0:
            fail(lens, "its numbers leave no picture in float32; export the camera again")
        cameras.append(Camera(world_from_view=pose, clip_from_view=projection))
    return tuple(cameras)
