"""The demo: a chair and two balls in the corner of a room."""

import numpy as np

from ..geometry import shapes
from ..scene import Camera, Mesh, Scene
from ..stack import pack_textures, stack_lights, stack_materials
from .parts import GOLD, at, camera, environment, tiled
from .patterns import planks, weave


def _chair(wood: int, fabric: int) -> Mesh:
    """A chair 0.86 m high that faces +Z: tapered splayed legs, a cushion, two posts and a back."""
    r, h = 0.023, 0.43
    profile = np.array([(0.0, h), (r, h), (r, h), (0.6 * r, 0.0), (0.6 * r, 0.0), (0.0, 0.0)])
    leg = shapes.lathe(
        profile, np.array([(0.0, 1.0), (0.0, 1.0), (h, 0.4 * r), (h, 0.4 * r), (0.0, -1.0), (0.0, -1.0)]), 24
    )
    parts = [at(leg, x * 0.205, 0.0, z * 0.195, wood, roll=x * 6.0, pitch=-z * 6.0) for x in (-1, 1) for z in (-1, 1)]
    parts.append(at(shapes.box((0.46, 0.035, 0.44), 0.014), 0.0, 0.435, 0.0, wood))
    parts.append(at(tiled(shapes.box((0.43, 0.055, 0.41), 0.025), 2.0, 2.0), 0.0, 0.475, 0.005, fabric))
    for x in (-0.18, 0.18):
        parts.append(at(shapes.box((0.034, 0.46, 0.026), 0.010), x, 0.655, -0.235, wood, pitch=-9.0))
    parts.append(at(shapes.box((0.46, 0.19, 0.024), 0.011), 0.0, 0.775, -0.236, wood, pitch=-9.0))
    return shapes.merge(parts)


def stage() -> tuple[Scene, Camera]:
    """A chair, a gold ball and a plastic ball on planks, between a red and a white wall, in window light.

    Exercises shadows on all sides, a metal and dielectrics, texture (planks), normal map (weave) and ambient light.
    """
    floor, white, red, wood, fabric, gold, plastic = range(7)
    matter = stack_materials(
        [
            {"base_color_texture": 0, "roughness": 0.45},
            {"base_color": (0.76, 0.74, 0.70), "roughness": 0.9},
            {"base_color": (0.45, 0.04, 0.03), "roughness": 0.8},
            {"base_color": (0.30, 0.13, 0.055), "roughness": 0.4},
            {"base_color": (0.50, 0.46, 0.38), "roughness": 0.9, "normal_texture": 1},
            {"base_color": GOLD, "metallic": 1.0, "roughness": 0.3},
            {"base_color": (0.02, 0.17, 0.36), "roughness": 0.12},
        ]
    )
    mesh = shapes.merge(
        [
            at(tiled(shapes.plane(2.4, 3.6), 2.0, 3.0), 0.7, 0.0, 0.4, floor, yaw=90.0),
            at(shapes.box((0.1, 1.8, 2.4)), -1.05, 0.9, 0.4, red),
            at(shapes.box((3.6, 1.8, 0.1)), 0.7, 0.9, -0.80, white),
            at(shapes.box((3.5, 0.09, 0.02)), 0.75, 0.045, -0.74, white),
            at(shapes.box((0.02, 0.09, 2.35)), -0.99, 0.045, 0.425, white),
            at(_chair(wood, fabric), 0.0, 0.0, 0.0, None, yaw=-15.0),
            at(shapes.uv_sphere(0.17, 64, 32), 0.52, 0.17, 0.30, gold),
            at(shapes.uv_sphere(0.10, 64, 32), -0.36, 0.10, 0.52, plastic),
        ]
    )
    scene = Scene(
        mesh=mesh,
        materials=matter,
        textures=pack_textures([planks(), weave()]),
        lights=stack_lights(directional=[((-0.78, -0.52, -0.50), (3.4, 3.2, 2.9))]),
        environment=environment((0.60, 0.56, 0.50), (0.28, 0.20, 0.13)),
    )
    return scene, camera((1.05, 1.0, 2.45), (-0.02, 0.40, 0.0), 32.0)
