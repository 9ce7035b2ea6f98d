"""A small scene, and `render` with its stages compiled one by one, for tests that draw many pictures.

Scenes of `scene()` differ in their numbers alone, and pictures with two plans share the stages that these have in
common, so that a hundred pictures cost little more than a handful of compilations.
"""

import importlib
import inspect
import types

import jax
import numpy as np

from jaxraster.geometry import shapes
from jaxraster.scene import Camera, Scene
from jaxraster.scenes import parts
from jaxraster.stack import pack_textures, stack_lights, stack_materials
from jaxraster.visibility import raster

WIDTH, HEIGHT = 24, 16
FLOOR, WALL, CARD, BOX, UNUSED = range(5)
AWAY = (0.0, 0.0, 50.0)  # behind the camera of `camera()`
PLACES = {FLOOR: (0.0, 0.0, 0.0), WALL: (0.0, 2.0, -2.0), CARD: (1.5, 0.6, 0.5), BOX: (-0.6, 0.7, 0.0)}
_rng = np.random.default_rng(3)
COLOURS = _rng.uniform(0.1, 1.0, (8, 8, 4)).astype(np.float32)
SLOPES = np.concatenate([_rng.uniform(0.3, 0.7, (4, 2, 2)), np.ones((4, 2, 2))], axis=-1).astype(np.float32)
COLOUR_TEXTURE, NORMAL_TEXTURE = 0, 1


def scene(rows=({},) * 5, places=None, directional=(), point=(), spot=(), sky=0.0, ground=0.0) -> Scene:
    """A floor, a wall behind it, a card that faces the front right, and a box, each in its row; row 4 is unused.

    Lights are (direction, strength), (position, strength) and (position, direction, strength); each kind counts two,
    black ones where fewer are given.
    """
    places = {**PLACES, **(places or {})}
    mesh = shapes.merge(
        [
            parts.at(shapes.plane(4.0, 4.0), *places[FLOOR], FLOOR),
            parts.at(shapes.plane(4.0, 4.0), *places[WALL], WALL, pitch=90.0),
            parts.at(shapes.plane(0.8, 0.8), *places[CARD], CARD, roll=-90.0, yaw=-60.0),
            parts.at(shapes.box((0.7, 0.7, 0.7)), *places[BOX], BOX, yaw=30.0),
        ]
    )
    tint, aim = np.array([1.0, 0.9, 0.8]), (0.0, -1.0, 0.0)
    directional = [*directional, *[(aim, 0.0)] * 2][:2]
    point = [*point, *[((0.0, 3.0, 0.0), 0.0)] * 2][:2]
    spot = [*spot, *[((0.0, 3.0, 0.0), aim, 0.0)] * 2][:2]
    return Scene(
        mesh=mesh,
        materials=stack_materials([{"roughness": 0.6, "base_color": (0.7, 0.5, 0.4), **row} for row in rows]),
        textures=pack_textures([COLOURS, SLOPES]),
        lights=stack_lights(
            directional=[(d, strength * tint) for d, strength in directional],
            point=[(p, strength * tint, np.inf) for p, strength in point],
            spot=[(p, d, strength * tint, 9.0, 0.3, 0.8) for p, d, strength in spot],
        ),
        environment=parts.environment(list(sky * tint), list(ground * tint)),
    )


def camera(eye=(1.0, 2.0, 4.0), target=(0.0, 0.8, 0.0), fov_y=45.0) -> Camera:
    """A camera before the wall, above the floor."""
    return parts.camera(eye, target, fov_y)


_module = importlib.import_module("jaxraster.render")
_STAGES = {
    "project": ("height", "width"),
    "gather": (),
    "material": ("slots", "layered"),
    "layered": ("slots",),
    "ambient": (),
    "emission": (),
    "background": ("height", "width"),
    "resolve": ("supersample",),
    "exposure": (),
    "tonemap": ("name",),
    "srgb_encode": (),
    "dither": (),
}
_compiled = {name: jax.jit(getattr(_module, name), static_argnames=static) for name, static in _STAGES.items()}


def _with(function, **changes):
    """A function that finds other functions under some of the names it looks up in its module."""
    plain = inspect.unwrap(function)
    changed = types.FunctionType(plain.__code__, {**plain.__globals__, **changes}, plain.__name__)
    changed.__kwdefaults__ = plain.__kwdefaults__
    return changed


_rasterize = _with(_module.rasterize, barycentric=jax.jit(raster.barycentric))
render = _with(_module.render, **_compiled, rasterize=_rasterize)
