"""glTF primitives as triangles, and their way into the world.

Source: Khronos Group, "glTF 2.0 Specification", 2021, section 3.7.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from .asset import LARGEST, Piece, unit
from .gltf_accessor import read_accessor, read_floats
from .gltf_container import Document
from .pointer import Json, fail, integer, reference, table
from .reading import Reading

TRIANGLES, STRIP, FAN = 4, 5, 6
_LEFT_OUT = ("points", "lines", "line loops", "line strips")
FLOAT, UNSIGNED = 5126, (5121, 5123)
_PER_VERTEX = ("vertices", "normals", "tangents", "uvs", "second_uvs", "colors")
# Attribute -> components.
_ATTRIBUTES = {"NORMAL": (3,), "TANGENT": (4,), "TEXCOORD_0": (2,), "TEXCOORD_1": (2,), "COLOR_0": (3, 4)}


def _corners(index: Int[np.ndarray, " n"], mode: int, where: Json, reading: Reading) -> Int[np.ndarray, "f 3"]:
    """The triangles that a run of corners stands for; every second of a strip is turned to face the same way."""
    if mode == TRIANGLES:
        if over := len(index) % 3:
            told = f"{len(index)} corners do not make whole triangles"
            reading.drop(where.file, where.where, told, f"{over} corners")
        return index[: len(index) // 3 * 3].reshape(-1, 3)
    if len(index) < 3:
        reading.drop(where.file, where.where, f"{len(index)} corners do not make a triangle", f"{len(index)} corners")
        return index[:0].reshape(-1, 3)
    if mode == FAN:
        return np.stack([index[1:-1], index[2:], np.broadcast_to(index[0], len(index) - 2)], axis=1)
    faces = np.stack([index[:-2], index[1:-1], index[2:]], axis=1)
    faces[1::2, 1:] = faces[1::2, :0:-1]
    return faces


def _read_faces(document: Document, primitive: Json, mode: int, count: int) -> Int[np.ndarray, "f 3"]:
    where = primitive._replace(where=f"{primitive.where}/indices")
    accessor = reference(primitive, "indices", document.accessors)
    if accessor is None:
        return _corners(np.arange(count), mode, where, document.reading)
    index = read_accessor(document, accessor)
    if index.shape[1] != 1 or index.dtype.kind != "u":
        fail(where, "are not unsigned integers; export the mesh again")
    faces = _corners(index[:, 0].astype(np.int64), mode, where, document.reading)
    told = f"index {index.max()} but only {count} vertices"
    return _keep(faces, np.all(faces < count, axis=1), told, where, document.reading)


def _keep(
    faces: Int[np.ndarray, "f 3"], good: Bool[np.ndarray, " f"], told: str, at: Json, reading: Reading
) -> Int[np.ndarray, "left 3"]:
    """The faces that are good; if not all are, an error or a note, as it is read."""
    if good.all():
        return faces
    reading.drop(at.file, at.where, told, f"{(~good).sum()} of {len(good)} faces")
    return faces[good]


def _read_attribute(document: Document, attributes: Json, name: str, count: int) -> Float[np.ndarray, "v c"] | None:
    """An attribute of every vertex, finite; None if there is none, or none that fits."""
    accessor = reference(attributes, name, document.accessors)
    if accessor is None:
        return None
    values, drop = read_floats(document, accessor, *_ATTRIBUTES[name]), document.reading.drop
    if name == "COLOR_0":
        _check_color_type(accessor)
    if len(values) != count:
        told = f"{name} has {len(values)} elements for {count} vertices"
        drop(attributes.file, attributes.where, told, f"{name} of {count} vertices")
        return None
    if name == "NORMAL" and not values.any(axis=1).all():
        what = "NORMAL has zeros, which become means of the faces around"
        document.reading.mend(attributes.file, attributes.where, what)
    bad = ~np.all(np.isfinite(values), axis=1)
    if np.any(bad):
        told = f"{bad.sum()} of {count} elements are not finite"
        drop(accessor.file, accessor.where, told, f"{name} of {bad.sum()} vertices")
        return np.where(bad[:, None], np.float32(0), values)
    return values


def _check_color_type(accessor: Json) -> None:
    kind = integer(accessor, "componentType")
    if kind != FLOAT and not (kind in UNSIGNED and accessor.value.get("normalized") is True):
        fail(accessor, "holds colours that are neither floats nor normalized unsigned integers; export the mesh again")


def _clean_colors(colors: Float[np.ndarray, "v c"], at: Json, reading: Reading) -> Float[np.ndarray, "v 4"]:
    """RGBA in [0, 1], alpha 1 where there is none."""
    if ((colors < 0) | (colors > 1)).any():
        reading.mend(at.file, at.where, "COLOR_0 is clamped to [0, 1]")
        colors = np.clip(colors, 0, 1)
    alpha = np.ones((len(colors), 4 - colors.shape[1]), np.float32)
    return np.concatenate([colors, alpha], axis=1)


def _clean_tangents(tangents: Float[np.ndarray, "v 4"], at: Json, reading: Reading) -> Float[np.ndarray, "v 4"]:
    """Tangents whose w is 1 or -1."""
    if (np.abs(tangents[:, 3]) != 1).any():
        reading.mend(at.file, at.where, "TANGENT has signs that are neither 1 nor -1")
        tangents = np.concatenate([tangents[:, :3], np.where(tangents[:, 3:] < 0, -1, 1)], axis=1).astype(np.float32)
    return tangents


def _only_used(piece: Piece) -> Piece:
    """The piece without the vertices that no face has: each instance would carry them along."""
    used = np.zeros(len(piece.vertices), bool)
    used[piece.faces] = True
    if used.all():
        return piece
    numbers = np.cumsum(used, dtype=np.int32) - 1
    kept = {name: values[used] for name in _PER_VERTEX if (values := getattr(piece, name)) is not None}
    return piece._replace(**kept, faces=numbers[piece.faces])


def read_primitive(document: Document, primitive: Json, default_material: int) -> Piece | None:
    """The triangles of a primitive in its mesh's space; None, and a note, if it has none.

    Without normals every face is flat, with corners of its own, and given tangents are void.
    """
    mode, reading = integer(primitive, "mode", TRIANGLES), document.reading
    if mode > FAN:
        fail(primitive, f"mode is {mode}, but the last one is {FAN}; export the mesh again")
    if mode < TRIANGLES:
        reading.ignore(f"{_LEFT_OUT[mode]} are left out", primitive.where)
        return None
    attributes = table(primitive, "attributes")
    if "JOINTS_0" in attributes.value:
        reading.ignore("skins are ignored", primitive.where)
    if "targets" in primitive.value:
        reading.ignore("morph targets are ignored", primitive.where)

    position = reference(attributes, "POSITION", document.accessors) or fail(attributes, "POSITION is missing")
    count = integer(position, "count", low=1)
    vertices = read_floats(document, position, 3)
    reading.count("vertices", count, primitive.file, primitive.where, "the scene's vertices")
    faces = _read_faces(document, primitive, mode, count)
    finite = np.all(np.isfinite(vertices), axis=1)
    told = f"{(~finite).sum()} of {count} elements are not finite"
    faces = _keep(faces, np.all(finite[faces], axis=1), told, position, reading) if not finite.all() else faces
    if not len(faces):
        return None
    normals, tangents, uvs, second_uvs, colors = (
        _read_attribute(document, attributes, name, count) for name in _ATTRIBUTES
    )
    material = integer(primitive, "material", default_material)
    if material > default_material or (material == default_material and "material" in primitive.value):
        told = f"material is {material}, but there are {default_material}"
        reading.drop(primitive.file, primitive.where, told, "a material")
        material = default_material
    colors = None if colors is None else _clean_colors(colors, attributes, reading)
    tangents = None if tangents is None else _clean_tangents(tangents, attributes, reading)
    piece = Piece(
        vertices=np.where(finite[:, None], vertices, np.float32(0)),
        normals=np.zeros((count, 3), np.float32) if normals is None else normals,
        tangents=np.zeros((count, 4), np.float32) if tangents is None or normals is None else tangents,
        uvs=np.zeros((count, 2), np.float32) if uvs is None else uvs,
        faces=faces.astype(np.int32),
        material=np.full(len(faces), material, np.int32),
        second_uvs=second_uvs,
        colors=colors,
    )
    return _only_used(piece) if normals is not None else _split_corners(piece)


def _split_corners(piece: Piece) -> Piece:
    """The same triangles with corners of their own."""
    corners = piece.faces.ravel()
    split = {name: values[corners] for name in _PER_VERTEX if (values := getattr(piece, name)) is not None}
    return piece._replace(**split, faces=np.arange(len(corners), dtype=np.int32).reshape(-1, 3))


_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


def _cofactors(m: Float[np.ndarray, "k 3 3"]) -> Float[np.ndarray, "k 3 3"]:
    """The matrices by which vector areas move: column i is the cross product of the next two columns."""
    row, column = _NEXT[:, None], _AFTER[:, None]
    return m[:, row, _NEXT] * m[:, column, _AFTER] - m[:, row, _AFTER] * m[:, column, _NEXT]


def place_piece(piece: Piece, matrices: Float[np.ndarray, "k 4 4"], nodes: list[Json], reading: Reading) -> list[Piece]:
    """A piece moved into the world by each of its nodes' affine matrices M, which may shear and mirror.

    Normals follow sign(det M) · cof M, the part of M⁻ᵀ that counts and exists for flat M, tangents follow M; a mirror
    reverses the corners' order and the bitangent's sign.
    """
    linear, cofactors = matrices[:, :3, :3], _cofactors(matrices[:, :3, :3])
    sign = np.where(np.sum(linear[:, :, 0] * cofactors[:, :, 0], axis=1) < 0, -1.0, 1.0)[:, None, None]
    vertices = piece.vertices @ np.swapaxes(linear, 1, 2) + matrices[:, None, :3, 3]
    normals = unit(piece.normals @ np.swapaxes(sign * cofactors, 1, 2))
    handed = np.broadcast_to(piece.tangents[:, 3:], (len(nodes), len(piece.tangents), 1)) * sign
    tangents = np.concatenate([unit(piece.tangents[:, :3] @ np.swapaxes(linear, 1, 2)), handed], axis=2)

    near = np.all(np.abs(vertices) <= LARGEST, axis=2)
    mirrored = piece.faces[:, [0, 2, 1]]
    placed = []
    for i, node in enumerate(nodes):
        faces = piece.faces if sign[i] > 0 else mirrored
        moved = piece._replace(vertices=vertices[i], normals=normals[i], tangents=tangents[i], faces=faces)
        placed.append(moved if near[i].all() else _keep_near(moved, near[i], node, reading))
    return placed


def _keep_near(piece: Piece, near: Bool[np.ndarray, " v"], node: Json, reading: Reading) -> Piece:
    """The piece without the faces that its node puts where nothing is drawn."""
    told = f"puts vertices {np.abs(piece.vertices).max():.3g} m away; at most {LARGEST:g} are drawn"
    faces = _keep(piece.faces, np.all(near[piece.faces], axis=1), told, node, reading)
    material = np.full(len(faces), piece.material[0], np.int32)
    return piece._replace(faces=faces, material=material, vertices=np.where(near[:, None], piece.vertices, 0.0))
