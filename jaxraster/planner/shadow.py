"""Which lights need a shadow map, how fine it must be, and whether cascades pay.

A light needs one if something may stand between it and a surface in view; the answer errs towards "yes". A map is as
fine as the pixels are: a quarter of the picture may have texels larger than its pixels. Where one map of the whole
scene would have to be finer than is sensible, cascades share what is in view.

Gradient: none, plain NumPy in double precision.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ..light.shadow_map import ShadowMap
from ..scene import Camera
from ..visibility.project import clip_from_world
from .occluders import MAX_PAIRS, RELATIVE_REACH, lamp_may_shadow, may_shadow, visible_polygons

KINDS = ("directional", "point", "spot")
COARSEST, FINEST = 256, 2048  # sides of maps: below nothing is gained, above a map costs more than all the rest
MOST_CASCADES = 4  # the farthest of which has pixels enough of its own
SAMPLED = 2048  # surfaces in view that are asked how large their pixels are
SHARE = 0.25  # of the picture, by area, that may have pixels smaller than a texel


class Light(NamedTuple):
    """A light that shines: its kind, its row, and where from, in each member of a batch."""

    kind: str
    row: int
    places: np.ndarray  # directions or positions `[n, 3]`
    tangent: float  # of a lamp's half angle; 1 for a side of a cube


class View(NamedTuple):
    """What one camera of a batch sees of one member's mesh."""

    triangles: np.ndarray
    faces: np.ndarray  # their numbers in the mesh
    receivers: list
    culled: np.ndarray  # of each triangle, whether its back is not drawn
    eye: np.ndarray  # a place and 1, or the direction back to a camera without perspective and 0
    size: float
    places: np.ndarray  # `[n, 3]` of some of the receivers,
    pixels: np.ndarray  # how large a pixel is there, in metres,
    weights: np.ndarray  # and how many there are


def members(batch: np.ndarray, axes: int) -> np.ndarray:
    """The arrays `[n, ...]` of a batch with any leading axes, or none; each has so many axes itself."""
    lead = batch.ndim - axes
    return batch.reshape(math.prod(batch.shape[:lead]), *batch.shape[lead:])


def _view(corners, faces, culled, pose, matrix, lens, *, height: int) -> View:
    triangles = corners[faces].astype(np.float64)
    finite = np.isfinite(triangles).all(axis=(1, 2))
    triangles, culled = triangles[finite], culled[finite]
    fitted = triangles.reshape(-1, 3)
    size = float(np.linalg.norm(np.ptp(fitted, axis=0))) if len(fitted) else 0.0
    receivers = visible_polygons(triangles, matrix)
    some = receivers[:: max(1, -(-len(receivers) // SAMPLED))]
    places = np.array([polygon.mean(axis=0) for _, polygon in some]).reshape(-1, 3)
    w = np.maximum(places @ matrix[3, :3] + matrix[3, 3], 1e-30)  # a place in view has a w above 0
    pixels = w * 2.0 / (height * abs(float(lens[1, 1])))
    areas = [np.linalg.norm(np.cross(*(polygon[1:3] - polygon[0]))) for _, polygon in some]
    eye = np.append(pose[:3, 3], 1.0) if lens[3, 2] != 0 else np.append(pose[:3, 2], 0.0)
    return View(
        triangles, np.flatnonzero(finite), receivers, culled, eye, size, places, pixels, np.array(areas) / pixels**2
    )


def views(vertices: np.ndarray, faces: np.ndarray, culled: np.ndarray, camera: Camera, size: dict) -> list[View]:
    """What each camera sees of each mesh of a batch; of some faces the back is `culled`."""
    matrices = np.asarray(clip_from_world(camera, **size), np.float64)
    parts = (camera.world_from_view, matrices, camera.clip_from_view)
    cameras = list(zip(*(members(np.broadcast_to(part, matrices.shape), 2) for part in parts)))
    height, meshes = size["height"], members(vertices, 2)
    return [_view(mesh, faces, culled, *one, height=height) for mesh in meshes for one in cameras]


def _quantile(values: np.ndarray, weights: np.ndarray) -> float:
    """The value that all but SHARE of the weights lie below."""
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, (1.0 - SHARE) * below[-1])]) if len(order) and below[-1] else 0.0


def _needed(light: Light, view: View) -> float:
    """Texels on a side at which a map's are as large as most pixels."""
    if light.kind != "directional":
        away = [np.linalg.norm(view.places - place, axis=1) for place in light.places]
        sides = 2.0 if light.kind == "point" else 1.0
        return max(2.0 * light.tangent * sides * _quantile(far / view.pixels, view.weights) for far in away)
    # The box around the scene is never wider, seen from anywhere, than its diagonal.
    return _quantile(view.size / view.pixels, view.weights)


def _verdict(light: Light, seen: list[View], pairs: int, reach: float) -> bool | None:
    """Whether the light may be kept from a surface in any view; None for unknown."""
    test = may_shadow if light.kind == "directional" else lamp_may_shadow
    verdicts = {test(v.triangles, v.receivers, place, v.size, reach, pairs) for v in seen for place in light.places}
    return True if True in verdicts else (None if None in verdicts else False)


def _settings(lights: list[Light], seen: list[View]) -> dict[str, Any]:
    """Resolution and cascades that most pixels call for."""
    needed = [max((_needed(light, view) for view in seen), default=0.0) for light in lights]
    resolution = 2 ** math.ceil(math.log2(min(max(*needed, COARSEST), FINEST)))
    sun = max((need for light, need in zip(lights, needed) if light.kind == "directional"), default=0.0)
    cascades = min(MOST_CASCADES, 1 + math.ceil(math.log2(sun / FINEST))) if sun > 2 * FINEST else 0
    return {"resolution": resolution // 2 if cascades else resolution, "cascades": cascades}


def _named(lights: list[Light]) -> str:
    return ", ".join(f"{light.kind} light {light.row}" for light in lights)


def plan_shadows(lights: list[Light], seen: list[View], moves: bool) -> tuple[ShadowMap | None, str]:
    """The map that the lights that shine need, or None, and why."""
    settings: dict[str, Any] = {} if moves else _settings(lights, seen)
    if moves:
        needy, unknown = lights, []
        why = [f"what is differentiated may move something between a surface in view and {_named(lights)}"]
    else:
        reach = max(4.0 / settings["resolution"], RELATIVE_REACH)
        pairs = max(1, MAX_PAIRS // len(lights))
        verdicts = [_verdict(light, seen, pairs, reach) for light in lights]
        needy = [light for light, verdict in zip(lights, verdicts) if verdict]
        unknown = [light for light, verdict in zip(lights, verdicts) if verdict is None]
        why = [f"something stands between a surface in view and {_named(needy)}"] if needy else []
        why += [f"too many faces to prove that none is shadowed from {_named(unknown)}"] if unknown else []
    if not why:
        return None, "nothing stands between any light and any surface in view"
    rows: dict[str, Any] = {
        kind: tuple(sorted(light.row for light in needy + unknown if light.kind == kind)) for kind in KINDS
    }
    words = f"{settings['cascades']} cascades of " if settings.get("cascades") else ""
    why += [f"{words}{settings['resolution']} texels, as most pixels ask for"] if settings else []
    return ShadowMap(**rows, **settings), "; ".join(why)
