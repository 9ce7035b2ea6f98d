"""glTF files made to hurt: claims that multiply, numbers at the edge of float32, names no terminal should print."""

import struct
import time
import warnings

import gltf_writer as gltf
import jaxtyping
import numpy as np
import pytest
from test_gltf_damage import CUBE, INDICES, PIXELS, cube, edit, instances, read
from watch import watched

import jaxraster as jr
from jaxraster.errors import InputError, LimitError
from jaxraster.io import gltf_texture
from jaxraster.io.gltf import read_gltf
from jaxraster.io.reading import Limits, Reading

TRIANGLE = np.array([0, 1, 2], np.uint16)


def test_vertices_that_no_face_uses_are_left_behind(tmp_path):
    """Each instance would carry them along."""
    document = cube(indices=TRIANGLE)
    document["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
    document["scenes"] = [{"nodes": [0, 1]}]
    mesh = read(document, tmp_path).mesh
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(mesh.vertices[:3], CUBE["POSITION"][:3])
    np.testing.assert_array_equal(mesh.uvs[3:], CUBE["TEXCOORD_0"][:3])


def test_many_primitives_of_the_same_vertices_are_counted(tmp_path):
    document = cube()
    document["meshes"][0]["primitives"] *= 100
    with pytest.raises(LimitError, match=r"brings the scene's vertices to 1008; at most 1000 .*\(limit vertices\)"):
        read(document, tmp_path, limits=Limits(vertices=1000))
    with pytest.raises(LimitError, match=r"/nodes/40: brings the scene's vertices to 1008; at most 1000"):
        read(instances(100), tmp_path, limits=Limits(vertices=1000))


def test_rows_made_of_one_picture_are_counted_each(tmp_path):
    document = cube()
    document["samplers"] = [{"wrapS": wrap, "wrapT": other} for wrap in (10497, 33071) for other in (10497, 33071)]
    document["textures"] = [{"source": 0, "sampler": i} for i in range(4)]
    document["materials"] = [{"emissiveTexture": {"index": i}} for i in range(4)]
    with pytest.raises(LimitError, match=r"decoded and packed, to 175; at most 174 are allowed \(limit texels\)"):
        read(document, tmp_path, limits=Limits(texels=5 * PIXELS[..., 0].size - 1))
    assert read(document, tmp_path, limits=Limits(texels=5 * PIXELS[..., 0].size)).textures.levels.shape[0] == 4


def test_claims_without_data_add_up(tmp_path):
    document = cube()
    for index in (1, 3):
        del document["accessors"][index]["bufferView"]
    size = 24 * (12 + 8)
    assert read(document, tmp_path, limits=Limits(claimed_bytes=size)).mesh.faces.shape == (12, 3)
    with pytest.raises(LimitError, match=f"claims without data to {size}; at most {size - 1}"):
        read(document, tmp_path, limits=Limits(claimed_bytes=size - 1))


def test_a_file_that_many_buffers_name_is_read_once(tmp_path):
    document = cube()
    binary = bytes(document["bytes"])
    (tmp_path / "all.bin").write_bytes(binary)
    document["buffers"] = [{"byteLength": len(binary), "uri": "all.bin"}] * 10
    for i, view in enumerate(document["bufferViews"]):
        view["buffer"] = i
    path = gltf.write(document, tmp_path / "model", "files")
    limits = Limits(file_bytes=path.stat().st_size + 2)
    assert len(binary) < limits.file_bytes < 2 * len(binary)
    assert len(read_gltf(path, Reading(limits=limits)).mesh.faces) == 12
    (tmp_path / "other.bin").write_bytes(binary)
    document["buffers"][1] = {"byteLength": len(binary), "uri": "other.bin"}
    path = gltf.write(document, tmp_path / "model", "files")
    with pytest.raises(LimitError, match=r"/buffers/1/uri: brings bytes of all buffers to .*\(limit file_bytes\)"):
        read_gltf(path, Reading(limits=limits))


def test_a_buffer_ends_where_it_says(tmp_path):
    document = cube()
    document["buffers"] = [{"byteLength": 300}]
    with pytest.raises(InputError, match="/bufferViews/4: ends at byte 1224 of a buffer of 300"):
        read(document, tmp_path)
    document["buffers"] = [{"byteLength": len(document["bytes"])}, {"byteLength": 1}]
    document["bufferViews"][0]["buffer"] = 1
    with pytest.raises(InputError, match="/buffers/1: has no uri, and there is no binary chunk"):
        read(document, tmp_path)


@pytest.mark.parametrize("length", [0, 8, 12, 19])
def test_a_container_too_short_for_itself(tmp_path, length):
    data = bytearray(gltf.write(cube(), tmp_path / "whole").read_bytes())
    struct.pack_into("<I", data, 8, length)
    (tmp_path / "short.glb").write_bytes(data)
    with pytest.raises(InputError, match=f"header: says {length} bytes, the file has {len(data)}"):
        read_gltf(tmp_path / "short.glb")


def test_bytes_after_the_end_are_said(tmp_path):
    data = gltf.write(cube(), tmp_path / "whole").read_bytes()
    (tmp_path / "long.glb").write_bytes(data + b"more")
    assert read_gltf(tmp_path / "long.glb").notes == ("4 bytes after the end are ignored: header",)
    with pytest.raises(InputError, match="4 bytes after the end are ignored, which strict forbids"):
        read_gltf(tmp_path / "long.glb", Reading(strict=True))


LENSES = [
    {"yfov": 1e-46, "znear": 0.1},
    {"yfov": 1e-39, "znear": 0.1},
    {"yfov": 3.14159265, "znear": 0.1},
    {"yfov": 1, "znear": 1e-46},
    {"yfov": 1, "znear": 1, "zfar": 1.000000001},
    {"xmag": 1, "ymag": 1e-46, "znear": 0, "zfar": 1},
    {"xmag": 1, "ymag": 1e-39, "znear": 0, "zfar": 1},
    {"xmag": 1, "ymag": 1, "znear": 0, "zfar": 1e-46},
]


@pytest.mark.parametrize("lens", LENSES, ids=str)
def test_lenses_that_float32_cannot_hold(tmp_path, lens):
    kind = "perspective" if "yfov" in lens else "orthographic"
    document = cube()
    document["cameras"] = [{"type": kind, kind: lens}]
    with pytest.raises(InputError, match=f"/cameras/0/{kind}: "):
        read(document, tmp_path)


@pytest.mark.parametrize("scale", [1e-45, 1e-30, 1e-10, 1e10, 1e17])
@pytest.mark.parametrize("place", [0.0, 1e10])
def test_every_model_can_be_framed(tmp_path, scale, place):
    """Also next to nothing, far away, or both, where a float32 cannot tell its vertices apart."""
    positions = (np.float64(CUBE["POSITION"]) * scale + place).astype(np.float32)
    document = cube(POSITION=positions)
    document["nodes"], document["cameras"] = [{"mesh": 0}], []
    _, camera = jr.load(gltf.write(document, tmp_path / "model"))
    assert np.isfinite(camera.world_from_view).all() and np.isfinite(camera.clip_from_view).all()


def test_scales_that_overflow_say_so_and_nothing_else(tmp_path):
    document = cube()
    document["nodes"] = [{"children": [i + 1], "scale": [1e30, 1e30, 1e30]} for i in range(20)] + [{"mesh": 0}]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=r"/nodes/0: its world transform holds 1e\+30"):
            read(document, tmp_path)


UGLY = "a\n\x1b[2J" + "x" * 100_000
QUOTED = {
    "required extension": lambda: cube() | {"extensionsRequired": [UGLY]},
    "uri": lambda: edit(cube(), "/images/0", {"uri": UGLY}),
    "kind of light": lambda: edit(cube(), "/extensions/KHR_lights_punctual/lights/0/type", UGLY),
    "number": lambda: edit(cube(), "/nodes/0/rotation", [UGLY, 0, 0, 0]),
    "array": lambda: edit(cube(), "/nodes/0/rotation", [[UGLY] * 1000]),
    "cycle": lambda: cube() | {"nodes": [{"children": [(i + 1) % 5000]} for i in range(5000)], "scenes": []},
}


@pytest.mark.parametrize("name", QUOTED)
def test_what_a_file_says_reaches_no_terminal_raw(tmp_path, name):
    with pytest.raises(InputError) as caught:
        read(QUOTED[name](), tmp_path)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 1000


def test_notes_are_few_short_and_printable(tmp_path):
    document = cube() | {"extensionsUsed": [UGLY, *(f"EXT_{i}" for i in range(1000))]}
    (note,) = read(document, tmp_path).notes
    assert note.isprintable() and len(note) < 3000
    assert note.startswith("extensions are ignored: ") and note.endswith(", EXT_0, EXT_1, EXT_2, EXT_3 and 996 more")


def test_json_of_any_depth_is_one_line(tmp_path):
    for depth in (900, 5000, 200_000):
        (tmp_path / "deep.gltf").write_bytes(b'{"asset": {"version": ' + b"[" * depth + b"]" * depth + b"}}")
        with watched(tmp_path), pytest.raises(InputError) as caught:
            read_gltf(tmp_path / "deep.gltf")
        assert len(str(caught.value)) < 1000


def test_a_root_may_be_named_once(tmp_path):
    with pytest.raises(InputError, match="/scenes/0: names a root node twice"):
        read(edit(cube(), "/scenes/0/nodes", [0, 0]), tmp_path)


def test_a_matrix_may_be_rounded(tmp_path):
    matrix = np.eye(4)
    matrix[3] = [1e-7, 0, -1e-7, 1.0000001]
    document = cube()
    document["nodes"] = [{"mesh": 0, "matrix": matrix.T.ravel().tolist()}]
    document["cameras"] = []
    np.testing.assert_array_equal(read(document, tmp_path).mesh.vertices, CUBE["POSITION"])


@pytest.mark.parametrize("header", ["data:;base64,", "DATA:image/png;BASE64,", "data:application/octet-stream;base64,"])
def test_data_uris_in_any_case(tmp_path, header):
    document = cube()
    document["buffers"] = [{"byteLength": len(document["bytes"])}]
    document["buffers"][0]["uri"] = header + gltf.data_uri(bytes(document["bytes"])).split(",")[1]
    assert len(read_gltf(gltf.write(document, tmp_path / "model", "data")).mesh.faces) == 12


def test_uvs_that_a_mesh_does_not_have(tmp_path):
    """Its first ones stand in, with a note; a neighbour that has second ones keeps them."""
    document = cube(TEXCOORD_1=0.5 * CUBE["TEXCOORD_0"])
    gltf.node(document, mesh=gltf.mesh(document, INDICES, {"material": 0}, **CUBE))
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    document["materials"][0]["normalTexture"] = {"index": 0, "texCoord": 1}
    asset = read(document, tmp_path)
    assert asset.notes == ("second texture coordinates that a mesh does not have are replaced by its first",)
    np.testing.assert_array_equal(asset.mesh.second_uvs[:24], 0.5 * CUBE["TEXCOORD_0"])
    np.testing.assert_array_equal(asset.mesh.second_uvs[24:], CUBE["TEXCOORD_0"])


def test_links_lead_nowhere_else(tmp_path):
    """A link out of the folder is refused; a model that is a link may use what lies beside its target."""
    store, folder = tmp_path / "store", tmp_path / "folder"
    store.mkdir(), folder.mkdir()
    document = cube()
    (store / "blob1").write_bytes(bytes(document["bytes"]))
    document["buffers"] = [{"byteLength": len(document["bytes"]), "uri": "all.bin"}]
    (folder / "all.bin").symlink_to("../store/blob1")
    path = gltf.write(document, folder / "model", "files")
    with pytest.raises(InputError, match=r"/buffers/0/uri: all\.bin lies outside the file's folder"):
        read_gltf(path)
    path.rename(store / "blob2")
    path.symlink_to("../store/blob2")
    assert len(read_gltf(path).mesh.faces) == 12


COLORS = {
    "plain bytes": (np.full((24, 3), 200, np.uint8), {}, "neither floats nor normalized unsigned integers"),
    "signed": (np.full((24, 3), 100, np.int8), {"normalized": True}, "neither floats nor normalized"),
    "32 bits": (np.full((24, 3), 9, np.uint32), {"normalized": True}, "neither floats nor normalized"),
}


@pytest.mark.parametrize("name", COLORS)
def test_colours_of_the_wrong_type(tmp_path, name):
    codes, members, message = COLORS[name]
    document = cube()
    attribute = gltf.accessor(document, codes, **members)
    document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = attribute
    with pytest.raises(InputError, match=message):
        read(document, tmp_path)


def test_colours_and_signs_out_of_range_are_mended(tmp_path):
    colors = np.tile(np.float32([-5, 0.5, 3e38]), (24, 1))
    tangents = CUBE["TANGENT"].copy()
    tangents[:, 3] = [-0.5, 3e38] * 12
    asset = read(cube(COLOR_0=colors, TANGENT=tangents), tmp_path)
    where = "/meshes/0/primitives/0/attributes"
    assert asset.notes == (
        f"COLOR_0 is clamped to [0, 1]: {where}",
        f"TANGENT has signs that are neither 1 nor -1: {where}",
    )
    np.testing.assert_array_equal(asset.mesh.colors, [[0, 0.5, 1, 1]] * 24)
    np.testing.assert_array_equal(asset.mesh.tangents[:, 3], [-1, 1] * 12)
    with pytest.raises(InputError, match="COLOR_0 is clamped"):
        read(cube(COLOR_0=colors), tmp_path, strict=True)


def test_what_is_too_far_takes_no_other_material_along(tmp_path):
    positions = CUBE["POSITION"].copy()
    positions[-1] = 1e30
    document = cube(POSITION=positions)
    document["materials"] = [{}, document["materials"][0]]
    document["meshes"][0]["primitives"][0]["material"] = 1
    np.testing.assert_array_equal(read(document, tmp_path, repair=True).mesh.material, [1] * 11)


def test_memory_that_is_not_there_is_a_limit(tmp_path, monkeypatch):
    def starve(*_):
        raise MemoryError

    monkeypatch.setattr("jaxraster.io.gltf.read_materials", starve)
    with pytest.raises(LimitError, match="does not fit into memory; scale its pictures down"):
        jr.load(gltf.write(cube(), tmp_path / "model"))


BAD_REQUESTS = [
    ({"camera": "0"}, TypeError, "load: camera must be a whole number, got '0'"),
    ({"limits": {"nodes": 3}}, TypeError, "limits must be a Limits"),
    ({"light_direction": "abc"}, jr.errors.UsageError, "light_direction: expected three numbers"),
]


@pytest.mark.parametrize(("request_", "kind", "message"), BAD_REQUESTS)
def test_requests_that_mean_nothing(tmp_path, request_, kind, message):
    path = gltf.write(cube(), tmp_path / "model")
    jaxtyping.config.update("jaxtyping_disable", True)  # users do not have the type checker of these tests
    try:
        with pytest.raises(kind, match=message):
            jr.load(path, **request_)
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


def test_a_light_may_come_from_next_to_nothing(tmp_path):
    path = gltf.write(cube(), tmp_path / "model")
    for size in (1e-300, 1e300):
        scene, _ = jr.load(path, light_direction=(0, -size, 0))
        np.testing.assert_array_equal(scene.lights.directional.direction, [[0, -1, 0]])


def test_the_helmet_loads_in_time(assets):
    """At most 4 s of computing with its pictures and 1.5 s without; both are far less on a quiet machine."""
    path = assets / "FlightHelmet" / "FlightHelmet.gltf"
    began = time.process_time()
    read_gltf(path)
    assert time.process_time() - began < 4
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gltf_texture, "read_image", lambda *_, **__: np.ones((1, 1, 4), np.float32))
        began = time.process_time()
        read_gltf(path)
        assert time.process_time() - began < 1.5
