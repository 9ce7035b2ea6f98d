"""OBJ and OFF files as polygons with plain colours.

Source: Wavefront, "Advanced Visualizer", appendix B1, "Object Files (.obj)"; Geomview, "Object File Format: OFF".
"""

import codecs
import os
import re
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..errors import InputError
from .disk import lies_beside, read_file
from .image import srgb_to_linear
from .reading import Reading

Line = tuple[int, list[str]]  # its number and its words
Color = tuple[float, float, float]
GREY = (0.5, 0.5, 0.5)  # linear, for what has no colour of its own
WHITE = (1.0, 1.0, 1.0)  # for what has, but at its vertices
FEWEST = {"v": 3, "vt": 1, "vn": 3}  # numbers on such a line of an OBJ file
MOST_QUOTED = 60  # characters of a file's words that a message repeats
MOST_PATH = 4096  # characters of a library's name, as many as a path may have on Linux
MOST_LIBRARIES = 1000  # words on all `mtllib` lines: to look for a file takes 0.1 ms
TEXTURES = ("map_", "bump", "decal", "disp", "norm", "refl")  # how lines of an MTL file begin that name one


class Polygons(NamedTuple):
    """Faces as a file holds them: the corners of all, one after the other, and how many of them each face has.

    A corner is a row of the vertices; any other number is a vertex that is not there. `where` says where a face is in
    the file, `where_vertex` where a vertex is, and `wrong` what is wrong with such a corner.
    """

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    uvs: Float[np.ndarray, "v 2"]
    colors: Float[np.ndarray, "v 4"] | None
    corners: Int[np.ndarray, " c"]
    sizes: Int[np.ndarray, " f"]
    material: Int[np.ndarray, " f"]
    palette: list[Color]
    where: Callable[[int], str]
    where_vertex: Callable[[int], str]
    wrong: Callable[[int], str]


def quote(text: str) -> str:
    """The beginning of what a file says, with no line break or control code that could disturb a terminal."""
    return repr(text[:MOST_QUOTED])


def decode(data: bytes) -> str:
    """A text in any encoding: all that counts in these formats is ASCII."""
    encoding = "utf-16" if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"
    return data.decode(encoding, errors="replace")


def _lines(data: bytes, file: str, where: str = "") -> Iterator[Line]:
    """Each line that has words, without comments; a backslash at its end joins it to the next."""
    text, words = decode(data), []
    if "\0" in text:
        raise InputError(file, where, "holds zero bytes, so it is no text; export it again")
    # Add an empty line, so that a backslash at the end of the file swallows nothing.
    for number, line in enumerate([*text.splitlines(), ""], 1):
        if "#" in line:
            line = re.split(r"(?:^|\s)#", line, maxsplit=1)[0]
        words += line.removesuffix("\\").split()
        if words and not line.endswith("\\"):
            yield number, words
            words = []


def _numbers(words: list[str], fewest: int, file: str, where: str) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) < fewest:
        raise InputError(file, where, f"{quote(' '.join(words))} is not {fewest} or more numbers; export it again")
    return numbers


def _index(word: str) -> int:
    """A whole number, or -1 for anything that cannot count rows."""
    return int(word) if word.isdecimal() and len(word) < 18 else -1


def to_linear(colors, file: str, reading: Reading) -> Float[np.ndarray, "n 4"]:
    """Linear RGBA of sRGB colours in [0, 1], or in 8 bits where they are integers; the alpha of these is ignored.

    NaN becomes 0, and infinity the nearest bound.
    """
    colors = np.asarray(colors)[:, :3]
    if bad := int((~np.isfinite(colors)).any(axis=1).sum()):
        reading.mend(file, "", f"{bad} of {len(colors)} colours are not finite; they are brought into [0, 1]")
    encoded = np.nan_to_num(colors) if colors.dtype.kind == "f" else colors / 255
    return np.append(srgb_to_linear(encoded.clip(0, 1)), np.ones((len(colors), 1)), axis=1)


def _locate(name: str, file: str) -> str | None:
    """The path of a library beside or below an OBJ file, links followed; none for one that lies elsewhere."""
    path = os.path.join(os.path.dirname(file), name.replace("\\", "/")[:MOST_PATH])
    return os.path.realpath(path) if lies_beside(path, file) else None


def _library_names(line: str, file: str) -> list[str]:
    """The names on an `mtllib` line: the whole of it, which may have spaces, unless only single words are files."""
    whole, *paths = [_locate(name, file) or "" for name in (line, *line.split())]
    return [line] if os.path.isfile(whole) or not any(map(os.path.isfile, paths)) else line.split()


def _read_libraries(lines: Iterable[str], file: str, reading: Reading) -> dict[str, Color]:
    """The linear colours of the materials in all files on `mtllib` lines, each read once."""
    colors, read, num_words = {}, set(), 0
    for line in lines:
        num_words += len(line.split())
        if num_words > MOST_LIBRARIES:
            reading.ignore(f"material libraries beyond {MOST_LIBRARIES} words are ignored", quote(line))
            break
        for name in _library_names(line, file):
            path = _locate(name, file)
            if path is None:
                reading.ignore("material libraries lie outside the file's folder", quote(name))
            elif path not in read:
                read.add(path)
                colors |= _read_library(name, path, file, reading)
    return colors


def _read_library(name: str, path: str, file: str, reading: Reading) -> dict[str, Color]:
    """The linear colours `Kd` of the materials in an MTL file."""
    try:
        data = read_file(path, reading.limits)
    except InputError as error:
        is_there = os.path.exists(path)
        reading.ignore(
            f"a material library {error.message}" if is_there else "material libraries are missing", quote(name)
        )
        return {}

    colors, material = {}, ""
    for number, (key, *words) in _lines(data, file, quote(name)):
        value, where = " ".join(words), f"{quote(name)} line {number}"
        if key == "newmtl":
            material = value
            colors[material] = GREY
        elif key.lower().startswith(TEXTURES):
            reading.ignore("textures are ignored", quote(value))
        elif key.lower() == "kd" and words[:1] in (["spectral"], ["xyz"]):
            reading.ignore("colours as a spectrum or in CIE XYZ are ignored", where)
        elif key.lower() == "kd":
            # One number stands for three.
            color = np.resize(_numbers(words[:3], 3 if len(words) > 1 else 1, file, where), 3)
            if not np.isfinite(color).all():
                reading.drop(file, where, f"Kd is {quote(value)}", "a colour")
                continue
            if (color != color.clip(0, 1)).any():
                reading.mend(file, where, f"Kd {quote(value)} is clamped to [0, 1]")
            colors[material] = tuple(color.clip(0, 1).tolist())
    return colors


def _absolute(corner: str, counts: list[int]) -> str:
    """A corner `v/vt/vn` whose negative indices, which count back from the last row so far, count from the first."""
    indices = []
    for index, count in zip(corner.split("/"), counts):
        back = _index(index[1:]) if index.startswith("-") else 0
        indices.append(str(count + 1 - back) if 0 < back <= count else index)
    return "/".join(indices)


def _rows(corners: list[str], counts: list[int]) -> tuple[Int[np.ndarray, "n 3"], Bool[np.ndarray, "n 3"]]:
    """Rows of vertex, texture coordinate and normal, from 1 on, that corners name, and which of them are not there.

    0 stands for what a corner leaves out and for what is not there.
    """
    words = (f"{corner}//".split("/")[:3] for corner in corners)
    rows = np.array([[(_index(w) or -1) if w else 0 for w in three] for three in words], np.int64).reshape(-1, 3)
    wrong = (rows < 0) | (rows > counts)
    return np.where(wrong, 0, rows), wrong


def read_obj(data: bytes, file: str, reading: Reading) -> Polygons:
    """All faces of an OBJ file, with the colours of its materials and vertices.

    Every distinct corner `v/vt/vn` becomes a vertex. Groups, smoothing, lines and points are passed over.
    """
    given, vertex_at, libraries = {key: [] for key in FEWEST}, [], {}
    ids, corners, sizes, at = {}, [], [], []
    used, material, current = {}, [], ""
    for number, (key, *words) in _lines(data, file):
        if key in given:
            # Three numbers of colour may follow a vertex.
            given[key].append(_numbers(words[:6], FEWEST[key], file, f"line {number}"))
            if key == "v":
                vertex_at.append(number)
        elif key == "f":
            if any("-" in word for word in words):
                words = [_absolute(word, [*map(len, given.values())]) for word in words]
            corners += [ids.setdefault(word, len(ids)) for word in words]
            sizes.append(len(words))
            at.append(number)
            material.append(used.setdefault(current, len(used)))
        elif key == "usemtl":
            current = " ".join(words)
        elif key == "mtllib":
            libraries[" ".join(words)] = None

    names, corners, sizes = [*ids], np.array(corners, np.int64), np.array(sizes, np.int64)
    rows, wrong = _rows(names, [*map(len, given.values())])
    for face in np.unique(np.repeat(np.arange(len(sizes)), sizes)[wrong[corners, 1:].any(axis=1)]).tolist():
        reading.mend(file, f"line {at[face]}", "texture coordinates or normals that are not there are left out")
    colors = _read_libraries(libraries, file, reading)
    for name in used:
        if name and name not in colors:
            reading.ignore("materials are missing", quote(name))
    there = rows[:, 0] > 0
    vertex, uv, normal = rows[there].T
    colored = [row[3:] for row in given["v"] if len(row) == 6]
    all_colored = 0 < len(colored) == len(given["v"])
    return Polygons(
        # Begin with what row 0 stands for.
        vertices=np.array([(0.0, 0.0, 0.0), *(row[:3] for row in given["v"])])[vertex],
        normals=np.array([(0.0, 0.0, 0.0), *(row[:3] for row in given["vn"])])[normal],
        uvs=np.array([(0.0, 1.0), *((*row, 0.0)[:2] for row in given["vt"])])[uv],
        colors=to_linear(colored, file, reading)[vertex - 1] if all_colored else None,
        corners=np.where(there, np.cumsum(there) - 1, -1)[corners],
        sizes=sizes,
        material=np.array(material, np.int64),
        palette=[colors.get(name, WHITE if all_colored else GREY) for name in used],
        where=lambda face: f"line {at[face]}",
        where_vertex=lambda row: f"line {vertex_at[vertex[row] - 1]}",
        wrong=lambda corner: f"corner {names[corners[corner]]:.40} is none of the {len(given['v'])} vertices from 1 on",
    )


def _off_lines(data: bytes, file: str, reading: Reading) -> tuple[list[Line], list[Line]]:
    """The lines of an OFF file that hold vertices, and those that hold faces; the keyword may be left out."""
    lines = list(_lines(data, file))
    words = [word for _, words in lines[:2] for word in words][:3] or [""]
    keyword = words.pop(0) if _index(words[0]) < 0 else "OFF"
    vertices, faces = [*map(_index, words), -1, -1][:2]
    if keyword not in ("OFF", "COFF") or min(vertices, faces) < 0:
        raise InputError(file, "", "does not begin with OFF and the counts of vertices and faces; export it again")
    if keyword == "COFF":
        reading.ignore("vertex colours are ignored")
    # The counts stand on the keyword's line or have their own.
    lines = lines[2 if lines[0][1] == [keyword] else 1 :]
    if vertices + faces > len(lines):
        claim = f"claims {vertices} vertices and {faces} faces, but {len(lines)} lines follow"
        raise InputError(file, "", f"{claim}; it may be cut off")
    return lines[:vertices], lines[vertices : vertices + faces]


def read_off(data: bytes, file: str, reading: Reading) -> Polygons:
    """All faces of an OFF file, grey; a face with fewer corners than it says has none."""
    points, faces = _off_lines(data, file, reading)
    vertices = [_numbers(words[:3], 3, file, f"line {number}") for number, words in points]
    counts = [_index(words[0]) for _, words in faces]
    rings = [words[1 : 1 + count] if 0 <= count < len(words) else [] for count, (_, words) in zip(counts, faces)]
    names = [word for ring in rings for word in ring]
    return Polygons(
        vertices=np.array(vertices).reshape(-1, 3),
        normals=np.zeros((len(vertices), 3)),
        uvs=np.tile((0.0, 1.0), (len(vertices), 1)),
        colors=None,
        corners=np.array([*map(_index, names)], np.int64),
        sizes=np.array([*map(len, rings)], np.int64),
        material=np.zeros(len(rings), np.int64),
        palette=[GREY],
        where=lambda face: f"line {faces[face][0]}",
        where_vertex=lambda row: f"line {points[row][0]}",
        wrong=lambda corner: f"corner {names[corner]:.40} is none of the {len(vertices)} vertices from 0 on",
    )
