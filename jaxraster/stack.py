"""Materials and lights from plain rows, textures from images: the struct of arrays that a scene is.

All of it runs on the host. Gradient: none, the numbers are copied.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .check import fit
from .scene import (
    FIRST,
    LINEAR,
    MIRROR,
    OPAQUE,
    REPEAT,
    TEXTURE_SLOTS,
    Directional,
    Disc,
    Lights,
    Materials,
    Point,
    Rectangle,
    Sphere,
    Spot,
    Textures,
)  # fmt: skip

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


# The columns of each kind of light, in the order of its fields: how many numbers, and what they must be.
_LIGHTS = {
    "directional": (Directional, ("direction", "irradiance")),
    "point": (Point, ("position", "intensity", "range")),
    "spot": (Spot, ("position", "direction", "intensity", "range", "inner", "outer")),
    "sphere": (Sphere, ("position", "radius", "radiance")),
    "disc": (Disc, ("position", "direction", "radius", "radiance", "two_sided")),
    "rectangle": (Rectangle, ("position", "right", "up", "radiance", "two_sided")),
}
_NUMBERS = {"range", "inner", "outer", "radius"}


def _no_light(name: str, value: Any) -> str | None:
    """What a column's value in one row should be and is not."""
    if np.isnan(value).any() or (name != "range" and np.isinf(value).any()):
        return "finite"
    if name in ("range", "radius") and value < 0:
        return "0 or more"
    if name in ("inner", "outer") and not 0 <= value <= np.pi:
        return "a half angle from 0 to π"
    return "longer than 0" if name == "direction" and not value.any() else None


def _stacked(kind: str, rows: Sequence[tuple]) -> Any:
    """The record of one kind of light."""
    make, names = _LIGHTS[kind]
    columns = {}
    for i, name in enumerate(names):
        if name == "two_sided":
            columns[name] = jnp.asarray(np.array([row[i] if len(row) > i else False for row in rows], np.bool_))
            continue
        column = np.array([row[i] for row in rows], np.float64).reshape(len(rows), *([] if name in _NUMBERS else [3]))
        for row, value in enumerate(column):
            if wanted := _no_light(name, value):
                raise ValueError(f"stack_lights: {name} of {kind}[{row}] must be {wanted}, got {value.tolist()}")
        if name == "direction":
            column /= np.linalg.norm(column, axis=1, keepdims=True)
        columns[name] = jnp.asarray(column.astype(np.float32))
    for row, (inner, outer) in enumerate(zip(columns.get("inner", ()), columns.get("outer", ()))):
        if inner > outer:
            raise ValueError(f"stack_lights: inner of spot[{row}] must be at most outer, got {inner} and {outer}")
    return make(**columns)


def stack_lights(
    directional: Sequence[tuple] = (),
    point: Sequence[tuple] = (),
    spot: Sequence[tuple] = (),
    sphere: Sequence[tuple] = (),
    disc: Sequence[tuple] = (),
    rectangle: Sequence[tuple] = (),
) -> Lights:
    """`Lights` of one tuple a light, its numbers in the order of the fields of `Directional`, `Point` and so on.

    Directions need not be unit; `two_sided` may be left out. Raises `ValueError` for numbers that make no light. A
    negative strength takes light away.

    Example:
        >>> lights = stack_lights(directional=[((0, -2, 0), (3, 3, 3))], sphere=[((0, 1, 0), 0.1, (50, 50, 50))])
        >>> lights.directional.direction.tolist(), lights.sphere.radius.shape, lights.disc
        ([[0.0, -1.0, 0.0]], (1,), None)
    """
    areas = {"sphere": sphere, "disc": disc, "rectangle": rectangle}
    return Lights(
        directional=_stacked("directional", directional),
        point=_stacked("point", point),
        spot=_stacked("spot", spot),
        **{kind: _stacked(kind, rows) for kind, rows in areas.items() if len(rows)},
    )


def _halve(image: np.ndarray) -> np.ndarray:
    """The next mip level: size max(1, n // 2) on each axis, every texel weighed by its exact overlap (box filter)."""
    for axis in (0, 1):
        size = image.shape[axis]
        half = max(1, size // 2)
        if size == 2 * half:
            image = 0.5 * (image.take(range(0, size, 2), axis) + image.take(range(1, size, 2), axis))
        elif size > 1:
            edges = np.arange(half + 1) * (size / half)
            texel = np.arange(size)
            overlap = np.minimum(edges[1:, None], texel + 1) - np.maximum(edges[:-1, None], texel)
            weights = np.maximum(overlap, 0.0) * (half / size)
            image = np.moveaxis(np.tensordot(weights, image, (1, axis)), 0, axis)
    return image.astype(np.float32)


def _codes(name: str, given: Sequence | None, most: tuple[int, ...], default: int, count: int) -> list[tuple[int, ...]]:
    """A row of codes, each from 0 to its most, for each of `count` images; the default where none are given."""
    if given is None or len(given) == 0:
        return [(default,) * len(most)] * count
    rows = [tuple(np.ravel(row).tolist()) for row in given]
    if len(rows) != count or any(len(r) != len(most) or any(not 0 <= c <= m for c, m in zip(r, most)) for r in rows):
        each = f"a row of {len(most)} codes, from 0 to {most}, for each of {count} images"
        raise ValueError(f"pack_textures: {name} must hold {each}, got {given}")
    return rows


def pack_textures(
    images: Sequence[np.ndarray],
    wrap: Sequence[tuple[int, int]] | None = None,
    filters: Sequence[tuple[int, int, int]] | None = None,
) -> Textures:
    """Linear float images `[h, w, 4]` of any sizes, with all their mip levels, in one buffer.

    Runs on the host. `wrap` and `filters` hold a row of codes per image, as `Textures` explains them; left out, all
    repeat and are trilinear. The mean of every level equals the image's, also for odd sizes. Without images the buffer
    holds one white texel, so that it may still be gathered from.

    Example:
        >>> pack_textures([np.ones((4, 2, 4), np.float32)]).levels.tolist()
        [[[0, 2, 4], [8, 1, 2], [10, 1, 1]]]
    """
    for i, image in enumerate(images):
        fit(f"pack_textures: images[{i}]", image, Float[Array, "h w 4"])
        if 0 in image.shape:
            raise ValueError(f"pack_textures: images[{i}] has no texels, its shape is {list(image.shape)}")
    images = [np.asarray(image, np.float32) for image in images] or [np.ones((1, 1, 4), np.float32)]
    wraps = _codes("wrap", wrap, (MIRROR, MIRROR), REPEAT, len(images))
    rules = _codes("filters", filters, (LINEAR, LINEAR, FIRST), LINEAR, len(images))
    texels, levels, offset = [], [], 0
    for image in images:
        rows = []
        while True:
            rows.append((offset, image.shape[1], image.shape[0]))
            texels.append(image.reshape(-1, 4))
            offset += len(texels[-1])
            if max(image.shape[:2]) == 1:
                break
            image = _halve(image)
        levels.append(rows)
    deepest = max(len(rows) for rows in levels)
    table = [rows + rows[-1:] * (deepest - len(rows)) for rows in levels]
    return Textures(
        texels=jnp.asarray(np.concatenate(texels)),
        levels=jnp.asarray(np.array(table, np.int32)),
        wrap=jnp.asarray(np.array(wraps, np.int32)),
        filters=None if {*rules} == {(LINEAR, LINEAR, LINEAR)} else jnp.asarray(np.array(rules, np.int32)),
    )
