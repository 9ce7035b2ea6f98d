"""Materials and lights from plain rows: the struct of arrays that a scene is, from one dict or tuple each.

All of it runs on the host. Gradient: none, the numbers are copied.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from .scene import OPAQUE, TEXTURE_SLOTS, Directional, Lights, Materials, Point, Spot

UNMAPPED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))  # uvs as they are
COMMON = {
    "base_color": (1.0, 1.0, 1.0, 1.0),
    "metallic": 0.0,
    "roughness": 1.0,
    "emissive": (0.0, 0.0, 0.0),
    "normal_scale": 1.0,
    "occlusion_strength": 1.0,
    **{f"{slot}_texture": -1 for slot in TEXTURE_SLOTS},
    "double_sided": False,
}
# What is None in `Materials` unless some row has it.
RARE = {
    "uv_sets": (0,) * len(TEXTURE_SLOTS),
    "uv_transforms": (UNMAPPED,) * len(TEXTURE_SLOTS),
    "ior": 1.5,
    "specular": (1.0, 1.0, 1.0, 1.0),
    "unlit": False,
    "alpha_mode": OPAQUE,
    "alpha_cutoff": 0.5,
    "clearcoat": (0.0, 0.0),
    "sheen": (0.0, 0.0, 0.0, 0.0),
}


def stack_materials(rows: Sequence[Mapping[str, Any]]) -> Materials:
    """`Materials` of one dict a row, which names what differs from a rough white dielectric.

    A base colour may have three numbers; its alpha is then 1. Raises `TypeError` for an unknown name.

    Example:
        >>> stack_materials([{"base_color": (0.8, 0.1, 0.1)}, {"metallic": 1.0, "roughness": 0.2}]).roughness.tolist()
        [1.0, 0.20000000298023224]
    """
    for i, row in enumerate(rows):
        if unknown := set(row) - set(COMMON | RARE):
            raise TypeError(
                f"stack_materials: row {i} has {', '.join(sorted(unknown))}; known: {', '.join(COMMON | RARE)}"
            )
    rows = [{**row, "base_color": (*row.get("base_color", (1.0, 1.0, 1.0)), 1.0)[:4]} for row in rows]
    rare = {
        name: default
        for name, default in RARE.items()
        if any(not np.array_equal(row.get(name, default), default) for row in rows)
    }
    kinds = {"f": np.float32, "i": np.int32, "b": np.bool_}
    columns = {}
    for name, default in (COMMON | rare).items():
        column = np.array([row.get(name, default) for row in rows], kinds[np.array(default).dtype.kind])
        columns[name] = jnp.asarray(column.reshape(len(rows), *np.shape(default)))
    return Materials(**columns)


def stack_lights(directional: Sequence[tuple] = (), point: Sequence[tuple] = (), spot: Sequence[tuple] = ()) -> Lights:
    """`Lights` of one tuple a light, its numbers in the order of the fields of `Directional`, `Point` and `Spot`.

    Directions need not be unit.

    Example:
        >>> stack_lights(directional=[((0, -2, 0), (3, 3, 3))]).directional.direction.tolist()
        [[0.0, -1.0, 0.0]]
    """

    def columns(kind, rows, **widths):
        values = {}
        for i, (name, width) in enumerate(widths.items()):
            value = np.array([row[i] for row in rows], np.float64).reshape(-1, *([3] if width == 3 else []))
            if name == "direction":
                value = value / np.linalg.norm(value, axis=1, keepdims=True)
            values[name] = jnp.asarray(value.astype(np.float32))
        return kind(**values)

    return Lights(
        directional=columns(Directional, directional, direction=3, irradiance=3),
        point=columns(Point, point, position=3, intensity=3, range=1),
        spot=columns(Spot, spot, position=3, direction=3, intensity=3, range=1, inner=1, outer=1),
    )
