"""glTF 2.0 files, .gltf and .glb, as a mesh, materials, textures, lights and cameras."""

from .asset import Asset, join_pieces
from .disk import Path
from .gltf_container import read_document
from .gltf_light import PUNCTUAL, read_cameras, read_lights
from .gltf_material import read_materials
from .gltf_mesh import place_piece, read_primitive
from .gltf_node import place_nodes
from .pointer import Notes, fail, note, reference, rows, strings

SUPPORTED = frozenset((PUNCTUAL, "KHR_materials_emissive_strength", "KHR_mesh_quantization"))
MOST_NAMES = 5


def _sentences(notes: Notes) -> tuple[str, ...]:
    """One sentence for each kind of note, with the first few of its places."""
    sentences = []
    for what, where in notes.items():
        named = [place for place in where if place]
        more = f" and {len(named) - MOST_NAMES} more" if len(named) > MOST_NAMES else ""
        sentences.append(f"{what}{': ' if named else ''}{', '.join(named[:MOST_NAMES])}{more}")
    return tuple(sentences)


def read_gltf(path: Path) -> Asset:
    """Read the scene of a glTF file into world space.

    Materials keep the order of the file; triangles, lights and cameras follow the order of its nodes.
    """
    document, notes = read_document(path, SUPPORTED), {}
    root = document.root
    for extension in strings(root, "extensionsUsed"):
        if extension not in SUPPORTED:
            note(notes, f"extension {extension} is ignored")
    if root.value.get("animations"):
        note(notes, "animations are ignored")

    placed = place_nodes(root)
    meshes, num_materials = rows(root, "meshes"), len(rows(root, "materials"))
    read, pieces = {}, []
    for node, matrix in placed:
        mesh = reference(node, "mesh", meshes)
        if mesh is None:
            continue
        # Read a mesh once, however often it stands in the scene.
        if mesh.where not in read:
            primitives = [read_primitive(document, p, num_materials, notes) for p in rows(mesh, "primitives")]
            read[mesh.where] = [piece for piece in primitives if piece is not None]
        pieces.extend(place_piece(piece, matrix, node) for piece in read[mesh.where])
    if not pieces:
        fail(root, "contains no triangles; export a mesh with the scene")

    default = any(piece.material[0] == num_materials for piece in pieces)
    materials, textures = read_materials(document, default, notes)
    mesh = join_pieces(pieces, materials.normal_texture, root.file)
    return Asset(
        mesh=mesh,
        materials=materials,
        textures=textures,
        lights=read_lights(root, placed),
        cameras=read_cameras(root, placed, notes),
        notes=_sentences(notes),
    )
