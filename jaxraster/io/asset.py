"""What every reader of files returns, and how its parts are put together."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..errors import LimitError
from ..geometry.normals import vertex_normals, vertex_tangents
from ..math.transform import frame
from ..scene import Camera, Directional, Lights, Materials, Mesh, Point, Spot, Textures

MOST_TRIANGLES = 2**26
LARGEST = 1e18  # of coordinates and light alike: squares and products of two are still float32


class Asset(NamedTuple):
    """The content of a file: `lights` is None and `cameras` empty if it has none, `notes` say what was left out."""

    mesh: Mesh
    materials: Materials
    textures: Textures
    lights: Lights | None
    cameras: tuple[Camera, ...]
    notes: tuple[str, ...]


class Piece(NamedTuple):
    """Some triangles of one material. Zeros stand for normals and tangents that the file does not give."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    tangents: Float[np.ndarray, "v 4"]
    uvs: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]
    material: Int[np.ndarray, " f"]


def floats(values, *shape: int) -> Float[Array, "..."]:
    """A float32 array of the given shape, of which the first size may be 0."""
    return jnp.asarray(np.array(values, np.float32).reshape(shape))


def unit(vectors: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
    """v / |v| on the host, and 0 where v is 0."""
    length = np.sqrt(np.sum(vectors * vectors, axis=1, keepdims=True))
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def join_pieces(pieces: list[Piece], normal_texture: Int[Array, " m"], file: str) -> Mesh:
    """One mesh of all pieces. Normals that are missing are means over the triangles around.

    So are missing tangents where a normal texture needs them; elsewhere any that are perpendicular to the normal do.
    """
    count = sum(len(piece.faces) for piece in pieces)
    if count > MOST_TRIANGLES:
        raise LimitError(file, "", f"has {count} triangles; at most {MOST_TRIANGLES} are read")
    first = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    # Compute on the host what needs no formula: every new shape would compile each operation anew.
    vertices, normals, tangents, uvs = (np.concatenate([p[i] for p in pieces]).astype(np.float32) for i in range(4))
    faces = np.concatenate([piece.faces + start for piece, start in zip(pieces, first)]).astype(np.int32)
    material = np.concatenate([piece.material for piece in pieces]).astype(np.int32)

    missing = ~np.any(normals != 0, axis=-1)
    if missing.any():
        normals[missing] = np.asarray(jax.jit(vertex_normals)(vertices, faces))[missing]
    missing = ~np.any(tangents[:, :3] != 0, axis=-1)
    # Ask only for the faces that will look their normal up in a texture.
    mapped = (np.asarray(normal_texture)[material] >= 0) & missing[faces].any(axis=1)
    if mapped.any():
        tangents[missing] = np.asarray(jax.jit(vertex_tangents)(vertices, normals, uvs, faces))[missing]
    elif missing.any():
        tangents[missing, :3], tangents[missing, 3] = np.asarray(jax.jit(frame)(normals)[0])[missing], 1.0
    arrays = (jnp.asarray(a) for a in (vertices, normals, tangents, uvs, faces, material))
    return Mesh(**dict(zip(("vertices", "normals", "tangents", "uvs", "faces", "material"), arrays)))


DEFAULT_MATERIAL = {
    "base_color": (1.0, 1.0, 1.0, 1.0),
    "metallic": 0.0,
    "roughness": 0.5,
    "emissive": (0.0, 0.0, 0.0),
    "normal_scale": 1.0,
    "occlusion_strength": 1.0,
    "base_color_texture": -1,
    "metallic_roughness_texture": -1,
    "normal_texture": -1,
    "occlusion_texture": -1,
    "emissive_texture": -1,
    "double_sided": False,
}


def stack_materials(rows: list[dict]) -> Materials:
    """`Materials` of one dict a row, which names what differs from a smooth white dielectric."""
    kinds = {float: np.float32, tuple: np.float32, int: np.int32, bool: np.bool_}
    columns = {
        name: jnp.asarray(np.array([row.get(name, default) for row in rows], kinds[type(default)]))
        for name, default in DEFAULT_MATERIAL.items()
    }
    return Materials(**columns)


def stack_lights(directional: Sequence[tuple] = (), point: Sequence[tuple] = (), spot: Sequence[tuple] = ()) -> Lights:
    """`Lights` of one tuple a light, its fields in the order of `Directional`, `Point` and `Spot`."""

    def columns(rows, *widths):
        fields = zip(*rows) if rows else [()] * len(widths)
        return [floats(list(field), *((-1, 3) if width == 3 else (-1,))) for field, width in zip(fields, widths)]

    direction, irradiance = columns(directional, 3, 3)
    position, intensity, reach = columns(point, 3, 3, 1)
    points = Point(position=position, intensity=intensity, range=reach)
    position, axis, intensity, reach, inner, outer = columns(spot, 3, 3, 3, 1, 1, 1)
    spots = Spot(position=position, direction=axis, intensity=intensity, range=reach, inner=inner, outer=outer)
    return Lights(directional=Directional(direction=direction, irradiance=irradiance), point=points, spot=spots)
