"""The measured Cornell box."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from ..scene import Camera, Mesh, Scene
from ..stack import pack_textures, stack_lights, stack_materials
from .parts import camera, environment

# The measured box, in its own units (mm): quads counter-clockwise from inside, blocks by their top corners seen from
# above. Source: Cornell University Program of Computer Graphics, "Cornell Box Data".
_FLOOR = ((552.8, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 559.2), (549.6, 0.0, 559.2))
_CEILING = ((556.0, 548.8, 0.0), (556.0, 548.8, 559.2), (0.0, 548.8, 559.2), (0.0, 548.8, 0.0))
_BACK = ((549.6, 0.0, 559.2), (0.0, 0.0, 559.2), (0.0, 548.8, 559.2), (556.0, 548.8, 559.2))
_GREEN_WALL = ((0.0, 0.0, 559.2), (0.0, 0.0, 0.0), (0.0, 548.8, 0.0), (0.0, 548.8, 559.2))
_RED_WALL = ((552.8, 0.0, 0.0), (549.6, 0.0, 559.2), (556.0, 548.8, 559.2), (556.0, 548.8, 0.0))
_LAMP = ((343.0, 548.8, 227.0), (343.0, 548.8, 332.0), (213.0, 548.8, 332.0), (213.0, 548.8, 227.0))
_SHORT = ((130.0, 165.0, 65.0), (82.0, 165.0, 225.0), (240.0, 165.0, 272.0), (290.0, 165.0, 114.0))
_TALL = ((423.0, 330.0, 247.0), (265.0, 330.0, 296.0), (314.0, 330.0, 456.0), (472.0, 330.0, 406.0))
CORNELL_SCALE = 0.01  # scene units per millimetre: a box of 5.5, ten times life size, which leaves radiance as it is
# Reflectances and radiance in linear RGB. Source: Mitsuba 3, `cornell_box()`.
_WHITE = (0.885809, 0.698859, 0.666422)
_GREEN = (0.105421, 0.37798, 0.076425)
_RED = (0.570068, 0.0430135, 0.0443706)
_RADIANCE = (18.387, 13.9873, 6.75357)


def _quads(quads: np.ndarray, material: Sequence[int]) -> Mesh:
    """Quads `[q, 4, 3]` with their own corners, counter-clockwise from the image's top left, and a material each.

    The walls are out of plane by up to 6 mm in 550; each takes the normal of its diagonals at all four corners.
    """
    a, b, c, d = np.moveaxis(quads, 1, 0)
    normals = np.cross(c - a, d - b)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = d - a + c - b
    tangents -= normals * (normals * tangents).sum(axis=1, keepdims=True)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    tangents = np.concatenate([tangents, np.ones((len(quads), 1))], axis=1)
    faces = 4 * np.arange(len(quads))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(
        vertices=jnp.asarray(quads.reshape(-1, 3) * CORNELL_SCALE, jnp.float32),
        normals=jnp.asarray(normals.repeat(4, axis=0), jnp.float32),
        tangents=jnp.asarray(tangents.repeat(4, axis=0), jnp.float32),
        uvs=jnp.asarray(np.tile([(0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0)], (len(quads), 1)), jnp.float32),
        faces=jnp.asarray(faces.reshape(-1, 3), jnp.int32),
        material=jnp.asarray(np.repeat(material, 2), jnp.int32),
    )


def _ring(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """The four quads between two quads that run the same way."""
    after = np.roll(np.arange(4), -1)
    return np.stack([outer, outer[after], inner[after], inner], axis=1)


def _block(top: np.ndarray) -> np.ndarray:
    """The five visible sides of a block that stands on the floor."""
    return np.stack([top, *_ring(top * [1.0, 0.0, 1.0], top)[:, [3, 0, 1, 2]]])


def cornell_box(spot: bool = True) -> tuple[Scene, Camera]:
    """The measured Cornell box: diffuse walls and two blocks, lit by an emissive quad in a hole of the ceiling.

    A rasterizer's emissive quad lights nothing, so a spot hangs 1 mm below it, with the on-axis intensity L·A and the
    flux π·L·A of a Lambertian emitter: its cone, min(1, (cos θ / cos inner)²) down to the horizontal, has the flux
    2π(1 - ⅔ cos inner), hence cos inner = ¾. Take `spot=False` where the quad itself gives light, as in a path tracer.
    Diffuse but for the 4 % of gloss, as rough as can be, that every dielectric has here.
    """
    white, green, red, lamp = range(4)
    floor, ceiling, back, green_wall, red_wall, quad, short, tall = (
        np.array(corners) for corners in (_FLOOR, _CEILING, _BACK, _GREEN_WALL, _RED_WALL, _LAMP, _SHORT, _TALL)
    )
    whites = np.concatenate([[floor, back], _ring(ceiling, quad), _block(short), _block(tall)])
    quads = np.concatenate([whites, [green_wall, red_wall, quad]])

    # Put the light's area on its axis: (position, direction, intensity, range, inner, outer).
    sides = np.linalg.norm(quad[:2] - quad[1:3], axis=1) * CORNELL_SCALE
    below = (quad.mean(axis=0) - [0.0, 1.0, 0.0]) * CORNELL_SCALE
    lamps = [(below, (0.0, -1.0, 0.0), np.array(_RADIANCE) * sides.prod(), np.inf, np.arccos(0.75), 0.5 * np.pi)]
    scene = Scene(
        mesh=_quads(quads, [white] * len(whites) + [green, red, lamp]),
        materials=stack_materials(
            [
                {"base_color": _WHITE},
                {"base_color": _GREEN},
                {"base_color": _RED},
                {"base_color": (0.0, 0.0, 0.0), "emissive": _RADIANCE},
            ]
        ),
        textures=pack_textures([]),
        lights=stack_lights(spot=lamps if spot else []),
        environment=environment((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    )
    # The measured camera: 35 mm before a film of 25 mm, level, towards +Z.
    x, y, z = (CORNELL_SCALE * c for c in (278.0, 273.0, -800.0))
    return scene, camera((x, y, z), (x, y, z + 1.0), np.degrees(2.0 * np.arctan(0.5 * 0.025 / 0.035)))
