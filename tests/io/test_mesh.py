"""OBJ, PLY, STL and OFF: what they hold comes back with its colours, and broken files are one clear line."""

import os
import pathlib
import struct
import time
import tracemalloc
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from watch import SOON

from jaxraster.errors import Error, InputError, LimitError
from jaxraster.io import mesh as module
from jaxraster.io import obj as obj_module
from jaxraster.io.mesh import read_mesh
from jaxraster.io.obj import GREY
from jaxraster.io.reading import Limits, Reading

# A corner of a cube: two triangles at a right angle along the x axis, counter-clockwise from outside.
POINTS = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, -1]], np.float32)
FACES = [(0, 1, 2), (0, 3, 1)]
NORMALS = [(0, 0, 1), (0, -1, 0)]


def obj(tail: str = "f 1 2 3\nf 1 4 2\n") -> bytes:
    return ("".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in POINTS) + tail).encode()


def off() -> bytes:
    lines = ["OFF", "4 2 0", *(f"{x:g} {y:g} {z:g}" for x, y, z in POINTS), *(f"3 {a} {b} {c}" for a, b, c in FACES)]
    return "\n".join(lines).encode()


def ply(kind: str = "ascii", columns: dict | None = None, faces=FACES, num_faces: int | None = None) -> bytes:
    """PLY with extra vertex columns, each a type's name and four numbers."""
    columns = columns or {}
    extra = "".join(f"property {t} {name}\n" for name, (t, _) in columns.items())
    header = (
        f"ply\nformat {kind} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n{extra}"
        f"element face {len(faces) if num_faces is None else num_faces}\n"
        "property list uchar int vertex_indices\nend_header\n"
    ).encode()
    values = [values for _, values in columns.values()]
    if kind == "ascii":
        rows = [[*point, *(v[i] for v in values)] for i, point in enumerate(POINTS)] + [[len(f), *f] for f in faces]
        return header + "".join(" ".join(f"{x:g}" for x in row) + "\n" for row in rows).encode()
    order = "<" if "little" in kind else ">"
    formats = order + "fff" + "".join({"uchar": "B", "float": "f"}[t] for t, _ in columns.values())
    body = b"".join(struct.pack(formats, *p, *(v[i] for v in values)) for i, p in enumerate(POINTS))
    return header + body + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)


def stl(binary: bool) -> bytes:
    corners = POINTS[np.array(FACES)]
    if binary:
        rows = b"".join(struct.pack("<12fH", *n, *c.ravel(), 0) for n, c in zip(NORMALS, corners))
        return b"x".ljust(80) + struct.pack("<I", 2) + rows
    loops = ("".join(f"vertex {x:g} {y:g} {z:g}\n" for x, y, z in c) for c in corners)
    facets = (f"facet normal {x} {y} {z}\nouter loop\n{v}endloop\nendfacet\n" for (x, y, z), v in zip(NORMALS, loops))
    return f"solid a\n{''.join(facets)}endsolid a\n".encode()


def read(folder, suffix: str, data: bytes, **rules):
    (folder / f"model{suffix}").write_bytes(data)
    return read_mesh(folder / f"model{suffix}", Reading(**rules))


def corners(mesh) -> list:
    """The points of each triangle."""
    return np.asarray(mesh.vertices)[np.asarray(mesh.faces)].tolist()


SHARED = {
    "obj": (".obj", obj()),
    "obj, upper case": (".OBJ", obj()),
    "obj, counted from the end": (".obj", obj("f -4 -3 -2\nf -4 -1 -3\n")),
    "obj, counted back from the middle": (
        ".obj",
        b"v 0 0 0\nv 2 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 -1\nf 1 -1 2\n",
    ),
    "obj, faces before their vertices": (".obj", b"f 1 2 3\nf 1 4 2\n" + obj("")),
    "obj, loosely set": (".obj", obj().replace(b" ", b"\t ").replace(b"\n", b" # etc.\r\n  ")),
    "obj, lines that go on": (".obj", obj("f 1 2 \\\n3\nf 1\\\r\n\\\n 4 2\\")),
    "obj, weights and depths": (
        ".obj",
        obj("vt 0 0 0\nvt 1\nf 1/1 2/2 3/1\nf 1/1 4/2 2/2").replace(b"2 0 0", b"2 0 0 1"),
    ),
    "obj, numbers of all kinds": (".obj", obj().replace(b"2 0 0", b"+.2E+1 0.e5 -0")),
    "obj, Latin-1": (".obj", b"# B\xfcro\n" + obj()),
    "obj, UTF-16": (".obj", obj().decode().encode("utf-16")),
    "obj, UTF-16 of the other order": (".obj", b"\xfe\xff" + obj().decode().encode("utf-16-be")),
    "obj, UTF-8 with a mark": (".obj", b"\xef\xbb\xbf" + obj()),
    "off": (".off", off()),
    "off, loosely set": (".off", off().replace(b"OFF\n", b"# made by hand\n\nOFF # \n\n").replace(b"\n", b" # \r\n")),
    "off, counts on the first line": (".off", off().replace(b"OFF\n", b"OFF ")),
    "off, no keyword": (".off", off().removeprefix(b"OFF\n")),
    "off, UTF-16": (".off", off().decode().encode("utf-16")),
    "ply": (".ply", ply()),
    "ply, Latin-1": (".ply", ply().replace(b"ascii 1.0", b"ascii 1.0\ncomment B\xfcro")),
    "ply, UTF-16": (".ply", ply().decode().encode("utf-16")),
    "ply, little": (".ply", ply("binary_little_endian")),
    "ply, big": (".ply", ply("binary_big_endian")),
}


@pytest.mark.parametrize("name", SHARED)
def test_shared_vertices(tmp_path, name):
    asset = read(tmp_path, *SHARED[name])
    mesh = asset.mesh
    np.testing.assert_array_equal(np.asarray(mesh.vertices)[np.asarray(mesh.faces)], POINTS[np.array(FACES)])
    assert mesh.vertices.shape == (4, 3)
    # The shared edge's normals are the mean of two directions, weighed by the faces' angles there.
    a, b = np.arctan2(1, 2), np.arctan2(1, 2)
    order = {tuple(p): i for i, p in enumerate(np.asarray(mesh.vertices).tolist())}
    expected = (a * np.array(NORMALS[0]) + b * np.array(NORMALS[1])) / np.hypot(a, b)
    np.testing.assert_allclose(mesh.normals[order[2, 0, 0]], expected, atol=1e-6)
    np.testing.assert_allclose(mesh.normals[order[0, 1, 0]], NORMALS[0], atol=1e-6)
    np.testing.assert_array_equal(asset.materials.base_color, np.float32([[*GREY, 1]]))
    assert (asset.materials.metallic[0], asset.materials.roughness[0]) == (0, 0.5)
    assert bool(asset.materials.double_sided[0])
    assert (asset.lights, asset.cameras, asset.notes) == (None, (), ())
    assert mesh.vertices.dtype == mesh.normals.dtype == np.float32
    assert mesh.faces.dtype == mesh.material.dtype == np.int32


@pytest.mark.parametrize("binary", [True, False])
def test_stl_is_flat(tmp_path, binary):
    mesh = read(tmp_path, ".stl", stl(binary)).mesh
    np.testing.assert_array_equal(mesh.vertices, POINTS[np.array(FACES)].reshape(6, 3))
    np.testing.assert_allclose(mesh.normals, np.repeat(NORMALS, 3, axis=0), atol=1e-6)


def test_obj_normals_and_uvs(tmp_path):
    tail = "vt 0.25 0\nvt 1 0.75\nvt 0 1\nvn 0 0 2\nvn 0 0 0\nf 1/1/1 2/2/1 3/3/2\n"
    mesh = read(tmp_path, ".obj", obj(tail)).mesh
    order = [np.asarray(mesh.vertices).tolist().index(p) for p in POINTS[:3].tolist()]
    # v counts from the bottom there, from the top here.
    np.testing.assert_array_equal(np.asarray(mesh.uvs)[order], [[0.25, 1], [1, 0.25], [0, 0]])
    np.testing.assert_allclose(np.asarray(mesh.normals)[order], np.tile([0, 0, 1], (3, 1)), atol=1e-6)


def test_ply_normals(tmp_path):
    columns = {name: ("float", [x] * 4) for name, x in zip(("nx", "ny", "nz"), (0, 0.6, 0.8))}
    for kind in ("ascii", "binary_little_endian"):
        mesh = read(tmp_path, ".ply", ply(kind, columns)).mesh
        np.testing.assert_allclose(mesh.normals, np.tile([0, 0.6, 0.8], (4, 1)), atol=1e-6)


def test_text_of_any_encoding_is_an_stl(tmp_path):
    for data in (stl(False).replace(b"solid a", b"solid B\xfcro"), stl(False).decode().encode("utf-16")):
        np.testing.assert_array_equal(corners(read(tmp_path, ".stl", data).mesh), POINTS[np.array(FACES)])


def test_all_solids_of_an_stl_are_one_mesh(tmp_path):
    moved = stl(False).replace(b"2 0 0", b"5 0 0")
    expected = [*POINTS[np.array(FACES)].tolist(), *np.where(POINTS == 2, 5, POINTS)[np.array(FACES)].tolist()]
    assert corners(read(tmp_path, ".stl", stl(False) + b"solid b\nendsolid b\n" + moved).mesh) == expected


def first_least(triangle: list) -> list:
    """The same triangle, begun at its least corner."""
    first = triangle.index(min(triangle))
    return triangle[first:] + triangle[:first]


POLYGONS = {
    ".obj": obj("v 2 1 0\nf 1 2 5 3\nf 1 4 2\n"),
    ".off": off().replace(b"4 2 0\n", b"5 2 0\n").replace(b"3 0 1 2\n3 0 3 1", b"2 1 0\n4 0 1 4 2 9 9 9\n3 0 3 1 0.5"),
    ".ply": ply(faces=[(0, 1, 4, 2), (0, 3, 1)])
    .replace(b"vertex 4", b"vertex 5")
    .replace(b"0 0 -1\n", b"0 0 -1\n2 1 0\n"),
}


@pytest.mark.parametrize("suffix", POLYGONS)
def test_polygons_become_fans(tmp_path, suffix):
    found = corners(read(tmp_path, suffix, POLYGONS[suffix]).mesh)
    square = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]]
    expected = [square[:3], [square[0], *square[2:]], POINTS[[0, 3, 1]].tolist()]
    assert sorted(map(first_least, found)) == sorted(map(first_least, expected))


@pytest.mark.parametrize("count", [4, 10_000])
def test_a_fan_covers_as_much_as_its_polygon(tmp_path, count):
    """Of a concave one (here an arrow and a star) it covers some places twice, the second time from behind."""
    angle = 2 * np.pi * np.arange(count) / count
    x, y = np.array([np.cos(angle), np.sin(angle)]) * np.where(np.arange(count) % 2, 1.0, 0.1)
    lines = "".join(f"v {a} {b} 0\n" for a, b in zip(x, y)) + "f " + " ".join(map(str, range(1, count + 1)))
    a, b, c = np.moveaxis(np.array(corners(read(tmp_path, ".obj", lines.encode()).mesh))[..., :2], 1, 0)
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    assert len(a) == count - 2
    assert 0.5 * np.sum(ux * vy - uy * vx) == pytest.approx(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)), 1e-4)


def test_faces_without_area_and_faces_twice_are_kept(tmp_path):
    mesh = read(tmp_path, ".obj", obj("f 1 1 2\nf 1 2 3\nf 1 2 3\nf 2 2 2\n")).mesh
    assert corners(mesh) == POINTS[[[0, 0, 1], [0, 1, 2], [0, 1, 2], [1, 1, 1]]].tolist()
    assert np.isfinite(mesh.normals).all()


LIBRARY = b"newmtl red\nKd 0.002 0.5 1\nnewmtl plain  one\nNs 5\nnewmtl grey\nKd 0.25\n"


def test_obj_colours(tmp_path):
    (tmp_path / "m.mtl").write_bytes(LIBRARY)
    (tmp_path / "n.mtl").write_bytes(b"newmtl blue\nkd 0 0 1\n")
    tail = "usemtl red\nf 1 2 3\nusemtl plain one \nf 1 4 2\nusemtl grey\nf 1 2 3\nusemtl blue\nf 1 2 3\n"
    asset = read(tmp_path, ".obj", b"mtllib m.mtl\nmtllib .\\n.mtl\n" + obj(tail))
    colors = np.asarray(asset.materials.base_color)[np.asarray(asset.mesh.material)]
    expected = [(0.002, 0.5, 1, 1), (*GREY, 1), (0.25, 0.25, 0.25, 1), (0, 0, 1, 1)]
    np.testing.assert_array_equal(colors, np.float32(expected))
    assert asset.mesh.colors is None
    assert asset.notes == ()


def linear_of(code: float) -> float:
    return code / 12.92 if code < 0.04045 else ((code + 0.055) / 1.055) ** 2.4


def test_colours_of_vertices(tmp_path):
    codes = np.array([[255, 0, 128], [30, 60, 90], [1, 2, 3], [0, 0, 0]])
    columns = dict(zip(("red", "green", "blue"), codes.T.tolist()))
    real = [f"v {x:g} {y:g} {z:g} {r} {g} {b}\n" for (x, y, z), (r, g, b) in zip(POINTS, codes / 255)]
    files = {
        "codes.ply": ply(columns={name: ("uchar", values) for name, values in columns.items()}),
        "real.ply": ply(columns={name: ("float", [v / 255 for v in values]) for name, values in columns.items()}),
        "real.obj": "".join([*real, "f 1 2 3\nf 1 4 2\n"]).encode(),
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        asset = read_mesh(tmp_path / name)
        order = [np.asarray(asset.mesh.vertices).tolist().index(p) for p in POINTS.tolist()]
        linear = [[*map(linear_of, (codes / 255)[i]), 1] for i in range(4)]
        np.testing.assert_allclose(np.asarray(asset.mesh.colors)[order], linear, rtol=1e-4, err_msg=name)
        np.testing.assert_array_equal(asset.materials.base_color, [[1, 1, 1, 1]])
        assert asset.notes == ()


def test_colours_of_faces(tmp_path):
    data = ply(faces=[(0, 1, 2), (0, 3, 1), (0, 1, 2)]).replace(b"end_header", b"COLORS\nend_header")
    data = data.replace(b"COLORS", b"\n".join(b"property uchar " + name for name in (b"red", b"green", b"blue")))
    data = data.replace(b"3 0 1 2\n", b"3 0 1 2 255 0 128\n").replace(b"3 0 3 1\n", b"3 0 3 1 0 0 0\n")
    asset = read(tmp_path, ".ply", data)
    red, black = (1, 0, linear_of(128 / 255), 1), (0, 0, 0, 1)
    colors = np.asarray(asset.materials.base_color)[np.asarray(asset.mesh.material)]
    np.testing.assert_allclose(colors, [red, black, red], rtol=1e-6)
    mixed = data.replace(b"3 0 3 1 0", b"4 0 3 1 2 0")
    asset = read(tmp_path, ".ply", mixed)
    np.testing.assert_array_equal(asset.materials.base_color, np.float32([[*GREY, 1]]))
    assert asset.notes == ("face colours are ignored, since some faces have more corners than others",)


def test_some_coloured_vertices_are_none(tmp_path):
    assert read(tmp_path, ".obj", obj().replace(b"2 0 0", b"2 0 0 1 0 0")).mesh.colors is None


HOSTILE = r"'\x1b[2J\x07" + "a" * 55 + "'"
SPECTRAL = "colours as a spectrum or in CIE XYZ are ignored"
NOT_FINITE = "are not finite or beyond 1.844e+18"
OUTSIDE = "material libraries lie outside the file's folder: "


@pytest.mark.parametrize(
    ("suffix", "data", "note"),
    [
        (".obj", b"mtllib gone.mtl\n" + obj(), "material libraries are missing: 'gone.mtl'"),
        (".obj", b"mtllib empty.mtl\n" + obj(), "a material library is empty; export or copy it again: 'empty.mtl'"),
        (".obj", b"mtllib .\n" + obj(), "a material library is a folder; name a file in it: '.'"),
        (".obj", b"mtllib ../m.mtl\n" + obj(), OUTSIDE + "'../m.mtl'"),
        (".obj", b"mtllib ..\\m.mtl\n" + obj(), OUTSIDE + r"'..\\m.mtl'"),
        (".obj", b"mtllib a/../../m.mtl\n" + obj(), OUTSIDE + "'a/../../m.mtl'"),
        (".obj", b"mtllib /etc/passwd\n" + obj(), OUTSIDE + "'/etc/passwd'"),
        (".obj", obj("usemtl red\nf 1 2 3\nusemtl blue\nf 1 2 3\n"), "materials are missing: 'red', 'blue'"),
        (".obj", b"mtllib m.mtl\n" + obj(), r"textures are ignored: 'C:\\my rug.png', 'bump.png'"),
        (".obj", b"mtllib far.mtl\n" + obj(), "Kd '3 -1 0.5' is clamped to [0, 1]: 'far.mtl' line 2"),
        (
            ".ply",
            ply().replace(b"ascii 1.0", b"ascii 1.0\ncomment TextureFile rug.png"),
            "textures are ignored: 'rug.png'",
        ),
        (".off", b"C" + off(), "vertex colours are ignored"),
        (".obj", b"mtllib gone.mtl far away.mtl\n" + obj(), "material libraries are missing: 'gone.mtl far away.mtl'"),
        (".obj", b"mtllib spectral.mtl\n" + obj(), f"{SPECTRAL}: 'spectral.mtl' line 2, 'spectral.mtl' line 3"),
        (".obj", obj("vt nan 0\nvt 0 inf\nf 1/1 2/2 3\n"), f"2 of 3 texture coordinates {NOT_FINITE}; they become 0"),
        (".obj", obj("vn nan 0 0\nvn 1 0 0\nf 1//1 2//2 3//2\n"), f"1 of 3 normals {NOT_FINITE}; they become 0"),
        (
            ".obj",
            b"v 0 0 0 nan 0 0\nv 1 0 0 0 0 inf\nv 0 1 0 0 0 0\nf 1 2 3\n",
            "2 of 3 colours are not finite; they are brought into [0, 1]",
        ),
        (
            ".ply",
            ply(columns={name: ("float", [np.nan, 0, 0, 0]) for name in ("red", "green", "blue")}),
            "1 of 4 colours are not finite; they are brought into [0, 1]",
        ),
        # No name of a file disturbs a terminal or fills it.
        (".obj", b"mtllib \x1b[2J\x07" + b"a" * 10**6 + b"\n" + obj(), f"material libraries are missing: {HOSTILE}"),
        (".obj", b"mtllib ../\x1b[2J" + b"a" * 10**6 + b"\n" + obj(), f"{OUTSIDE}'../\\x1b[2J{'a' * 53}'"),
        (".obj", obj("usemtl \x1b[2J\x07" + "a" * 10**6 + "\nf 1 2 3\n"), f"materials are missing: {HOSTILE}"),
        (".obj", b"mtllib hostile.mtl\n" + obj(), f"textures are ignored: {HOSTILE}"),
        (
            ".ply",
            ply().replace(b"ascii 1.0", b"ascii 1.0\ncomment TextureFile \x1b[2J\x07" + b"a" * 10**6),
            f"textures are ignored: {HOSTILE}",
        ),
    ],
)
def test_what_is_left_out_is_noted_by_name(tmp_path, suffix, data, note):
    (tmp_path / "m.mtl").write_bytes(b"newmtl a\nmap_Kd C:\\my rug.png\nbump bump.png\n")
    (tmp_path / "far.mtl").write_bytes(b"newmtl a\nKd 3 -1 0.5\n")
    (tmp_path / "empty.mtl").write_bytes(b"")
    (tmp_path / "spectral.mtl").write_bytes(b"newmtl a\nKd spectral a.rfl 0.5\nKd xyz 0.5 0.25\n")
    (tmp_path / "hostile.mtl").write_bytes(b"newmtl a\nmap_Kd \x1b[2J\x07" + b"a" * 10**6)
    assert read(tmp_path, suffix, data).notes == (note,)


def test_a_library_is_read_once(tmp_path, monkeypatch):
    """However often it is named, and under whatever name."""
    (tmp_path / "m.mtl").write_bytes(LIBRARY)
    (tmp_path / "link.mtl").symlink_to("m.mtl")
    files = []
    monkeypatch.setattr(obj_module, "read_file", lambda path, limits: (files.append(path), LIBRARY)[1])
    names = b"mtllib m.mtl\nmtllib ./m.mtl\nmtllib link.mtl\nmtllib m.mtl link.mtl\n"
    assert read(tmp_path, ".obj", names * 50 + obj("usemtl red\nf 1 2 3\n")).notes == ()
    assert files == [os.path.realpath(tmp_path / "m.mtl")]


@pytest.mark.parametrize(
    ("lines", "note"),
    [
        (b"mtllib m.mtl\n" * 100_000, None),
        (b"".join(b"mtllib %d\n" % i for i in range(100_000)), "'1000'"),
        (b"mtllib " + b"a b " * 100_000, repr(("a b " * 15)[:60])),
    ],
)
def test_no_number_of_libraries_takes_long(tmp_path, lines, note):
    began = time.process_time()
    notes = read(tmp_path, ".obj", lines + b"\n" + obj()).notes
    assert time.process_time() - began < SOON
    assert note is None or f"material libraries beyond 1000 words are ignored: {note}" in notes


def test_a_line_may_name_many_libraries_or_one_with_spaces(tmp_path):
    (tmp_path / "a.mtl").write_bytes(b"newmtl a\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_bytes(b"newmtl b\nKd 0 1 0\n")
    data = b"mtllib a.mtl b.mtl\n" + obj("usemtl a\nf 1 2 3\nusemtl b\nf 1 4 2\n")
    asset = read(tmp_path, ".obj", data)
    assert asset.materials.base_color[:, :3].tolist() == [[1, 0, 0], [0, 1, 0]]
    assert asset.notes == ()
    assert read(tmp_path, ".obj", data.replace(b"b.mtl", b"c.mtl")).notes == (
        "material libraries are missing: 'c.mtl'",
        "materials are missing: 'b'",
    )
    (tmp_path / "a.mtl b.mtl").write_bytes(b"newmtl a\nKd 0 0 1\nnewmtl b\nKd 0 0 0\n")
    assert read(tmp_path, ".obj", data).materials.base_color[:, :3].tolist() == [[0, 0, 1], [0, 0, 0]]


def test_no_link_leads_to_a_library_outside_the_folder(tmp_path):
    (tmp_path / "secret.mtl").write_bytes(LIBRARY)
    folder = tmp_path / "model"
    (folder / "below").mkdir(parents=True)
    (folder / "below" / "m.mtl").write_bytes(LIBRARY)
    (folder / "file.mtl").symlink_to("../secret.mtl")
    (folder / "folder").symlink_to("..")
    (folder / "inside.mtl").symlink_to("below/m.mtl")
    for name in ("file.mtl", "folder/secret.mtl", "folder/model2/m.mtl"):
        assert read(folder, ".obj", f"mtllib {name}\n".encode() + obj()).notes == (f"{OUTSIDE}'{name}'",)
    assert read(folder, ".obj", b"mtllib inside.mtl\n" + obj("usemtl red\nf 1 2 3\n")).notes == ()


@pytest.mark.parametrize("tail", ["vt nan 0\nf 1/1 2 3\n", "vn 0 0 inf\nf 1//1 2 3\n"])
def test_strict_forbids_what_is_not_finite(tmp_path, tail):
    with pytest.raises(InputError, match=r"1 of 3 .* they become 0, which strict forbids; export it again$"):
        read(tmp_path, ".obj", obj(tail), strict=True)


def test_what_is_not_there_beside_a_vertex_is_noted_by_line(tmp_path):
    """Texture coordinates and normals out of range cost no geometry; the other faces keep theirs."""
    tail = "vt 0.25 0\nvn 0 0 1\nf 1/1/1 2/2/1 3//-7\nf 1/1/1 4/0/1 2/1/1\nf 1/1/1 2/1/1 3/1/1\nf 1//x 2//1 3//1"
    asset = read(tmp_path, ".obj", obj(tail))
    said = "texture coordinates or normals that are not there are left out"
    assert asset.notes == (f"{said}: line 7, line 8, line 10",)
    assert corners(asset.mesh) == POINTS[[[0, 1, 2], [0, 3, 1], [0, 1, 2], [0, 1, 2]]].tolist()
    assert np.asarray(asset.mesh.uvs)[np.asarray(asset.mesh.faces)][2].tolist() == [[0.25, 1]] * 3
    np.testing.assert_allclose(np.linalg.norm(asset.mesh.normals, axis=1), 1, rtol=1e-6)
    with pytest.raises(InputError, match=f"line 7: {said}, which strict forbids; export it again"):
        read(tmp_path, ".obj", obj(tail), strict=True)


FAR = r"of 4 vertices are not finite or beyond 1\.844e\+18 m; export it again, or drop it with repair"
NO_FACES = "contains no triangles, and points and lines are not drawn; it may be cut off"
BROKEN = {
    "missing": (".obj", None, "cannot be read: No such file"),
    "empty": (".obj", b"", "is empty"),
    "only a mark": (".obj", b"\xef\xbb\xbf", NO_FACES),
    "no faces": (".obj", obj(""), NO_FACES),
    "only points": (".obj", obj("p 1 2\n"), NO_FACES),
    "only lines": (".obj", obj("l 1 2\n"), NO_FACES),
    "no corners": (".obj", obj("f\n"), "line 5: a face has 0 corners, not 3 or more; export it again"),
    "two corners": (".obj", obj("f 1 2 3\nf 1 2\n"), "line 6: a face has 2 corners, not 3 or more"),
    "cut off in a face": (".obj", obj("f 1 2 3\nf 1 2"), "line 6: a face has 2 corners"),
    "cut off in a vertex": (".obj", obj("v 1 2"), "line 5: '1 2' is not 3 or more numbers; export it again"),
    "index 0": (
        ".obj",
        obj("f 1 2 3\nf 1/1 0/2 3/1\n"),
        "line 6: corner 0/2 is none of the 4 vertices from 1 on; export",
    ),
    "index 0 at the end": (".obj", obj("f 1 2 0"), "line 5: corner 0 is none of"),
    "index beyond": (".obj", obj("f 1 2 3\nf 1 2 9\n"), "line 6: corner 9 is none of the 4 vertices"),
    "index far beyond": (".obj", obj("f 1 2 " + "9" * 5000), "line 5: corner 9{40} is none of the 4 vertices"),
    "index before": (".obj", obj("f -1 -2 -5\n"), "line 5: corner -5 is none of the 4 vertices"),
    "index before, of no number": (".obj", obj("f -1 -2 -x\n"), "line 5: corner -x is none of the 4 vertices"),
    "no vertex in a corner": (".obj", obj("vt 0 0\nf 1/1 2/1 /1\n"), "line 6: corner /1 is none of the 4 vertices"),
    "words for indices": (".obj", obj("f a b c\n"), "line 5: corner a is none of the 4 vertices"),
    "a fraction for an index": (".obj", obj("f 1 2 3.5\n"), "line 5: corner 3.5 is none of the 4 vertices"),
    "words for coordinates": (".obj", obj("\n\n  v 0 0 zero"), "line 7: '0 0 zero' is not 3 or more numbers"),
    "words for normals": (".obj", obj("vn 0 0 1,5\n"), "line 5: '0 0 1,5' is not 3 or more numbers"),
    "words for texture coordinates": (".obj", obj("vt left top\n"), "line 5: 'left top' is not 1 or more numbers"),
    "two coordinates": (".obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "line 1: '0 0' is not 3 or more numbers"),
    "not a number": (".obj", b"v 0 nan 0\n" + obj(), f"line 1: 1 {FAR}"),
    "overflow": (".obj", b"v 0 1e400 0\n" + obj(), f"line 1: 1 {FAR}"),
    "too far": (".obj", b"v 0 0 0\nv 0 1e30 0\nv 0 0 -inf\n" + obj(), f"line 2: 2 {FAR}"),
    "obj, binary": (".obj", bytes(range(128)) * 4, "holds zero bytes, so it is no text; export it again"),
    "obj, binary without zeros": (".obj", bytes(range(1, 128)) * 4, NO_FACES),
    "obj, UTF-16 without a mark": (".obj", obj().decode().encode("utf-16-le"), "holds zero bytes, so it is no text"),
    "obj, UTF-32": (".obj", obj().decode().encode("utf-32"), "holds zero bytes, so it is no text"),
    "off, junk": (".off", b"junk", "does not begin with OFF and the counts of vertices and faces"),
    "off, only comments": (".off", b"# OFF", "does not begin with OFF"),
    "off, no counts": (".off", b"OFF\n", "does not begin with OFF"),
    "off, one count": (".off", b"OFF\n4", "does not begin with OFF"),
    "off, another keyword": (".off", b"N" + off(), "does not begin with OFF"),
    "off, a count below 0": (".off", b"OFF\n4 -2 0", "does not begin with OFF"),
    "off, cut off": (".off", off()[:-8], "claims 4 vertices and 2 faces, but 5 lines follow; it may be cut off"),
    "off, cut off in a face": (".off", off()[:-2], "line 8: a face has 0 corners, not 3 or more"),
    "off, a claim": (
        ".off",
        off().replace(b"4 2 0", b"4 353535235358 0"),
        "claims 4 vertices and 353535235358 faces, but 6",
    ),
    "off, index beyond": (".off", off()[:-1] + b"7", "line 8: corner 7 is none of the 4 vertices from 0 on"),
    "off, index before": (".off", off()[:-1] + b"-1", "line 8: corner -1 is none of the 4 vertices from 0 on"),
    "off, a word for an index": (".off", off()[:-1] + b"x", "line 8: corner x is none of the 4 vertices from 0 on"),
    "off, an index far beyond": (".off", off()[:-1] + b"9" * 99, "line 8: corner 9{40} is none of the 4 vertices"),
    "off, a word for a size": (".off", off()[:-7] + b"x 0 1 2 3", "line 8: a face has 0 corners"),
    "off, words": (".off", off().replace(b"2 0 0", b"2 zero 0"), "line 4: '2 zero 0' is not 3 or more numbers"),
    "off, not a number": (".off", off().replace(b"2 0 0", b"2 nan 0"), f"line 4: 1 {FAR}"),
    "off, no faces": (".off", b"OFF\n1 0 0\n0 0 0", NO_FACES),
    "ply, junk": (".ply", b"junk", "is not a readable .ply file"),
    "ply, a claim": (
        ".ply",
        ply(num_faces=353_535_235_358),
        r"claims 353535235358 faces, but has only \d+ bytes; it may be",
    ),
    "ply, a little claim": (".ply", ply(num_faces=3), "claims 3 faces, but 2 were found; it may be cut off"),
    "ply, a claim of vertices": (
        ".ply",
        ply().replace(b"vertex 4", b"vertex 353535235358"),
        "claims 2 faces, but 0 were found",
    ),
    "ply, a claim of corners": (
        ".ply",
        ply("binary_little_endian", faces=[(7, 1, 2)]).replace(b"\3\7\0\0\0", b"\xff\7\0\0\0"),
        "is not a readable .ply file: 'PLY is unexpected length",
    ),
    "ply, cut off": (
        ".ply",
        ply("binary_little_endian")[:-4],
        "is not a readable .ply file: 'PLY is unexpected length",
    ),
    "ply, index beyond": (
        ".ply",
        ply(faces=[(0, 1, 2), (0, 1, 7)]),
        "face 1: corner 7 is none of the 4 vertices; export",
    ),
    "ply, index before": (".ply", ply(faces=[(0, 1, -1)]), "face 0: corner -1 is none of the 4 vertices"),
    "ply, two corners": (".ply", ply(faces=[(0, 1), (1, 2)]), "face 0: a face has 2 corners, not 3 or more"),
    "ply, not a number": (".ply", ply().replace(b"2 0 0\n", b"2 nan 0\n"), f"vertex 1: 1 {FAR}"),
    "ply, only points": (".ply", ply(faces=[]), NO_FACES),
    "stl, junk": (
        ".stl",
        b"junk" * 30,
        "claims 1802401130 faces, which take 90120056584 bytes, but has 120; it may be cut off",
    ),
    "stl, little junk": (".stl", b"junk", "claims 0 faces, which take 84 bytes, but has 4; it may be cut off"),
    "stl, a claim": (
        ".stl",
        stl(True).replace(struct.pack("<I", 2), b"\xff" * 4, 1),
        "claims 4294967295 faces, which take 214748364834 bytes, but has 184; it may",
    ),
    "stl, cut off": (".stl", stl(True)[:-9], "claims 2 faces, which take 184 bytes, but has 175; it may be cut off"),
    "stl, cut off text": (".stl", stl(False)[:-12], "claims 2 faces, but 0 were found; it may be cut off"),
    "stl, cut off in a second solid": (".stl", stl(False) + stl(False)[:-12], "claims 4 faces, but 2 were found"),
    "stl, words": (".stl", stl(False).replace(b"2 0 0", b"2 zero 0"), "is not a readable .stl file"),
    "stl, a million empty lines": (".stl", b"solid a" + b"\n" * 10**6 + b"endsolid", NO_FACES),
    "stl, no faces": (".stl", b"solid a\nendsolid a\n", NO_FACES),
    "stl, not a number": (
        ".stl",
        stl(True).replace(struct.pack("<f", 2), struct.pack("<f", np.nan)),
        "vertex 1: 2 of 6 vertices are not finite",
    ),
}


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """Read whole files before memory is counted: a first one imports its reader, which takes more than it."""
    for suffix, data in ((".stl", stl(False)), (".stl", stl(True)), (".ply", ply())):
        path = tmp_path_factory.mktemp("whole") / f"model{suffix}"
        path.write_bytes(data)
        read_mesh(path)


@pytest.mark.usefixtures("imported")
@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_one_line_of_words_soon_and_in_little_memory(tmp_path, name):
    suffix, data, message = BROKEN[name]
    if data is not None:
        (tmp_path / f"model{suffix}").write_bytes(data)
    began = time.process_time()
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=rf"model\{suffix}: (?:{message})") as caught:
            read_mesh(tmp_path / f"model{suffix}")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert time.process_time() - began < SOON
    assert peak < 2**24
    assert "\n" not in str(caught.value)
    assert caught.value.file == str(tmp_path / f"model{suffix}") or caught.value.file == tmp_path / f"model{suffix}"


WHOLE, SECOND = POINTS[np.array(FACES)].tolist(), POINTS[np.array(FACES[1:])].tolist()
REPAIRED = {
    "two corners": (
        ".obj",
        obj("f 1 2\nf 1 4 2\n"),
        "dropped 1 of 2 faces: a face has 2 corners, not 3 or more: line 5",
    ),
    "index 0": (
        ".obj",
        obj("f 1 2 0\nf 1 4 2\n"),
        "dropped 1 of 2 faces: corner 0 is none of the 4 vertices from 1 on: line 5",
    ),
    "index beyond": (
        ".obj",
        obj("f 1 2 9\nf 1 4 2\nf 1 8 2"),
        "dropped 2 of 3 faces: corner 9 is none of the 4 vertices from 1 on: line 5",
    ),
    "not a number": (
        ".obj",
        obj("v 0 nan 0\nf 1 2 5\nf 1 4 2\n"),
        "dropped 1 of 2 faces: 1 of 4 vertices are not finite or beyond 1.844e+18 m: line 5",
    ),
    "too far, with colours": (
        ".obj",
        obj("v 0 1e400 0\nf 1 2 5\nf 1 4 2\n").replace(b"\nf", b" 1 1 1\nf", 1).replace(b"\nv", b" 1 1 1\nv"),
        "dropped 1 of 2 faces: 1 of 4 vertices are not finite or beyond 1.844e+18 m: line 5",
    ),
    "off": (
        ".off",
        off().replace(b"3 0 1 2", b"3 0 1 9"),
        "dropped 1 of 2 faces: corner 9 is none of the 4 vertices from 0 on: line 7",
    ),
    "ply": (
        ".ply",
        ply(faces=[(0, 1, 9), FACES[1]]),
        "dropped 1 of 2 faces: corner 9 is none of the 4 vertices: face 0",
    ),
    "ply, an idle vertex": (
        ".ply",
        ply(faces=FACES[1:]).replace(b"0 1 0\n", b"0 nan 0\n"),
        "dropped 0 of 1 faces: 1 of 4 vertices are not finite or beyond 1.844e+18 m: vertex 2",
    ),
    "stl": (
        ".stl",
        stl(True).replace(struct.pack("<3f", *POINTS[2]), struct.pack("<3f", 0, np.inf, 0)),
        "dropped 1 of 2 faces: 1 of 6 vertices are not finite or beyond 1.844e+18 m: vertex 2",
    ),
}


@pytest.mark.parametrize("name", REPAIRED)
def test_repair_drops_broken_faces_alone_and_counts_them(tmp_path, name):
    suffix, data, note = REPAIRED[name]
    asset = read(tmp_path, suffix, data, repair=True)
    assert corners(asset.mesh) == SECOND
    assert asset.mesh.vertices.shape == (3, 3)
    assert asset.mesh.material.tolist() == [0]
    assert asset.notes == (note,)
    with pytest.raises(InputError, match=r"; export it again, or drop it with repair$"):
        read(tmp_path, suffix, data)


def test_repair_counts_what_both_faults_drop(tmp_path):
    asset = read(tmp_path, ".obj", obj("v 0 nan 0\nf 1 2 9\nf 1 2 5\nf 1 9 5\nf 1 4 2\n"), repair=True)
    assert corners(asset.mesh) == SECOND
    assert asset.notes == (
        "dropped 2 of 4 faces: corner 9 is none of the 5 vertices from 1 on: line 6",
        "dropped 1 of 2 faces: 1 of 4 vertices are not finite or beyond 1.844e+18 m: line 5",
    )


def test_nothing_left_to_draw_is_an_error(tmp_path):
    for data in (obj("f 1 2 9\n"), obj("v nan 0 0\nf 1 2 5")):
        with pytest.raises(InputError, match="contains no triangles"):
            read(tmp_path, ".obj", data, repair=True)


def test_a_colour_that_is_no_number(tmp_path):
    data = b"mtllib m.mtl\n" + obj("usemtl a\nf 1 2 3\n")
    (tmp_path / "m.mtl").write_text("newmtl a\nKd nan 0 0\n")
    with pytest.raises(
        InputError, match=r"model\.obj: 'm\.mtl' line 2: Kd is 'nan 0 0'; export it again, or drop it with repair$"
    ):
        read(tmp_path, ".obj", data)
    asset = read(tmp_path, ".obj", data, repair=True)
    np.testing.assert_array_equal(asset.materials.base_color, np.float32([[*GREY, 1]]))
    assert asset.notes == ("dropped a colour: Kd is 'nan 0 0': 'm.mtl' line 2",)
    for words in (b"red", b"1 0"):
        (tmp_path / "m.mtl").write_bytes(b"newmtl a\n\nKd " + words)
        with pytest.raises(
            InputError, match=rf"model\.obj: 'm\.mtl' line 3: '{words.decode()}' is not [13] or more numbers"
        ):
            read(tmp_path, ".obj", data)


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".stl"])
def test_each_limit_is_the_last_size_that_is_read(tmp_path, suffix):
    data = {".obj": obj(), ".off": off(), ".ply": ply(), ".stl": stl(True)}[suffix]
    for limit, most, message in (
        ("triangles", 2, "has 2 triangles"),
        ("file_bytes", len(data), f"has {len(data)} bytes"),
    ):
        assert corners(read(tmp_path, suffix, data, limits=Limits(**{limit: most})).mesh) == WHOLE
        with pytest.raises(LimitError, match=rf"{message}; at most {most - 1} are allowed \(limit {limit}\)$"):
            read(tmp_path, suffix, data, limits=Limits(**{limit: most - 1}))


def test_a_library_is_within_the_limits_too(tmp_path):
    (tmp_path / "m.mtl").write_bytes(bytes(1000))
    with pytest.raises(LimitError, match=r"m\.mtl: has 1000 bytes; at most 999 are allowed \(limit file_bytes\)$"):
        read(tmp_path, ".obj", b"mtllib m.mtl\n" + obj(), limits=Limits(file_bytes=999))


# Stops before normals are made: every new number of vertices would compile them anew.
UNJOINED = mock.patch.object(module, "join_pieces", lambda pieces, *_: pieces[0])


@pytest.mark.parametrize("key", ["f", "l", "v", "g", "#"])
def test_a_line_of_a_million_vertices(tmp_path, key):
    data = obj() + f"{key} ".encode() + b"1 2 3 4 " * 250_000
    began = time.process_time()
    with UNJOINED:
        piece = read(tmp_path, ".obj", data).mesh
    assert time.process_time() - began < SOON
    assert len(piece.faces) == 2 + (10**6 - 2) * (key == "f")


MODELS = pathlib.Path("/usr/share/assimp/models")
REFUSED = {
    "invalid/empty.obj": "is empty",
    "invalid/empty.off": "is empty",
    "invalid/empty.ply": "is empty",
    "invalid/malformed.obj": "line 23: corner 12 is none of the 8 vertices from 1 on",
    "invalid/malformed2.obj": "line 23: a face has 0 corners",
    "invalid/OutOfMemory.off": "claims 353535235358 vertices and 6 faces, but 14 lines follow",
    "OBJ/number_formats.obj": "line 11: '1e+2 2.e+1 3.1+e2' is not 3 or more numbers",
    "OBJ/point_cloud.obj": NO_FACES,
    "OBJ/testline.obj": NO_FACES,
    "OBJ/testpoints.obj": NO_FACES,
    "OFF/invalid.off": "line 6: a face has 0 corners",
    "PLY/issue623.ply": NO_FACES,
    "PLY/points.ply": NO_FACES,
}


def test_real_files_give_a_mesh_or_the_right_words():
    """The models of Debian's assimp-testmodels, but for those that are larger than 2 MB."""
    if not MODELS.is_dir():
        pytest.skip(f"no {MODELS}; install assimp-testmodels")
    folders = ("invalid", "OBJ", "PLY", "STL", "OFF")
    files = [file for folder in folders for file in (MODELS / folder).iterdir() if file.stat().st_size < 2_000_000]
    files = [file for file in sorted(files) if file.suffix.lower() in (".obj", ".ply", ".stl", ".off")]
    assert len(files) > 40
    refused = set()
    for file in files:
        name = str(file.relative_to(MODELS))
        began = time.process_time()
        try:
            asset = read_mesh(file)
        except InputError as error:
            refused.add(name)
            assert str(error).startswith(f"{file}: {REFUSED.get(name, 'it should have been read')}"), error
            assert "\n" not in str(error), name
        else:
            assert len(asset.mesh.faces), name
            assert np.isfinite([asset.mesh.vertices, asset.mesh.normals]).all(), name
        assert time.process_time() - began < SOON, name
    assert refused == REFUSED.keys()


PAINTED = {name: ("uchar", [1, 2, 3, 4]) for name in ("red", "green", "blue")}
TAIL = "vt 0 0\nvn 0 0 1\nusemtl a\nf 1/1/1 2/1/1 3/1/1\nf -4//1 -1//1 -3//1\nf 1 2 3 4\n"
VALID = [
    (".obj", b"mtllib damaged.mtl\n" + obj(TAIL)),
    (".mtl", LIBRARY),
    (".off", off()),
    (".ply", ply(columns=PAINTED)),
    (".ply", ply("binary_little_endian")),
    (".stl", stl(True)),
    (".stl", stl(False)),
]


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    st.sampled_from(VALID),
    st.lists(st.tuples(st.integers(0, 2**16), st.integers(1, 255)), max_size=4),
    st.booleans(),
    st.data(),
)
def test_damage_gives_triangles_or_one_typed_error(tmp_path_factory, valid, flips, repair, draw):
    suffix, data = valid
    broken = bytearray(data)
    for place, bits in flips:
        broken[place % len(broken)] ^= bits
    folder = tmp_path_factory.getbasetemp()
    for name, whole in VALID[:2]:
        (folder / f"damaged{name}").write_bytes(whole)
    (folder / f"damaged{suffix}").write_bytes(broken[: draw.draw(st.integers(1, len(broken)) | st.just(len(broken)))])
    file = folder / f"damaged{'.obj' if suffix == '.mtl' else suffix}"
    began = time.process_time()
    with UNJOINED:
        try:
            piece = read_mesh(file, Reading(repair=repair)).mesh
        except Error as error:
            assert str(error).startswith(f"{file}: ")
            assert "\n" not in str(error)
        else:
            assert all(np.isfinite(array).all() for array in (piece.vertices, piece.normals, piece.uvs))
            assert piece.faces.size
            assert 0 <= piece.faces.min() <= piece.faces.max() < len(piece.vertices)
            assert piece.material.shape == piece.faces.shape[:1]
    assert time.process_time() - began < SOON
