"""OBJ and OFF files as polygons with plain colours; an OFF file is read as the OBJ file that says the same.

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
from .disk import read_file
from .image import srgb_to_linear
from .reading import Reading

Line = tuple[int, list[str]]  # its number and its words
Color = tuple[float, float, float]
GREY = (0.5, 0.5, 0.5)  # linear, for what has no colour of its own
WHITE = (1.0, 1.0, 1.0)  # for what has, but at its vertices
FEWEST = {"v": 3, "vt": 1, "vn": 3}  # numbers on such a line of an OBJ file
TEXTURES = ("map_", "bump", "decal", "disp", "norm", "refl")  # how lines of an MTL file begin that name one


class Polygons(NamedTuple):
    """Faces as a file holds them: the corners of all, one after the other, and how many of them each face has.

    A corner is a row of the vertices; any other number is a vertex that is not there. `where` says where a face is in
    the file, and `wrong` what is wrong with such a corner.
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
    wrong: Callable[[int], str]


def decode(data: bytes) -> str:
    """A text in any encoding: all that counts in these formats is ASCII."""
    encoding = "utf-16" if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"
    return data.decode(encoding, errors="replace")


def _lines(data: bytes, file: str) -> Iterator[Line]:
    """Each line that has words, without comments; a backslash at its end joins it to the next."""
    text, words = decode(data), []
    if "\0" in text:
        raise InputError(file, "", "holds zero bytes, so it is no text; export it again")
    # Add an empty line, so that a backslash at the end of the file swallows nothing.
    for number, line in enumerate([*text.splitlines(), ""], 1):
        if "#" in line:
            line = re.split(r"(?:^|\s)#", line, maxsplit=1)[0]
        words += line.removesuffix("\\").split()
        if words and not line.endswith("\\"):
            yield number, words
            words = []


def _numbers(words: list[str], fewest: int, file: str, line: int) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) < fewest:
        found = " ".join(words)[:60]
        raise InputError(file, f"line {line}", f"{found!r} is not {fewest} or more numbers; export it again")
    return numbers


def _index(word: str) -> int:
    """A whole number, or -1 for anything that cannot count rows."""
    return int(word) if word.isdecimal() and len(word) < 18 else -1


def to_linear(colors) -> Float[np.ndarray, "n 4"]:
    """Linear RGBA of sRGB colours in [0, 1], or in 8 bits where they are integers; the alpha of these is ignored."""
    colors = np.asarray(colors)[:, :3]
    encoded = np.nan_to_num(colors) if colors.dtype.kind == "f" else colors / 255
    return np.append(srgb_to_linear(encoded.clip(0, 1)), np.ones((len(colors), 1)), axis=1)


def _read_library(name: str, file: str, reading: Reading) -> dict[str, Color]:
    """The linear colours `Kd` of the materials in an MTL file beside or below an OBJ file."""
    path = os.path.normpath(name.replace("\\", "/"))
    if os.path.isabs(path) or path.split(os.sep)[0] == os.pardir:
        reading.ignore(f"material library {name} lies outside the file's folder")
        return {}
    path = os.path.join(os.path.dirname(file), path)
    try:
        data = read_file(path, reading.limits)
    except InputError as error:
        reading.ignore(f"material library {name} {error.message if os.path.exists(path) else 'is missing'}")
        return {}

    colors, material = {}, ""
    for number, (key, *words) in _lines(data, path):
        value, where = " ".join(words), f"line {number}"
        if key == "newmtl":
            material = value
            colors[material] = GREY
        elif key.lower().startswith(TEXTURES):
            reading.ignore("textures are ignored", value)
        elif key.lower() == "kd":
            # One number stands for three.
            color = np.resize(_numbers(words[:3], 3 if len(words) > 1 else 1, path, number), 3)
            if not np.isfinite(color).all():
                reading.drop(path, where, f"Kd is {value:.40}", "a colour")
                continue
            if (color != color.clip(0, 1)).any():
                reading.mend(path, where, f"Kd {value:.40} is clamped to [0, 1]")
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


def _polygons(lines: Iterable[Line], file: str, reading: Reading) -> Polygons:
    """Every distinct corner `v/vt/vn` becomes a vertex. Groups, smoothing, lines and points are passed over."""
    given = {key: [] for key in FEWEST}
    ids, corners, sizes, at = {}, [], [], []
    colors, used, material, current = {}, {}, [], ""
    for number, (key, *words) in lines:
        if key in given:
            # Three numbers of colour may follow a vertex.
            given[key].append(_numbers(words[:6], FEWEST[key], file, number))
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
            colors |= _read_library(" ".join(words), file, reading)

    names, corners, sizes = [*ids], np.array(corners, np.int64), np.array(sizes, np.int64)
    rows, wrong = _rows(names, [*map(len, given.values())])
    for face in np.unique(np.repeat(np.arange(len(sizes)), sizes)[wrong[corners, 1:].any(axis=1)]).tolist():
        reading.mend(file, f"line {at[face]}", "texture coordinates or normals that are not there are left out")
    for name in used:
        if name and name not in colors:
            reading.ignore("materials are missing", name)
    there = rows[:, 0] > 0
    vertex, uv, normal = rows[there].T
    colored = [row[3:] for row in given["v"] if len(row) == 6]
    all_colored = 0 < len(colored) == len(given["v"])
    return Polygons(
        # Begin with what row 0 stands for.
        vertices=np.array([(0.0, 0.0, 0.0), *(row[:3] for row in given["v"])])[vertex],
        normals=np.array([(0.0, 0.0, 0.0), *(row[:3] for row in given["vn"])])[normal],
        uvs=np.array([(0.0, 1.0), *((*row, 0.0)[:2] for row in given["vt"])])[uv],
        colors=to_linear(colored)[vertex - 1] if all_colored else None,
        corners=np.where(there, np.cumsum(there) - 1, -1)[corners],
        sizes=sizes,
        material=np.array(material, np.int64),
        palette=[colors.get(name, WHITE if all_colored else GREY) for name in used],
        where=lambda face: f"line {at[face]}",
        wrong=lambda corner: f"corner {names[corners[corner]]:.40} is none of the {len(given['v'])} vertices from 1 on",
    )


def _off_lines(data: bytes, file: str, reading: Reading) -> Iterator[Line]:
    """The lines of an OFF file as those of an OBJ file that says the same; colours are left out."""
    lines = list(_lines(data, file))
    keyword, *counts = [word for _, words in lines[:2] for word in words][:3] or [""]
    vertices, faces = [*map(_index, counts), -1, -1][:2]
    if keyword not in ("OFF", "COFF") or min(vertices, faces) < 0:
        raise InputError(file, "", "does not begin with OFF and the counts of vertices and faces; export it again")
    if keyword == "COFF":
        reading.ignore("vertex colours are ignored")
    # The counts stand on the first line or have their own.
    lines = lines[1 if len(lines[0][1]) > 1 else 2 :]
    if vertices + faces > len(lines):
        claim = f"claims {vertices} vertices and {faces} faces, but {len(lines)} lines follow"
        raise InputError(file, "", f"{claim}; it may be cut off")
    for number, words in lines[:vertices]:
        yield number, ["v", *words[:3]]
    for number, (size, *words) in lines[vertices : vertices + faces]:
        is_whole = 0 <= _index(size) <= len(words)
        yield number, ["f", *(str(_index(word) + 1) for word in words[: _index(size)] if is_whole)]


def read_obj(data: bytes, file: str, reading: Reading) -> Polygons:
    """All faces of an OBJ file, with the colours of its materials and vertices."""
    return _polygons(_lines(data, file), file, reading)


def read_off(data: bytes, file: str, reading: Reading) -> Polygons:
    """All faces of an OFF file, grey."""
    return _polygons(_off_lines(data, file, reading), file, reading)
