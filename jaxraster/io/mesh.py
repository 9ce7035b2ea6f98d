"""OBJ, PLY, STL and OFF files, parsed by trimesh, as a mesh of plain coloured materials."""

import codecs
import io
import logging
import os
import re
import warnings

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..scene import pack_textures
from .asset import LARGEST, Asset, Piece, join_pieces, stack_materials, unit
from .disk import Path, read_file
from .image import srgb_to_linear

GREY = (0.5, 0.5, 0.5)  # linear, for what has no colour of its own
_FACE_COUNT = {".ply": rb"\nelement\s+face\s+(\d+)", ".off": rb"^\s*C?OFF\s+\d+\s+(\d+)"}


def _clean_text(data: bytes, suffix: str) -> bytes:
    """The bytes of a text format as UTF-8, whatever their encoding: all that counts in them is ASCII."""
    is_binary_stl = len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    if suffix == ".ply" or (suffix == ".stl" and is_binary_stl):
        return data
    encoding = "utf-16" if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"
    text = data.decode(encoding, errors="replace").encode()
    if suffix != ".obj":
        return text
    # Trimesh wants single spaces, and nothing before a line's keyword or after its numbers.
    return re.sub(rb"^ +|(?:^|(?<= ))#[^\n]*", b"", text.replace(b"\t", b" "), flags=re.MULTILINE)


def _check_indices(data: bytes, file: str) -> None:
    """Refuse the OBJ indices that trimesh would take for other vertices."""
    if zero := re.search(rb"^f\b[^\n]*\s[+-]?0(?=[\s/]|$)", data, re.MULTILINE):
        line = data.count(b"\n", 0, zero.start()) + 1
        raise InputError(file, f"line {line}", "index 0, but the first vertex is 1; export the mesh again")
    relative = re.search(rb"^f\b[^\n]*\s-\d", data, re.MULTILINE)
    # A negative index counts back from where it stands, trimesh counts from the end of the file.
    if relative and re.search(rb"^v\s", data[relative.start() :], re.MULTILINE):
        line = data.count(b"\n", 0, relative.start()) + 1
        raise InputError(file, f"line {line}", "negative index with vertices after it; export with absolute indices")


def _note_materials(data: bytes, file: str, notes: dict) -> None:
    """Note every material library that an OBJ names and that is not there: trimesh goes on without a word."""
    for name in re.findall(rb"^mtllib\s+([^\n]*\S)", data, re.MULTILINE):
        name = name.decode(errors="replace")
        if not os.path.isfile(os.path.join(os.path.dirname(file), name)):
            notes[f"material library {name} is missing"] = None


def _parse(data: bytes, file: str, suffix: str, notes: dict) -> list[dict]:
    """The parts of a file as trimesh's loaders return them, before its classes mend anything."""
    from trimesh.exchange.load import mesh_loaders
    from trimesh.resolvers import FilePathResolver

    data = _clean_text(data, suffix)
    if suffix == ".obj":
        _check_indices(data, file)
        _note_materials(data, file, notes)
    # Keep tracebacks of what is said here in one line off the terminal; whoever set up logging still gets them.
    if not logging.getLogger("trimesh").handlers:
        logging.getLogger("trimesh").addHandler(logging.NullHandler())
    try:
        with warnings.catch_warnings():
            # NumPy only warns of text among numbers, and goes on with those before it.
            warnings.filterwarnings("error", "string or file could not be read")
            loader = mesh_loaders[suffix[1:]]
            loaded = loader(io.BytesIO(data), file_type=suffix[1:], resolver=FilePathResolver(file))
    # The loaders raise whatever their parsing stumbles over.
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(file, "", f"is not a readable {suffix} file: {reason}; export it again") from error
    return list(loaded["geometry"].values()) if "geometry" in loaded else [loaded]


def _read_colors(visual, num_faces: int, notes: dict) -> tuple[Float[np.ndarray, "m 3"], Int[np.ndarray, " f"]]:
    """The distinct linear colours of a part, and which one each face has.

    8-bit colours are taken as sRGB, an MTL file's `Kd` as linear.
    """
    if visual.kind in ("vertex", "face"):
        codes = visual.face_colors[:, :3].astype(np.int32)
        if visual.kind == "vertex" and (visual.vertex_colors != visual.vertex_colors[0]).any():
            notes["vertex colours are averaged over each face"] = None
        distinct, rows = np.unique(codes @ np.array([65536, 256, 1], np.int32), return_inverse=True)
        encoded = np.stack([distinct >> 16, distinct >> 8 & 255, distinct & 255], axis=-1).astype(np.float32) / 255
        return srgb_to_linear(encoded), rows.astype(np.int32)
    material = getattr(visual, "material", None)
    if getattr(material, "image", None) is not None:
        notes["textures are ignored"] = None
    diffuse = getattr(material, "kwargs", {}).get("kd", GREY)
    color = np.broadcast_to(np.array(diffuse, np.float32), 3)
    if not np.isfinite(color).all():
        raise ValueError(f"its colour Kd is {diffuse}")
    return np.clip(color, 0, 1)[None], np.zeros(num_faces, np.int32)


def _read_part(part: dict, file: str, notes: dict) -> tuple[Piece, Float[np.ndarray, "m 3"]]:
    """One of trimesh's meshes, and the colours that its faces' materials count through."""
    import trimesh

    try:
        mesh = trimesh.Trimesh(**part, process=False)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
        if vertices.shape[1:] != (3,):
            raise ValueError(f"its vertices have {vertices.shape[1]} coordinates, not 3")
        palette, material = _read_colors(mesh.visual, len(faces), notes)
        uvs = getattr(mesh.visual, "uv", None)
    except Exception as error:
        raise InputError(file, "", f"has a mesh that is broken: {error}; export it again") from error
    if bad := int((~(np.abs(vertices) < LARGEST)).any(axis=1).sum()):
        message = f"{bad} of {len(vertices)} vertices are not finite or beyond {LARGEST:g} m; export the mesh again"
        raise InputError(file, "", message)
    if wrong := [i for i in (faces.min(initial=0), faces.max(initial=0)) if not 0 <= i < len(vertices)]:
        raise InputError(file, "", f"index {wrong[0]} but only {len(vertices)} vertices; export the mesh again")
    normals = np.asarray(part.get("vertex_normals", np.zeros_like(vertices)), np.float64)
    normals = np.where(np.isfinite(normals).all(axis=1, keepdims=True), normals, 0.0)
    # These formats count v up from the bottom of the image.
    uvs = np.zeros((len(vertices), 2)) if uvs is None else np.asarray(uvs)[:, :2] * (1, -1) + (0, 1)
    return Piece(vertices, unit(normals), np.zeros((len(vertices), 4)), uvs, faces, material), palette


def read_mesh(path: Path) -> Asset:
    """Read all triangles of an OBJ, PLY, STL or OFF file as smooth dielectrics, grey unless the file gives colours.

    Vertices stay as they are; normals the file does not give are means over the triangles that share a vertex. Both
    sides of a face are drawn, since these formats leave open which one is outside.
    """
    file, data = os.fspath(path), read_file(path)
    suffix, notes = os.path.splitext(file)[1].lower(), {}
    pieces, rows = [], []
    for part in _parse(data, file, suffix, notes):
        if len(part.get("faces", ())):
            piece, palette = _read_part(part, file, notes)
            pieces.append(piece._replace(material=piece.material + len(rows)))
            rows += [{"base_color": (*color, 1.0), "double_sided": True} for color in palette.tolist()]

    count = sum(len(piece.faces) for piece in pieces)
    claim = re.search(_FACE_COUNT.get(suffix, rb"(?!)"), data)
    if claim and count < int(claim[1]):
        raise InputError(file, "", f"claims {int(claim[1])} faces, but {count} were found; it may be cut off")
    if not count:
        raise InputError(file, "", "contains no triangles; it may be cut off")
    materials = stack_materials(rows)
    mesh = join_pieces(pieces, materials.normal_texture, file)
    return Asset(mesh, materials, pack_textures([]), None, (), tuple(notes))
