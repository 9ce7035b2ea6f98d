"""OBJ, PLY, STL and OFF: what they hold comes back, colours become materials, and broken files are one clear line."""

import struct

import numpy as np
import pytest
from PIL import Image

from jaxraster.errors import InputError
from jaxraster.io.mesh import GREY, read_mesh

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


def read(folder, suffix: str, data: bytes):
    (folder / f"model{suffix}").write_bytes(data)
    return read_mesh(folder / f"model{suffix}")


SHARED = {
    "obj": (".obj", obj()),
    "obj, upper case": (".OBJ", obj()),
    "obj, counted from the end": (".obj", obj("f -4 -3 -2\nf -4 -1 -3\n")),
    "obj, loosely set": (".obj", obj().replace(b" ", b"\t ").replace(b"\n", b" # etc.\r\n  ")),
    "obj, Latin-1": (".obj", b"# B\xfcro\n" + obj()),
    "obj, UTF-16": (".obj", obj().decode().encode("utf-16")),
    "off": (".off", off()),
    "ply": (".ply", ply()),
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


def test_polygons_become_triangles(tmp_path):
    mesh = read(tmp_path, ".obj", obj("v 2 1 0\nf 1 2 5 3\nf 1 4 2\n")).mesh
    corners = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert areas.tolist() == [1, 1, 1]


def test_obj_colours(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 0.002 0.5 1\nnewmtl plain\nNs 5\n")
    asset = read(tmp_path, ".obj", b"mtllib m.mtl\n" + obj("usemtl red\nf 1 2 3\nusemtl plain\nf 1 4 2\n"))
    colors = np.asarray(asset.materials.base_color)[np.asarray(asset.mesh.material)]
    first = np.asarray(asset.mesh.vertices)[np.asarray(asset.mesh.faces)][:, :, 2].min(axis=1) == 0
    np.testing.assert_array_equal(colors[first], np.float32([[0.002, 0.5, 1, 1]]))
    np.testing.assert_array_equal(colors[~first], np.float32([[*GREY, 1]]))
    assert asset.notes == ()


def test_colours_of_vertices(tmp_path):
    one = {name: ("uchar", [code] * 4) for name, code in zip(("red", "green", "blue"), (255, 0, 128))}
    asset = read(tmp_path, ".ply", ply(columns=one))
    np.testing.assert_allclose(asset.materials.base_color, [[1, 0, 0.2158605, 1]], rtol=1e-6)
    assert asset.notes == ()
    many = {name: ("uchar", [30, 60, 90, 0]) for name in ("red", "green", "blue")}
    asset = read(tmp_path, ".ply", ply(columns=many))
    codes = np.array([60, 30]) / 255
    colors = np.asarray(asset.materials.base_color)[np.asarray(asset.mesh.material), 0]
    np.testing.assert_allclose(colors, np.where(codes < 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4), 1e-6)
    assert asset.notes == ("vertex colours are averaged over each face",)


def test_notes(tmp_path):
    asset = read(tmp_path, ".obj", b"mtllib gone.mtl\n" + obj())
    assert asset.notes == ("material library gone.mtl is missing",)
    Image.new("RGB", (2, 2)).save(tmp_path / "a.png")
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    tail = "vt 0 0\nusemtl a\nf 1/1 2/1 3/1\nf 1/1 4/1 2/1\n"
    assert read(tmp_path, ".obj", b"mtllib m.mtl\n" + obj(tail)).notes == ("textures are ignored",)


BROKEN = {
    "missing": (".obj", None, "cannot be read: No such file"),
    "empty": (".obj", b"", "is empty"),
    "no faces": (".obj", obj(""), "contains no triangles"),
    "only lines": (".obj", obj("l 1 2\n"), "contains no triangles"),
    "two corners": (".obj", obj("f 1 2\n"), "contains no triangles"),
    "index 0": (".obj", obj("f 1 2 3\nf 1/1 0/2 3/1\n"), "line 6: index 0, but the first vertex is 1"),
    "index 0 at the end": (".obj", obj("f 1 2 0"), "line 5: index 0"),
    "index beyond": (".obj", obj("f 1 2 9\n"), "not a readable .obj file: index 8 is out of bounds"),
    "index before": (".obj", obj("f -1 -2 -9\n"), "not a readable .obj file: index -9 is out of bounds"),
    "index back from the middle": (".obj", obj("f -1 -2 -3\nv 9 9 9\n"), "line 5: negative index with vertices after"),
    "words for coordinates": (".obj", b"v 0 0 zero\n" + obj(), "not a readable .obj file"),
    "words for indices": (".obj", obj("f a b c\n"), "not a readable .obj file"),
    "not a number": (".obj", b"v 0 nan 0\n" + obj(), "1 of 4 vertices are not finite"),
    "overflow": (".obj", b"v 0 1e400 0\n" + obj(), "1 of 4 vertices are not finite"),
    "too far": (".obj", b"v 0 1e30 0\n" + obj(), r"1 of 4 vertices are not finite or beyond 1e\+18 m"),
    "obj, binary": (".obj", bytes(range(128)) * 4, "model.obj: "),
    "two coordinates": (".obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "vertices have 2 coordinates, not 3"),
    "off, junk": (".off", b"junk", "not a readable .off file"),
    "off, cut off": (".off", off()[:-6], "claims 2 faces, but 1 were found; it may be cut off"),
    "off, no points": (".off", b"OFF\n", "not a readable .off file"),
    "off, index beyond": (".off", off()[:-1] + b"7", "face index outside"),
    "ply, junk": (".ply", b"junk", "not a readable .ply file"),
    "ply, a claim": (".ply", ply(num_faces=353_535_235_358), "model.ply: "),
    "ply, cut off": (".ply", ply("binary_little_endian")[:-4], "model.ply: "),
    "ply, index beyond": (".ply", ply(faces=[(0, 1, 7)]), "index 7 but only 4 vertices"),
    "ply, index before": (".ply", ply(faces=[(0, 1, -1)]), "index -1 but only 4 vertices"),
    "ply, only points": (".ply", ply(faces=[]), "contains no triangles"),
    "stl, junk": (".stl", b"junk" * 30, "contains no triangles; it may be cut off"),
    "stl, cut off": (".stl", stl(True)[:-9], "contains no triangles; it may be cut off"),
    "stl, cut off text": (".stl", stl(False)[:-12], "contains no triangles; it may be cut off"),
    "stl, words": (".stl", stl(False).replace(b"2 0 0", b"2 zero 0"), "not a readable .stl file"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files(tmp_path, name):
    suffix, data, message = BROKEN[name]
    if data is not None:
        (tmp_path / f"model{suffix}").write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(tmp_path / f"model{suffix}")
    assert "\n" not in str(caught.value)
    assert caught.value.file in (tmp_path / f"model{suffix}", str(tmp_path / f"model{suffix}"))


def test_a_colour_that_is_no_number(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl a\nKd nan 0 0\n")
    with pytest.raises(InputError, match="its colour Kd is"):
        read(tmp_path, ".obj", b"mtllib m.mtl\n" + obj("usemtl a\nf 1 2 3\n"))
