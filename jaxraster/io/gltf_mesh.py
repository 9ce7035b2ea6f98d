"""glTF primitives as triangles, and their way into the world.

Source: Khronos Group, "glTF 2.0 Specification", 2021, section 3.7.
"""

import numpy as np

from .asset import LARGEST, Piece, unit
from .gltf_accessor import read_accessor, read_floats
from .gltf_container import Document
from .gltf_node import Matrix
from .pointer import Json, Notes, fail, integer, note, reference, table

TRIANGLES = 4
_MODES = ("points", "lines", "line loops", "line strips", "triangles", "triangle strips", "triangle fans")


def _read_faces(document: Document, primitive: Json, count: int) -> np.ndarray:
    where = primitive._replace(where=f"{primitive.where}/indices")
    accessor = reference(primitive, "indices", document.accessors)
    if accessor is None:
        index = np.arange(count)
    else:
        index = read_accessor(document, accessor)
        if index.shape[1] != 1 or index.dtype.kind != "u":
            fail(where, "are not unsigned integers; re-export the mesh")
        index = index[:, 0].astype(np.int64)
        if (highest := int(index.max())) >= count:
            fail(where, f"index {highest} but only {count} vertices; re-export the mesh")
    if len(index) % 3:
        fail(where, f"{len(index)} corners do not make whole triangles; re-export the mesh")
    return index.reshape(-1, 3).astype(np.int32)


def read_primitive(document: Document, primitive: Json, default_material: int, notes: Notes) -> Piece | None:
    """The triangles of a primitive in its mesh's space; None, and a note, if it consists of something else.

    Without normals every face is flat, with corners of its own, and given tangents are void.
    """
    mode = integer(primitive, "mode", TRIANGLES)
    if mode != TRIANGLES:
        if mode >= len(_MODES):
            fail(primitive, f"mode is {mode}, but the last one is {len(_MODES) - 1}; re-export the mesh")
        note(notes, f"{_MODES[mode]} are left out", primitive.where)
        return None
    attributes = table(primitive, "attributes")
    for name, what in (("COLOR_0", "vertex colours"), ("JOINTS_0", "skins")):
        if name in attributes.value:
            note(notes, f"{what} are ignored", primitive.where)
    if "targets" in primitive.value:
        note(notes, "morph targets are ignored", primitive.where)

    def attribute(name: str, size: int) -> np.ndarray | None:
        accessor = reference(attributes, name, document.accessors)
        if accessor is None:
            return None
        values = read_floats(document, accessor, size)
        if len(values) != count:
            fail(attributes, f"{name} has {len(values)} elements for {count} vertices; re-export the mesh")
        return values

    position = reference(attributes, "POSITION", document.accessors) or fail(attributes, "POSITION is missing")
    count = integer(position, "count", low=1)
    vertices = read_floats(document, position, 3)
    normals, tangents, uvs = attribute("NORMAL", 3), attribute("TANGENT", 4), attribute("TEXCOORD_0", 2)
    faces = _read_faces(document, primitive, count)
    uvs = np.zeros((count, 2), np.float32) if uvs is None else uvs
    tangents = np.zeros((count, 4), np.float32) if tangents is None else tangents
    if normals is None:
        corners = faces.ravel()
        vertices, uvs, faces = vertices[corners], uvs[corners], np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
        normals, tangents = np.zeros_like(vertices), np.zeros((len(vertices), 4), np.float32)
    material = integer(primitive, "material", default_material)
    if material > default_material or (material == default_material and "material" in primitive.value):
        fail(primitive, f"material is {material}, but there are {default_material}; the file may be damaged")
    return Piece(vertices, normals, tangents, uvs, faces, np.full(len(faces), material, np.int32))


def place_piece(piece: Piece, matrix: Matrix, node: Json) -> Piece:
    """A piece moved into the world by an affine matrix M, which may shear and mirror.

    Normals follow sign(det M) · cof M, the part of M⁻ᵀ that counts and exists for flat M, tangents follow M; a mirror
    reverses the corners' order and the bitangent's sign.
    """
    linear = matrix[:3, :3]
    a, b, c = linear.T
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    sign = -1.0 if a @ cofactor[:, 0] < 0 else 1.0
    vertices = piece.vertices @ linear.T + matrix[:3, 3]
    if (reach := np.abs(vertices).max()) > LARGEST:
        fail(node, f"puts vertices {reach:.3g} m away; at most {LARGEST:g} are drawn")
    tangents = np.concatenate([unit(piece.tangents[:, :3] @ linear.T), sign * piece.tangents[:, 3:]], axis=1)
    faces = piece.faces if sign > 0 else piece.faces[:, [0, 2, 1]]
    normals = unit(piece.normals @ (sign * cofactor).T)
    return piece._replace(vertices=vertices, normals=normals, tangents=tangents, faces=faces)
