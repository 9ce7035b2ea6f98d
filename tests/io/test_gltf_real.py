"""Real glTF files, attribute by attribute against what they say, read here by other means.

The files are those beside the project's checkout and those of Debian's package assimp-testmodels; tests skip where they
are absent.
"""

import base64
import json
import pathlib
import struct
from io import BytesIO

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from watch import watched

from jaxraster.errors import InputError
from jaxraster.io.gltf import read_gltf
from jaxraster.io.reading import Reading

MODELS = pathlib.Path("/usr/share/assimp/models/glTF2")


def stored(path) -> tuple[dict, list[bytes]]:
    """A file's JSON and buffers, read without the reader under test."""
    data = path.read_bytes()
    if path.suffix == ".gltf":
        document = json.loads(data)
        return document, [uri(path, b["uri"]) for b in document["buffers"]]
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), [data[28 + size :]]


def uri(path, text: str) -> bytes:
    return base64.b64decode(text.split(",")[1]) if text.startswith("data:") else (path.parent / text).read_bytes()


def array(document: dict, buffers: list[bytes], index: int) -> np.ndarray:
    """An accessor, strided or not, its normalized integers as floats."""
    item = document["accessors"][index]
    part = document["bufferViews"][item["bufferView"]]
    size = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[item["type"]]
    dtype = np.dtype({5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[item["componentType"]])
    step, first = part.get("byteStride", dtype.itemsize * size), part.get("byteOffset", 0) + item.get("byteOffset", 0)
    rows = [np.frombuffer(buffers[part["buffer"]], dtype, size, first + step * i) for i in range(item["count"])]
    values = np.stack(rows)
    return values / np.iinfo(dtype).max if item.get("normalized") else values


def local(node: dict) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix() * node.get("scale", [1, 1, 1])
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def placed(document: dict) -> list[tuple[dict, np.ndarray]]:
    """The nodes of the scene in the order of the file, with their world matrices."""
    nodes, found = document["nodes"], {}

    def visit(i, above):
        found[i] = above @ local(nodes[i])
        for child in nodes[i].get("children", []):
            visit(child, found[i])

    children = {c for node in nodes for c in node.get("children", [])}
    scene = document.get("scenes", [{}])[document.get("scene", 0)]
    for root in scene.get("nodes", [i for i in range(len(nodes)) if i not in children]):
        visit(root, np.eye(4))
    return [(nodes[i], found[i]) for i in sorted(found)]


def triangles(index: np.ndarray, mode: int) -> list[tuple[int, int, int]]:
    """The corners of the triangles, by the formulas of the specification."""
    if mode == 4:
        return [tuple(index[i : i + 3]) for i in range(0, len(index), 3)]
    if mode == 5:
        return [(index[i], index[i + 1 + i % 2], index[i + 2 - i % 2]) for i in range(len(index) - 2)]
    return [(index[i + 1], index[i + 2], index[0]) for i in range(len(index) - 2)]


REAL = {
    "FlightHelmet/FlightHelmet.gltf": (94_722, 15, []),
    "CornellBox/CornellBox.glb": (36, 1, []),
    "cubes/Cubes.glb": (36, 1, []),
    "sphere/sphere.gltf": (3_968, 1, []),
    "torus/torus.gltf": (3_072, 1, []),
    "MixedLightingExample/MixedLightingExample.gltf": (
        40_898,
        8,
        ["extensions are ignored: KHR_materials_variants"],
    ),
}
ASSIMP = {
    "BoxTexcoords-glTF/boxTexcoords.gltf": (12, 2, []),
    "BoxTextured-glTF/BoxTextured.gltf": (12, 1, []),
    "BoxTextured-glTF-Binary/BoxTextured.glb": (12, 1, []),
    "BoxTextured-glTF-Embedded/BoxTextured.gltf": (12, 1, []),
    "BoxTextured-glTF-pbrSpecularGlossiness/BoxTextured.gltf": (
        12,
        1,
        ["extensions are ignored: KHR_materials_pbrSpecularGlossiness"],
    ),
    "BoxBadNormals-glTF-Binary/BoxBadNormals.glb": (
        12,
        1,
        ["NORMAL has zeros, which become means of the faces around: /meshes/0/primitives/0/attributes"],
    ),
    "cameras/Cameras.gltf": (2, 1, []),
    **{
        f"glTF-Asset-Generator/Mesh_PrimitiveMode/Mesh_PrimitiveMode_{i:02}.gltf": (2, 1, [])
        for i in (4, 5, 6, 11, 12, 13, 14, 15)
    },
    "glTF-Sample-Models/AnimatedMorphCube-glTF/AnimatedMorphCube.gltf": (
        12,
        1,
        ["animations are ignored", "morph targets are ignored: /meshes/0/primitives/0"],
    ),
    "issue_3269/texcoord_crash.gltf": (10, 1, []),
    "simple_skin/simple_skin.gltf": (
        8,
        1,
        ["animations are ignored", "skins are ignored: /meshes/0/primitives/0"],
    ),
    "textureTransform/TextureTransformTest.gltf": (24, 5, []),
    "wrongTypes/badString.gltf": (12, 1, []),
    "ClearCoat-glTF/ClearCoatTest.gltf": (
        37_116,
        5,
        [
            "clearcoatTexture is ignored: /materials/4/extensions/KHR_materials_clearcoat",
            "clearcoatRoughnessTexture is ignored: /materials/7/extensions/KHR_materials_clearcoat",
            "clearcoatNormalTexture is ignored: /materials/13/extensions/KHR_materials_clearcoat, "
            "/materials/16/extensions/KHR_materials_clearcoat",
        ],
    ),
}


@pytest.fixture
def models():
    if not MODELS.is_dir():
        pytest.skip("needs the Debian package assimp-testmodels")
    return MODELS


@pytest.mark.parametrize("name", REAL)
def test_files_of_the_field(assets, name):
    compare(assets / name, *REAL[name])


@pytest.mark.parametrize("name", ASSIMP)
def test_files_of_assimp(models, name):
    compare(models / name, *ASSIMP[name])


def compare(path, num_faces: int, num_textures: int, notes: list[str]) -> None:
    """Follow a file through its nodes, and compare every vertex, face and factor."""
    document, buffers = stored(path)
    asset = read_gltf(path)
    assert asset.mesh.faces.shape == (num_faces, 3)
    assert asset.textures.levels.shape[0] == num_textures
    assert list(asset.notes) == notes
    mesh = {name: np.asarray(value) for name, value in vars(asset.mesh).items() if value is not None}
    vertex, face = 0, 0
    for node, matrix in placed(document):
        for primitive in document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            given = {k: array(document, buffers, i) for k, i in primitive["attributes"].items()}
            count, mode = len(given["POSITION"]), primitive.get("mode", 4)
            indexed = "indices" in primitive
            order = array(document, buffers, primitive["indices"])[:, 0] if indexed else np.arange(count)
            corners = np.array(triangles(order.tolist(), mode))
            # Without normals, faces have corners of their own.
            split = "NORMAL" not in given
            given = {k: values[corners.ravel()] if split else values for k, values in given.items()}
            here = slice(vertex, vertex + len(given["POSITION"]))
            rows = slice(face, face + len(corners))
            if split:
                corners = np.arange(corners.size).reshape(-1, 3)
            if np.linalg.det(matrix[:3, :3]) < 0:
                corners = corners[:, [0, 2, 1]]
            np.testing.assert_array_equal(mesh["faces"][rows], corners + vertex)
            assert (mesh["material"][rows] == primitive.get("material", len(document.get("materials", [])))).all()
            check_vertices({k: v[here] for k, v in mesh.items() if k not in ("faces", "material")}, given, matrix)
            vertex, face = here.stop, rows.stop
    assert (vertex, face) == (len(mesh["vertices"]), num_faces)
    np.testing.assert_allclose(np.linalg.norm(mesh["normals"], axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(mesh["tangents"][:, :3], axis=1), 1, atol=1e-5)
    check_materials(path, document, buffers, asset)


def check_vertices(mesh: dict, given: dict, matrix: np.ndarray) -> None:
    position = given["POSITION"] @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(mesh["vertices"], position, rtol=1e-6, atol=1e-6 * np.abs(position).max())
    if "NORMAL" in given:
        length = np.linalg.norm(given["NORMAL"], axis=1)
        normal = given["NORMAL"] @ np.linalg.inv(matrix[:3, :3])
        normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-30))[length > 0]
        np.testing.assert_allclose(mesh["normals"][length > 0], normal, atol=2e-6)
    if "TANGENT" in given and "NORMAL" in given:
        tangent = given["TANGENT"][:, :3] @ matrix[:3, :3].T
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        np.testing.assert_allclose(mesh["tangents"][:, :3], tangent, atol=2e-6)
        sign = given["TANGENT"][:, 3] * np.sign(np.linalg.det(matrix[:3, :3]))
        np.testing.assert_array_equal(mesh["tangents"][:, 3], sign)
    for field, name in (("uvs", "TEXCOORD_0"), ("second_uvs", "TEXCOORD_1")):
        if field in mesh and name in given:
            np.testing.assert_allclose(mesh[field], given[name], rtol=1e-7)
    if "COLOR_0" in given:
        color = given["COLOR_0"]
        np.testing.assert_allclose(mesh["colors"][:, : color.shape[1]], color, rtol=1e-6)


def check_materials(path, document: dict, buffers: list[bytes], asset) -> None:
    materials = {name: np.asarray(value) for name, value in vars(asset.materials).items() if value is not None}
    for row, material in enumerate(document.get("materials", [])):
        pbr = material.get("pbrMetallicRoughness", {})
        np.testing.assert_array_equal(materials["roughness"][row], np.float32(pbr.get("roughnessFactor", 1)))
        np.testing.assert_array_equal(materials["metallic"][row], np.float32(pbr.get("metallicFactor", 1)))
        base = np.float32(pbr.get("baseColorFactor", [1, 1, 1, 1]))
        np.testing.assert_array_equal(materials["base_color"][row], base)
        assert materials["double_sided"][row] == material.get("doubleSided", False)
        coat = material.get("extensions", {}).get("KHR_materials_clearcoat", {})
        expected = [coat.get("clearcoatFactor", 0), coat.get("clearcoatRoughnessFactor", 0)]
        assert materials.get("clearcoat", np.zeros((row + 1, 2)))[row].tolist() == np.float32(expected).tolist()
        infos = {
            0: ("base_color", pbr.get("baseColorTexture")),
            1: ("metallic_roughness", pbr.get("metallicRoughnessTexture")),
            2: ("normal", material.get("normalTexture")),
            3: ("occlusion", material.get("occlusionTexture")),
            4: ("emissive", material.get("emissiveTexture")),
        }
        for column, (slot, info) in infos.items():
            index = materials[f"{slot}_texture"][row]
            if info is None:
                assert index == -1
                continue
            if "uv_sets" in materials:
                assert materials["uv_sets"][row, column] == info.get("texCoord", 0)
            check_texture(path, document, buffers, asset.textures, int(index), info, slot in ("base_color", "emissive"))


def check_texture(path, document: dict, buffers: list[bytes], textures, row: int, info: dict, encoded: bool) -> None:
    image = document["images"][document["textures"][info["index"]]["source"]]
    if "uri" in image:
        data = uri(path, image["uri"])
    else:
        view = document["bufferViews"][image["bufferView"]]
        data = buffers[view["buffer"]][view.get("byteOffset", 0) :][: view["byteLength"]]
    codes = np.asarray(Image.open(BytesIO(data)).convert("RGBA")) / 255
    if encoded:
        codes[..., :3] = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)[..., :3]
    offset, width, height = np.asarray(textures.levels)[row, 0]
    texels = np.asarray(textures.texels)[offset : offset + width * height].reshape(height, width, 4)
    np.testing.assert_allclose(texels, codes, rtol=2e-6, atol=1e-7)


# File -> what the one line says; a number is how many faces a repair leaves.
BROKEN = {
    "BoxTextured-glTF-techniqueWebGL/BoxTextured.gltf": ("requires KHR_technique_webgl, which is not supported", None),
    "BoxWithInfinites-glTF-Binary/BoxWithInfinites.glb": ("/accessors/2: 24 of 24 elements are not finite", None),
    "draco/2CylinderEngine.gltf": ("requires KHR_draco_mesh_compression, which is not supported", None),
    "IncorrectVertexArrays/Cube.gltf": ("35 corners do not make whole triangles", 1),
    "IndexOutOfRange/AllIndicesOutOfRange.gltf": ("index 65535 but only 24 vertices", None),
    "IndexOutOfRange/IndexOutOfRange.gltf": ("index 255 but only 24 vertices", 11),
    "MissingBin/BoxTextured.gltf": ("BoxTextured0.bin cannot be read: No such file", None),
    "RecursiveNodes/RecursiveNodes.gltf": ("/nodes/0: is its own ancestor: 0 → 1 → 0", None),
    "SchemaFailures/sceneWrongType.gltf": ('/scene: expected an integer, got "hello"', None),
    "TestNoRootNode/NoScene.gltf": ("/scene: is 0, but there are 0", None),
    "TestNoRootNode/SceneWithoutNodes.gltf": ("/: contains no triangles", None),
    **{
        f"glTF-Asset-Generator/Mesh_PrimitiveMode/Mesh_PrimitiveMode_{i:02}.gltf": (
            "contains no triangles, but points|contains no triangles, but line",
            None,
        )
        for i in (0, 1, 2, 3, 7, 8, 9, 10)
    },
    "wrongTypes/badArray.gltf": ("/meshes/0/primitives: expected an array", None),
    "wrongTypes/badExtension.gltf": ("KHR_texture_transform: expected an object", None),
    "wrongTypes/badNumber.gltf": ("/materials/0/normalTexture: index is missing", None),
    "wrongTypes/badObject.gltf": ("pbrMetallicRoughness: expected an object", None),
    "wrongTypes/badUint.gltf": ("baseColorTexture/index: is -1, but there are 1", None),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_of_assimp(models, name):
    message, left = BROKEN[name]
    with watched(models), pytest.raises(InputError, match=message) as caught:
        read_gltf(models / name)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(models / name))
    if left:
        assert len(read_gltf(models / name, Reading(repair=True)).mesh.faces) >= left
    else:
        with pytest.raises(InputError):
            read_gltf(models / name, Reading(repair=True))


def test_every_file_of_assimp_is_accounted_for(models):
    found = {str(f.relative_to(models)) for kind in ("gltf", "glb") for f in models.rglob(f"*.{kind}")}
    # Too many parts for the slow reader of this file; its numbers are those of many others.
    assert found == {*ASSIMP, *BROKEN, "2CylinderEngine-glTF-Binary/2CylinderEngine.glb"}
    assert len(read_gltf(models / "2CylinderEngine-glTF-Binary/2CylinderEngine.glb").mesh.faces) == 121_496


def test_emission_and_light(assets):
    cornell = read_gltf(assets / "CornellBox" / "CornellBox.glb")
    np.testing.assert_array_equal(cornell.materials.emissive[0], [100, 100, 100])
    document, _ = stored(assets / "cubes" / "Cubes.glb")
    light = document["extensions"]["KHR_lights_punctual"]["lights"][0]
    cubes = read_gltf(assets / "cubes" / "Cubes.glb")
    expected = np.float32(light["intensity"]) * np.float32(light["color"])
    np.testing.assert_allclose(cubes.lights.point.intensity, expected[None], rtol=1e-6)
