"""A grid of balls, metallic against roughness."""

import numpy as np

from ..geometry import shapes
from ..scene import Camera, Scene
from ..stack import pack_textures, stack_lights, stack_materials
from .parts import GOLD, at, camera, environment


def material_grid(columns: int = 7, rows: int = 5) -> tuple[Scene, Camera]:
    """Balls of one colour before a grey wall: metallic from 0 on top to 1, roughness from 0 at the left to 1."""
    metallic, roughness = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    balls = [{"base_color": GOLD, "metallic": m, "roughness": r} for m, r in zip(metallic.flat, roughness.flat)]
    ball = shapes.uv_sphere(0.42, 48, 24)
    parts = [
        at(ball, i % columns - 0.5 * (columns - 1), 0.5 * (rows - 1) - i // columns, 0.0, i)
        for i in range(rows * columns)
    ]
    wall = at(shapes.plane(4.0 * columns, 4.0 * rows), 0.0, 0.0, -0.5, rows * columns, pitch=90.0)
    lamps = stack_lights(
        directional=[((-0.35, -0.5, -0.8), (1.7, 1.66, 1.6))],
        point=[((-0.5 * columns, 0.5 * rows, 3.0), (7.0, 7.5, 9.0), np.inf)],
    )
    scene = Scene(
        mesh=shapes.merge([*parts, wall]),
        materials=stack_materials([*balls, {"base_color": (0.32, 0.32, 0.33)}]),
        textures=pack_textures([]),
        lights=lamps,
        environment=environment((0.62, 0.63, 0.65), (0.24, 0.22, 0.20)),
    )
    # Step back until rows and columns fit into a picture of 4:3.
    half_height = 0.5 * max(rows, 0.75 * columns) + 0.2
    return scene, camera((0.0, 0.0, half_height / np.tan(np.radians(12.0))), (0.0, 0.0, 0.0), 24.0)
