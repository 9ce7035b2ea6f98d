"""OBJ, PLY, STL and OFF files as a mesh of plain coloured materials; trimesh parses PLY and STL."""

import io
import logging
import os
import re
import warnings

import numpy as np
from jaxtyping import Float, Int

from ..errors import InputError
from ..stack import pack_textures, stack_materials
from .asset import LARGEST, Asset, Piece, join_pieces, unit
from .disk import Path, read_file, suffix_of
from .obj import GREY, WHITE, Polygons, decode, quote, read_obj, read_off, to_linear
from .reading import Reading, exceed


def _ply(data: bytes) -> tuple[bytes, int]:
    """A PLY file with its header as UTF-8, and how many faces that claims."""
    header, end, body = data.partition(b"end_header")
    header = decode(header).encode()
    claim = re.search(rb"\nelement\s+face\s+(\d{1,18})\s", header)
    return header + end + body, int(claim[1]) if claim else 0


def _stl(data: bytes, file: str) -> tuple[bytes, int]:
    """An STL file, as UTF-8 if it is a text, and how many faces it claims."""
    count = int.from_bytes(data[80:84], "little")
    if len(data) == 84 + 50 * count:
        return data, count
    text = decode(data)
    if text.lstrip()[:5].lower() != "solid":
        claim = f"claims {count} faces, which take {84 + 50 * count} bytes, but has {len(data)}"
        raise InputError(file, "", f"{claim}; it may be cut off")
    return text.encode(), len(re.findall(r"(?im)^[ \t]*facet\b", text))


def _parse(data: bytes, suffix: str) -> list[dict]:
    """The parts of a PLY or STL file that have faces, as trimesh's loaders return them, before its classes mend any."""
    from trimesh.exchange.load import mesh_loaders

    # Keep tracebacks of what is said here in one line off the terminal; whoever set up logging still gets them.
    if not logging.getLogger("trimesh").handlers:
        logging.getLogger("trimesh").addHandler(logging.NullHandler())
    with warnings.catch_warnings():
        # NumPy only warns of text among numbers, and goes on with those before it.
        warnings.filterwarnings("error", "string or file could not be read")
        # Keep vertices whole at seams of the texture, which is ignored.
        loaded = mesh_loaders[suffix[1:]](io.BytesIO(data), skip_materials=True, fix_texture=False)
    parts = loaded["geometry"].values() if "geometry" in loaded else [loaded]
    return [part for part in parts if len(part.get("faces", ()))]


def _read_parts(data: bytes, file: str, reading: Reading) -> Polygons:
    """All solids of a PLY or STL file as one."""
    suffix = suffix_of(file)
    data, claim = _stl(data, file) if suffix == ".stl" else _ply(data)
    if claim > len(data):
        raise InputError(file, "", f"claims {claim} faces, but has only {len(data)} bytes; it may be cut off")
    try:
        parts = _parse(data, suffix)
        start = np.cumsum([0, *(len(part["vertices"]) for part in parts)])
        vertices = np.concatenate([np.zeros((0, 3)), *(part["vertices"] for part in parts)])
        faces = [np.asarray(part["faces"]).astype(np.int64) + first for part, first in zip(parts, start)]
        faces = np.concatenate(faces) if faces else np.zeros((0, 3), np.int64)
    # The loaders raise whatever their parsing stumbles over.
    except Exception as error:
        reason = quote(str(error) or type(error).__name__)
        raise InputError(file, "", f"is not a readable {suffix} file: {reason}; export it again") from error
    if len(faces) < claim:
        raise InputError(file, "", f"claims {claim} faces, but {len(faces)} were found; it may be cut off")
    if texture := re.search(rb"\ncomment\s+TextureFile\s+([^\r\n]+)", data):
        reading.ignore("textures are ignored", quote(texture[1].decode(errors="replace")))

    # Only PLY has more than vertices and faces, and it has one part.
    part = parts[0] if parts else {}
    colors, painted = part.get("vertex_colors"), part.get("face_colors")
    palette, material = np.array([GREY if colors is None else WHITE]), np.zeros(len(faces), np.int64)
    if painted is not None and len(painted) == len(faces):
        palette, material = np.unique(to_linear(painted, file, reading)[:, :3], axis=0, return_inverse=True)
        colors = None
    elif painted is not None:
        reading.ignore("face colours are ignored, since some faces have more corners than others")
    return Polygons(
        vertices=vertices,
        normals=np.asarray(part.get("vertex_normals", np.zeros_like(vertices)), np.float64),
        uvs=np.asarray(getattr(part.get("visual"), "uv", np.tile((0.0, 1.0), (len(vertices), 1))), np.float64),
        colors=None if colors is None else to_linear(colors, file, reading),
        corners=faces.ravel(),
        sizes=np.full(len(faces), faces.shape[1]),
        material=material.reshape(-1),
        palette=[*map(tuple, palette.tolist())],
        where=lambda face: f"face {face}",
        where_vertex=lambda row: f"vertex {row}",
        wrong=lambda corner: f"corner {faces.ravel()[corner]} is none of the {len(vertices)} vertices",
    )


def _drop_broken(raw: Polygons, file: str, reading: Reading) -> Polygons:
    """Leave out faces that have too few corners or a vertex that is not there or too far, then vertices of no face."""
    face = np.repeat(np.arange(len(raw.sizes)), raw.sizes)
    gone = (raw.corners < 0) | (raw.corners >= len(raw.vertices))
    broken = (raw.sizes < 3) | (np.bincount(face, gone, len(raw.sizes)) > 0)
    if broken.any():
        first = int(broken.argmax())
        corner = np.flatnonzero(gone & (face == first))[:1]
        wrong = raw.wrong(corner[0]) if len(corner) else f"a face has {raw.sizes[first]} corners, not 3 or more"
        reading.drop(file, raw.where(first), wrong, f"{broken.sum()} of {len(broken)} faces")

    far = np.any(~(np.abs(raw.vertices) < LARGEST), axis=1)
    beyond = np.append(far, True)[np.where(gone, -1, raw.corners)]
    lost = ~broken & (np.bincount(face, beyond, len(raw.sizes)) > 0)
    if far.any():
        wrong = f"{far.sum()} of {len(far)} vertices are not finite or beyond {LARGEST:g} m"
        reading.drop(file, raw.where_vertex(int(far.argmax())), wrong, f"{lost.sum()} of {(~broken).sum()} faces")

    if not (broken.any() or far.any()):
        return raw
    keep = ~(broken | lost)
    used, corners = np.unique(raw.corners[keep[face]], return_inverse=True)
    colors = None if raw.colors is None else raw.colors[used]
    arrays = {name: getattr(raw, name)[used] for name in ("vertices", "normals", "uvs")}
    return raw._replace(**arrays, colors=colors, corners=corners, sizes=raw.sizes[keep], material=raw.material[keep])


def _fan(raw: Polygons) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, " t"]]:
    """Triangles (0, i, i + 1) of each face, and which face each is from."""
    counts = raw.sizes - 2
    owner = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(len(owner)) - (np.cumsum(counts) - counts)[owner]
    first = (np.cumsum(raw.sizes) - raw.sizes)[owner]
    return raw.corners[np.stack([first, first + step + 1, first + step + 2], axis=1)], owner


def _bounded(rows: Float[np.ndarray, "v c"], what: str, file: str, reading: Reading) -> Float[np.ndarray, "v c"]:
    """Rows in which numbers whose squares are none become 0, as good as missing."""
    fine = np.abs(rows) < LARGEST
    if bad := int((~fine).any(axis=1).sum()):
        reading.mend(file, "", f"{bad} of {len(rows)} {what} are not finite or beyond {LARGEST:g}; they become 0")
    return np.where(fine, rows, 0.0)


def read_mesh(path: Path, reading: Reading | None = None) -> Asset:
    """Read all triangles of an OBJ, PLY, STL or OFF file as smooth dielectrics, grey unless the file gives colours.

    Vertices stay as they are; normals the file does not give are means over the triangles that share a vertex. Both
    sides of a face are drawn, since these formats leave open which one is outside. A polygon becomes a fan around its
    first corner, which fills it exactly if it is convex. Colours of vertices and faces are taken as sRGB, an MTL
    file's `Kd`, which those of vertices multiply, as linear.
    """
    reading = reading or Reading()
    file, data = os.fspath(path), read_file(path, reading.limits)
    suffix = suffix_of(file)
    read = {".obj": read_obj, ".off": read_off}.get(suffix, _read_parts)
    raw = _drop_broken(read(data, file, reading), file, reading)
    count = int((raw.sizes - 2).sum())
    if count > reading.limits.triangles:
        exceed("triangles", reading.limits.triangles, file, "", f"has {count} triangles")
    if not count:
        raise InputError(file, "", "contains no triangles, and points and lines are not drawn; it may be cut off")

    faces, owner = _fan(raw)
    normals = _bounded(raw.normals, "normals", file, reading)
    uvs = _bounded(raw.uvs, "texture coordinates", file, reading)
    no_tangents = np.zeros((len(normals), 4))
    # These formats count v up from the bottom of the image.
    uvs = uvs * (1, -1) + (0, 1)
    piece = Piece(raw.vertices, unit(normals), no_tangents, uvs, faces, raw.material[owner], colors=raw.colors)
    materials = stack_materials(
        [{"base_color": color, "roughness": 0.5, "double_sided": True} for color in raw.palette]
    )
    mesh = join_pieces([piece], materials)
    return Asset(mesh, materials, pack_textures([]), None, (), reading.notes())
