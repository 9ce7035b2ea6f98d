"""glTF 2.0 files, .gltf and .glb, as a mesh, materials, textures, lights and cameras."""

import contextlib
import gc
from collections.abc import Iterator

import numpy as np

from .asset import Asset, Piece, join_pieces
from .disk import Path
from .gltf_container import Document, read_document
from .gltf_light import PUNCTUAL, read_cameras, read_lights
from .gltf_material import EXTENSIONS, read_materials
from .gltf_mesh import place_piece, read_primitive
from .gltf_node import Matrix, place_nodes
from .gltf_texture import TRANSFORM, WEBP
from .pointer import Json, fail, reference, rows, strings
from .reading import Reading

SUPPORTED = EXTENSIONS | {PUNCTUAL, TRANSFORM, WEBP, "KHR_mesh_quantization"}


def _read_pieces(document: Document, placed: list[tuple[Json, Matrix]], num_materials: int) -> list[Piece]:
    """The triangles of all nodes in world space; a mesh is read once, however often it stands in the scene."""
    meshes, reading = rows(document.root, "meshes"), document.reading
    read: dict[str, list[Piece]] = {}
    uses: dict[str, list[int]] = {}
    for order, (node, _) in enumerate(placed):
        mesh = reference(node, "mesh", meshes)
        if mesh is None:
            continue
        if mesh.where not in read:
            primitives = [read_primitive(document, p, num_materials) for p in rows(mesh, "primitives")]
            read[mesh.where] = [piece for piece in primitives if piece is not None]
        uses.setdefault(mesh.where, []).append(order)
        # Count before placing: a file of a few bytes can ask for any number of instances.
        for piece in read[mesh.where]:
            reading.count("triangles", len(piece.faces), node.file, node.where, "the scene's triangles")
            reading.count("vertices", len(piece.vertices), node.file, node.where, "the scene's vertices")

    # Place all instances of a mesh together, and put them into the order of their nodes.
    found: dict[int, tuple[Piece, ...]] = {}
    for where, orders in uses.items():
        nodes, matrices = zip(*(placed[order] for order in orders))
        columns = [place_piece(piece, np.stack(matrices), list(nodes), reading) for piece in read[where]]
        found |= dict(zip(orders, zip(*columns)))
    return [piece for order in sorted(found) for piece in found[order] if len(piece.faces)]


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Without the garbage collector: the parts of a large file all live on, and it would walk them again and again."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


@_uncollected()
def read_gltf(path: Path, reading: Reading | None = None) -> Asset:
    """Read the scene of a glTF file into world space.

    Materials keep the order of the file; triangles, lights and cameras follow the order of its nodes.
    """
    reading = reading or Reading()
    document = read_document(path, SUPPORTED, reading)
    root = document.root
    for extension in strings(root, "extensionsUsed"):
        if extension not in SUPPORTED:
            reading.ignore("extensions are ignored", extension)
    if root.value.get("animations"):
        reading.ignore("animations are ignored")

    placed, num_materials = place_nodes(root, reading), len(rows(root, "materials"))
    pieces = _read_pieces(document, placed, num_materials)
    if not pieces:
        left_out = f", but {'; '.join(reading.notes())}" if reading.notes() else ""
        fail(root, f"contains no triangles{left_out}; export a mesh with the scene")
    default = any(piece.material[0] == num_materials for piece in pieces)
    materials, textures = read_materials(document, default)
    # Carry no second uvs along that nothing looks up.
    if materials.uv_sets is None:
        pieces = [piece._replace(second_uvs=None) for piece in pieces]
    else:
        asked = np.any(np.asarray(materials.uv_sets), axis=1).tolist()
        if any(piece.second_uvs is None and asked[piece.material[0]] for piece in pieces):
            reading.ignore("second texture coordinates that a mesh does not have are replaced by its first")
        pieces = [p._replace(second_uvs=p.uvs) if p.second_uvs is None else p for p in pieces]
    return Asset(
        mesh=join_pieces(pieces, materials),
        materials=materials,
        textures=textures,
        lights=read_lights(root, placed),
        cameras=read_cameras(root, placed),
        notes=reading.notes(),
    )
