"""What every reader of files returns, and how its parts are put together."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..geometry.normals import vertex_normals, vertex_tangents
from ..math.transform import frame
from ..scene import TEXTURE_SLOTS, Camera, Lights, Materials, Mesh, Textures

# Of coordinates and light alike: a tenth of √FLT_MAX, so that sums of products of two are float32; the rasterizer skips
# triangles beyond it.
LARGEST = 1.844e18


class Asset(NamedTuple):
    """The content of a file: `lights` is None and `cameras` empty if it has none, `notes` say what was left out."""

    mesh: Mesh
    materials: Materials
    textures: Textures
    lights: Lights | None
    cameras: tuple[Camera, ...]
    notes: tuple[str, ...]


class Piece(NamedTuple):
    """Some triangles. Zeros stand for normals and tangents that the file does not give, None for what few files do."""

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    tangents: Float[np.ndarray, "v 4"]
    uvs: Float[np.ndarray, "v 2"]
    faces: Int[np.ndarray, "f 3"]
    material: Int[np.ndarray, " f"]
    second_uvs: Float[np.ndarray, "v 2"] | None = None
    colors: Float[np.ndarray, "v 4"] | None = None


def floats(values, *shape: int) -> Float[Array, "..."]:
    """A float32 array of the given shape, of which the first size may be 0."""
    return jnp.asarray(np.array(values, np.float32).reshape(shape))


def unit(vectors: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
    """v / |v| on the host, and 0 where v is 0."""
    length = np.sqrt(np.sum(vectors * vectors, axis=-1, keepdims=True))
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def _join_optional(pieces: list[Piece], name: str, filler: tuple[float, ...]) -> Array | None:
    """What only some pieces have, with a filler for the others; None if no piece has it."""
    if all(getattr(piece, name) is None for piece in pieces):
        return None
    blank = np.array(filler, np.float32)
    parts = [np.tile(blank, (len(p.vertices), 1)) if getattr(p, name) is None else getattr(p, name) for p in pieces]
    return jnp.asarray(np.concatenate(parts).astype(np.float32))


def _normal_map_uvs(piece: Piece, materials: Materials) -> Float[np.ndarray, "v 2"]:
    """The uvs at which a piece's normal map is looked up: what its tangents have to follow. A piece of a file that has
    uv sets or maps of uvs is of one material."""
    row, slot = piece.material[0], TEXTURE_SLOTS.index("normal")
    second = materials.uv_sets is not None and materials.uv_sets[row, slot] == 1 and piece.second_uvs is not None
    uvs = np.asarray(piece.second_uvs if second else piece.uvs)
    if materials.uv_transforms is None:
        return uvs
    matrix = np.asarray(materials.uv_transforms[row, slot])
    return uvs @ matrix[:, :2].T + matrix[:, 2]


def join_pieces(pieces: list[Piece], materials: Materials) -> Mesh:
    """One mesh of all pieces. Normals that are missing are means over the triangles around.

    So are missing tangents where a normal texture needs them; elsewhere any that are perpendicular to the normal do.
    """
    first = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    # Compute on the host what needs no formula: every new shape would compile each operation anew.
    vertices, normals, tangents, uvs = (
        np.concatenate([getattr(piece, name) for piece in pieces]).astype(np.float32)
        for name in ("vertices", "normals", "tangents", "uvs")
    )
    faces = np.concatenate([piece.faces + start for piece, start in zip(pieces, first)]).astype(np.int32)
    material = np.concatenate([piece.material for piece in pieces]).astype(np.int32)

    missing = ~np.any(normals != 0, axis=-1)
    if missing.any():
        normals[missing] = np.asarray(jax.jit(vertex_normals)(vertices, faces))[missing]
    missing = ~np.any(tangents[:, :3] != 0, axis=-1)
    # Ask only for the faces that will look their normal up in a texture.
    mapped = (np.asarray(materials.normal_texture)[material] >= 0) & missing[faces].any(axis=1)
    if mapped.any():
        places = np.concatenate([_normal_map_uvs(piece, materials) for piece in pieces]).astype(np.float32)
        tangents[missing] = np.asarray(jax.jit(vertex_tangents)(vertices, normals, places, faces))[missing]
    elif missing.any():
        tangents[missing, :3], tangents[missing, 3] = np.asarray(jax.jit(frame)(normals)[0])[missing], 1.0
    arrays = (jnp.asarray(a) for a in (vertices, normals, tangents, uvs, faces, material))
    return Mesh(
        **dict(zip(("vertices", "normals", "tangents", "uvs", "faces", "material"), arrays)),
        second_uvs=_join_optional(pieces, "second_uvs", (0.0, 0.0)),
        colors=_join_optional(pieces, "colors", (1.0, 1.0, 1.0, 1.0)),
    )
