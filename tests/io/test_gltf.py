"""glTF: every attribute comes back as written, whichever way it is stored; every broken file is one clear line."""

import copy
import math
import re
import struct

import gltf_writer as gltf
import numpy as np
import pytest

from jaxraster.errors import InputError, LimitError
from jaxraster.io.gltf import read_gltf

RNG = np.random.default_rng(0)
UNIT_X, UNIT_Y, UNIT_Z = np.eye(3)

# A square of two triangles in the plane z = 0.25, as exporters write one: uv from the image's top left.
QUAD = {
    "POSITION": np.array([[0, 0, 0.25], [1, 0, 0.25], [1, 1, 0.25], [0, 1, 0.25]], np.float32),
    "NORMAL": np.tile(np.float32([0, 0, 1]), (4, 1)),
    "TANGENT": np.tile(np.float32([1, 0, 0, 1]), (4, 1)),
    "TEXCOORD_0": np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32),
}
CORNERS = np.array([0, 1, 2, 0, 2, 3], np.uint16)
PIXELS = RNG.integers(0, 256, (4, 8, 4)).astype(np.uint8)


def quad(primitive: dict | None = None, node: dict | None = None, **arrays) -> dict:
    """A document of the square in one node, with attributes replaced, added or (None) left out."""
    document = gltf.new()
    attributes = {name: array for name, array in (QUAD | arrays).items() if array is not None}
    gltf.node(document, mesh=gltf.mesh(document, CORNERS, primitive, **attributes), **(node or {}))
    return document


def read(document: dict, folder, container: str = "glb"):
    return read_gltf(gltf.write(document, folder / "model", container))


def numpy_of(record) -> dict:
    return {name: np.asarray(value) for name, value in vars(record).items() if value is not None}


# ---------------------------------------------------------------------------------------------------- geometry


@pytest.mark.parametrize("container", ["files", "data", "glb"])
@pytest.mark.parametrize("index", ["uint8", "uint16", "uint32"])
def test_attributes_survive(tmp_path, container, index):
    document = gltf.new()
    gltf.node(document, mesh=gltf.mesh(document, CORNERS.astype(index), **QUAD))
    asset = read(document, tmp_path, container)
    mesh = numpy_of(asset.mesh)
    for name, field in zip(QUAD, ("vertices", "normals", "tangents", "uvs")):
        np.testing.assert_array_equal(mesh[field], QUAD[name])
        assert mesh[field].dtype == np.float32
    np.testing.assert_array_equal(mesh["faces"], CORNERS.reshape(2, 3))
    np.testing.assert_array_equal(mesh["material"], [0, 0])
    assert mesh["faces"].dtype == mesh["material"].dtype == np.int32
    assert (asset.notes, asset.cameras, asset.lights) == ((), (), None)


def test_triangles_need_no_indices(tmp_path):
    soup = {name: array[CORNERS] for name, array in QUAD.items()}
    document = gltf.new()
    gltf.node(document, mesh=gltf.mesh(document, **soup))
    mesh = read(document, tmp_path).mesh
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(mesh.uvs, soup["TEXCOORD_0"])


def test_attributes_may_share_a_view(tmp_path):
    document = gltf.new()
    primitive = {"attributes": gltf.interleave(document, **QUAD), "indices": gltf.accessor(document, CORNERS)}
    gltf.node(document, mesh=gltf.put(document, "meshes", {"primitives": [primitive]}))
    mesh = numpy_of(read(document, tmp_path).mesh)
    for name, field in zip(QUAD, ("vertices", "normals", "tangents", "uvs")):
        np.testing.assert_array_equal(mesh[field], QUAD[name])


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16"])
def test_normalized_integers(tmp_path, dtype):
    limits = np.iinfo(dtype)
    codes = np.array([[limits.min, limits.max], [0, 1], [limits.min + 1, 5], [7, 9]], dtype)
    document = quad(TEXCOORD_0=None)
    index = gltf.accessor(document, codes, normalized=True)
    document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = index
    uvs = read(document, tmp_path).mesh.uvs
    np.testing.assert_allclose(uvs, np.maximum(codes / limits.max, -1.0), rtol=1e-7)


def test_quantized_positions(tmp_path):
    codes = np.array([[0, 0, 3], [100, 0, 3], [100, 200, 3], [0, 200, 3]], np.int16)
    document = quad(POSITION=codes)
    document["extensionsUsed"] = document["extensionsRequired"] = ["KHR_mesh_quantization"]
    asset = read(document, tmp_path)
    np.testing.assert_array_equal(asset.mesh.vertices, codes.astype(np.float32))
    assert asset.notes == ()


@pytest.mark.parametrize("base", [True, False])
def test_sparse_accessors(tmp_path, base):
    document = quad()
    position = document["accessors"][0]
    moved = np.array([[5, 6, 7], [8, 9, 10]], np.float32)
    position["sparse"] = {
        "count": 2,
        "indices": {"bufferView": gltf.view(document, np.array([1, 3], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": gltf.view(document, moved.tobytes())},
    }
    expected = QUAD["POSITION"].copy() if base else np.zeros((4, 3), np.float32)
    if not base:
        del position["bufferView"]
    expected[[1, 3]] = moved
    np.testing.assert_array_equal(read(document, tmp_path).mesh.vertices, expected)


def test_faces_without_normals_are_flat(tmp_path):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    cube = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]])
    cube = np.concatenate([cube, [[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]])
    document = gltf.new()
    # Given tangents are void without normals.
    arrays = {"POSITION": corners, "TANGENT": np.tile(np.float32([0, 0, 1, 1]), (8, 1))}
    gltf.node(document, mesh=gltf.mesh(document, cube.astype(np.uint16).ravel(), **arrays))
    mesh = numpy_of(read(document, tmp_path).mesh)
    assert mesh["vertices"].shape == (36, 3)
    a, b, c = np.moveaxis(mesh["vertices"][mesh["faces"]], 1, 0)
    np.testing.assert_allclose(mesh["normals"][mesh["faces"]], np.cross(b - a, c - a)[:, None].repeat(3, 1), atol=1e-6)
    # The cube's faces look outwards.
    assert (np.sum(mesh["normals"] * (mesh["vertices"] - 0.5), axis=1) > 0).all()
    tangents = mesh["tangents"][:, :3]
    np.testing.assert_allclose(np.sum(tangents * mesh["normals"], axis=1), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1, atol=1e-6)
    np.testing.assert_array_equal(mesh["tangents"][:, 3], 1)


def test_zero_normals_are_mended(tmp_path):
    normals = QUAD["NORMAL"].copy()
    normals[2] = 0
    np.testing.assert_allclose(read(quad(NORMAL=normals), tmp_path).mesh.normals, QUAD["NORMAL"], atol=1e-6)


def test_missing_tangents_follow_the_texture_where_one_needs_them(tmp_path):
    document = quad(TANGENT=None, TEXCOORD_0=QUAD["TEXCOORD_0"][:, ::-1].copy(), primitive={"material": 0})
    gltf.put(document, "images", {"uri": gltf.data_uri(gltf.png(PIXELS), "image/png")})
    gltf.put(document, "textures", {"source": 0})
    gltf.put(document, "materials", {"normalTexture": {"index": 0}})
    # With u and v exchanged, u grows downwards and v to the right: the tangent is -y, the bitangent -x.
    expected = np.tile([0, -1, 0, -1], (4, 1))
    np.testing.assert_allclose(read(document, tmp_path).mesh.tangents, expected, atol=1e-6)


# ---------------------------------------------------------------------------------------------------- transforms


def axis_angle(axis: np.ndarray, angle: float) -> list[float]:
    return [*(math.sin(angle / 2) * axis).tolist(), math.cos(angle / 2)]


def test_transforms_multiply_down_the_tree(tmp_path):
    document = quad(node={"translation": [1, 2, 3], "scale": [2, 3, 4]})
    gltf.node(document, children=[0], rotation=axis_angle(UNIT_Z, math.pi / 2), translation=[10, 0, 0])
    mesh = read(document, tmp_path).mesh
    x, y, z = (QUAD["POSITION"] * [2, 3, 4] + [1, 2, 3]).T
    np.testing.assert_allclose(mesh.vertices, np.stack([10 - y, x, z], axis=1), atol=1e-6)
    np.testing.assert_allclose(mesh.tangents[:, :3], np.tile([0, 1, 0], (4, 1)), atol=1e-6)


def test_a_matrix_equals_its_parts(tmp_path):
    rotation = axis_angle(np.array([0.6, 0, 0.8]), 0.7)
    x, y, z, w = rotation
    # The quaternion's product q v q* as a matrix, from its definition on the basis vectors.
    u = np.array([x, y, z])
    turned = np.stack([v + 2 * np.cross(u, np.cross(u, v) + w * v) for v in np.eye(3)], axis=1)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned * [1, -2, 0.5], [3, 4, 5]
    parts = read(quad(node={"translation": [3, 4, 5], "rotation": rotation, "scale": [1, -2, 0.5]}), tmp_path)
    whole = read(quad(node={"matrix": matrix.T.ravel().tolist()}), tmp_path)
    for name, value in numpy_of(parts.mesh).items():
        np.testing.assert_allclose(value, numpy_of(whole.mesh)[name], atol=1e-6)
    np.testing.assert_allclose(whole.mesh.vertices, QUAD["POSITION"] @ matrix[:3, :3].T + [3, 4, 5], atol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_normals_tangents_and_winding_agree_under_any_transform(tmp_path, seed):
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = rng.normal(size=(3, 3)) * [1, 1, 1e-3 if seed == 7 else 1]
    matrix[:3, 0] *= np.sign(np.linalg.det(matrix[:3, :3])) * (-1) ** seed
    mirrored = seed % 2 == 1
    mesh = numpy_of(read(quad(node={"matrix": matrix.T.ravel().tolist()}), tmp_path).mesh)
    linear = matrix[:3, :3]
    normal = np.linalg.inv(linear).T @ UNIT_Z
    np.testing.assert_allclose(mesh["normals"][0], normal / np.linalg.norm(normal), atol=2e-6)
    tangent, w = mesh["tangents"][0, :3], mesh["tangents"][0, 3]
    np.testing.assert_allclose(tangent, linear @ UNIT_X / np.linalg.norm(linear @ UNIT_X), atol=2e-6)
    # The bitangent stays on the side of the transformed one, and faces keep their outside.
    assert w == (-1 if mirrored else 1)
    assert w * np.cross(mesh["normals"][0], tangent) @ (linear @ UNIT_Y) > 0
    a, b, c = mesh["vertices"][mesh["faces"][0]].astype(np.float64)
    assert np.cross(b - a, c - a) @ normal > 0


def test_flattened_meshes_keep_unit_normals(tmp_path):
    mesh = numpy_of(read(quad(node={"scale": [1, 1, 0]}), tmp_path).mesh)
    np.testing.assert_array_equal(mesh["normals"], QUAD["NORMAL"])
    mesh = numpy_of(read(quad(node={"scale": [0, 0, 0]}), tmp_path).mesh)
    np.testing.assert_allclose(np.linalg.norm(mesh["normals"], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(mesh["tangents"][:, :3], axis=1), 1, atol=1e-6)


def test_instances_and_the_chosen_scene(tmp_path):
    document = quad()
    for x in (1, 2):
        gltf.node(document, mesh=0, translation=[x, 0, 0])
    document["scenes"] = [{"nodes": [0]}, {"nodes": [2, 1]}]
    assert read(document, tmp_path).mesh.faces.shape == (2, 3)
    document["scene"] = 1
    mesh = numpy_of(read(document, tmp_path).mesh)
    np.testing.assert_array_equal(mesh["vertices"][:, 0], [1, 2, 2, 1, 2, 3, 3, 2])
    np.testing.assert_array_equal(mesh["faces"][2:], mesh["faces"][:2] + 4)
    del document["scene"], document["scenes"]
    assert read(document, tmp_path).mesh.faces.shape == (6, 3)


def test_a_deep_chain_is_no_recursion(tmp_path):
    document = quad()
    for i in range(5000):
        gltf.node(document, children=[i], translation=[1, 0, 0])
    assert float(read(document, tmp_path).mesh.vertices[0, 0]) == 5000


# ---------------------------------------------------------------------------------------------------- materials

TEXTURED = {
    "name": "all",
    "pbrMetallicRoughness": {
        "baseColorFactor": [0.1, 0.002, 0.3, 0.25],
        "baseColorTexture": {"index": 0},
        "metallicFactor": 0.7,
        "roughnessFactor": 0.123,
        "metallicRoughnessTexture": {"index": 1},
    },
    "normalTexture": {"index": 2, "scale": -1.5},
    "occlusionTexture": {"index": 3, "strength": 0.75},
    "emissiveTexture": {"index": 4},
    "emissiveFactor": [0.5, 1.0, 0.25],
    "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8.0}},
    "doubleSided": True,
}


def textured(folder) -> tuple[dict, list[np.ndarray]]:
    """A document with a material that has everything, five pictures stored in every way, and the pictures."""
    document = quad({"material": 1})
    document["materials"] = [{}, copy.deepcopy(TEXTURED)]
    document["extensionsUsed"] = ["KHR_materials_emissive_strength"]
    pictures = [RNG.integers(0, 256, (2 + i, 5, 4)).astype(np.uint8) for i in range(5)]
    files = [gltf.png(p) for p in pictures]
    (folder / "a b.png").write_bytes(files[0])
    (folder / "sub").mkdir(exist_ok=True)
    (folder / "sub" / "c.png").write_bytes(files[1])
    document["images"] = [
        {"uri": "a%20b.png"},
        {"uri": "sub/../sub/c.png"},
        *({"uri": gltf.data_uri(files[i], "image/png")} for i in (2, 3)),
        {"bufferView": gltf.view(document, files[4]), "mimeType": "image/png"},
    ]
    document["samplers"] = [{"wrapS": 33071, "wrapT": 33648}, {"wrapT": 33071}, {}]
    document["textures"] = [{"source": i, **({"sampler": i} if i < 3 else {})} for i in range(5)]
    return document, pictures


def level(textures, row: int, mip: int = 0) -> np.ndarray:
    offset, width, height = np.asarray(textures.levels)[row, mip]
    return np.asarray(textures.texels)[offset : offset + width * height].reshape(height, width, 4)


def linear(encoded: np.ndarray) -> np.ndarray:
    color = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return np.concatenate([color[..., :3], encoded[..., 3:]], axis=-1)


def test_material_factors_are_exact(tmp_path):
    asset = read(textured(tmp_path)[0], tmp_path)
    plain, full = ({name: value[i] for name, value in numpy_of(asset.materials).items()} for i in (0, 1))
    expected = {
        "base_color": [0.1, 0.002, 0.3, 0.25],
        "metallic": 0.7,
        "roughness": 0.123,
        "emissive": [4, 8, 2],
        "normal_scale": -1.5,
        "occlusion_strength": 0.75,
        "double_sided": True,
    }
    for name, value in expected.items():
        np.testing.assert_array_equal(full[name], np.array(value, full[name].dtype))
    defaults = {"base_color": [1] * 4, "metallic": 1, "roughness": 1, "emissive": [0] * 3, "normal_scale": 1}
    defaults |= {"occlusion_strength": 1, "double_sided": False}
    defaults |= {name: -1 for name in plain if name.endswith("_texture")}
    assert "uv_sets" not in plain and "unlit" not in plain
    assert plain.keys() == defaults.keys()
    for name, value in defaults.items():
        np.testing.assert_array_equal(plain[name], value)
    np.testing.assert_array_equal(asset.mesh.material, [1, 1])
    assert asset.notes == ()


def test_textures_are_linear_and_wrap_as_told(tmp_path):
    document, pictures = textured(tmp_path)
    asset = read(document, tmp_path)
    slots = ("base_color", "metallic_roughness", "normal", "occlusion", "emissive")
    wraps = [(1, 2), (0, 1), (0, 0), (0, 0), (0, 0)]
    for slot, picture, wrap in zip(slots, pictures, wraps):
        row = int(numpy_of(asset.materials)[f"{slot}_texture"][1])
        encoded = picture / 255
        expected = linear(encoded) if slot in ("base_color", "emissive") else encoded
        np.testing.assert_allclose(level(asset.textures, row), expected, rtol=2e-6, atol=1e-7)
        assert tuple(np.asarray(asset.textures.wrap)[row]) == wrap
        last = level(asset.textures, row, asset.textures.levels.shape[1] - 1)
        np.testing.assert_allclose(last[0, 0], expected.mean(axis=(0, 1)), rtol=1e-5)
    assert asset.textures.levels.shape[0] == 5


def test_equal_textures_share_a_row(tmp_path):
    document, _ = textured(tmp_path)
    document["textures"][4]["source"] = 0  # emission as base colour, but wrapped otherwise
    document["textures"][3] = {"source": 2, "sampler": 2}  # occlusion as normal
    document["textures"].append({"source": 0, "sampler": 0})
    document["materials"][0] = {  # base colour as that of the other material, occlusion with its image, not its space
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 5}},
        "occlusionTexture": {"index": 0},
    }
    asset = read(document, tmp_path)
    materials = numpy_of(asset.materials)
    assert materials["base_color_texture"][0] == materials["base_color_texture"][1]
    assert materials["normal_texture"][1] == materials["occlusion_texture"][1]
    rows = {int(row) for name, column in materials.items() if name.endswith("_texture") for row in column}
    assert rows == {-1, 0, 1, 2, 3, 4}
    assert asset.textures.levels.shape[0] == 5


def test_a_primitive_without_material_gets_the_default(tmp_path):
    document = quad()
    document["materials"] = [{"pbrMetallicRoughness": {"roughnessFactor": 0.5}}]
    asset = read(document, tmp_path)
    np.testing.assert_array_equal(asset.mesh.material, [1, 1])
    np.testing.assert_array_equal(asset.materials.roughness, np.float32([0.5, 1.0]))


# ---------------------------------------------------------------------------------------------------- lights, cameras


def lit(*lights: dict, nodes: list[dict]) -> dict:
    document = quad()
    document["extensionsUsed"] = document["extensionsRequired"] = ["KHR_lights_punctual"]
    document["extensions"] = {"KHR_lights_punctual": {"lights": list(lights)}}
    for i, node in enumerate(nodes):
        gltf.node(document, extensions={"KHR_lights_punctual": {"light": i}}, **node)
    return document


def test_lights(tmp_path):
    down = axis_angle(UNIT_X, -math.pi / 2)  # -Z becomes -Y
    document = lit(
        {"type": "directional", "color": [1, 0.5, 0.25], "intensity": 2049},
        {"type": "point", "intensity": 40, "range": 7},
        {"type": "spot", "intensity": 3, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.9}},
        {"type": "spot", "color": [0, 1, 0], "spot": {}},
        nodes=[
            {"rotation": down, "scale": [5, 5, 5]},
            {"translation": [1, 2, 3], "scale": [5, 5, 5]},
            {"rotation": down, "translation": [4, 5, 6]},
            {"scale": [1, 1, -1]},
        ],
    )
    asset = read(document, tmp_path)
    directional, point, spot = (numpy_of(getattr(asset.lights, kind)) for kind in ("directional", "point", "spot"))
    np.testing.assert_allclose(directional["direction"], [[0, -1, 0]], atol=1e-7)
    np.testing.assert_array_equal(directional["irradiance"], [[2049, 1024.5, 512.25]])
    np.testing.assert_array_equal(point["position"], [[1, 2, 3]])
    np.testing.assert_array_equal(point["intensity"], [[40, 40, 40]])
    np.testing.assert_array_equal(point["range"], [7])
    np.testing.assert_array_equal(spot["position"], [[4, 5, 6], [0, 0, 0]])
    np.testing.assert_allclose(spot["direction"], [[0, -1, 0], [0, 0, 1]], atol=1e-7)
    np.testing.assert_array_equal(spot["intensity"], [[3, 3, 3], [0, 1, 0]])
    np.testing.assert_array_equal(spot["range"], [np.inf, np.inf])
    np.testing.assert_array_equal(spot["inner"], np.float32([0.2, 0]))
    np.testing.assert_array_equal(spot["outer"], np.float32([0.9, math.pi / 4]))
    assert asset.notes == ()
    assert all(array.dtype == np.float32 for kind in (directional, point, spot) for array in kind.values())


def filmed(lens: dict, **node) -> dict:
    document = quad()
    gltf.put(document, "cameras", {"type": "perspective", "perspective": lens})
    gltf.node(document, camera=0, **node)
    return document


def test_cameras_are_rigid_and_keep_their_fov(tmp_path):
    lens = {"yfov": 0.7, "znear": 0.5, "zfar": 20, "aspectRatio": 3.0}
    document = filmed(lens, rotation=axis_angle(UNIT_Y, math.pi / 2), translation=[1, 2, 3], scale=[2, 3, 4])
    gltf.put(document, "cameras", {"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.5}})
    gltf.node(document, camera=1, scale=[-1, 1, 1])
    first, second = read(document, tmp_path).cameras
    pose = np.asarray(first.world_from_view)
    np.testing.assert_allclose(pose, [[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1]], atol=1e-7)
    clip = np.asarray(first.clip_from_view, np.float64)
    # The picture's upper edge at half the field of view, w at the near plane and 0 at the far.
    top = clip @ [0, math.tan(0.35), -1, 1]
    assert top[1] / top[3] == pytest.approx(1, rel=1e-6)
    assert (clip @ [0, 0, -0.5, 1])[2] == pytest.approx(0.5, rel=1e-6)
    assert (clip @ [0, 0, -20, 1])[2] == pytest.approx(0, abs=1e-6)
    assert clip[0, 0] == clip[1, 1]
    # Infinite far, and no mirrored pictures.
    np.testing.assert_array_equal(np.asarray(second.clip_from_view)[2], [0, 0, 0, 0.5])
    np.testing.assert_allclose(second.world_from_view, np.eye(4), atol=1e-7)


# ---------------------------------------------------------------------------------------------------- what is left out


def edit(document: dict, path: str, value) -> dict:
    """A document with one member replaced, or removed (None)."""
    target = document
    *parents, last = [int(key) if key.isdigit() else key for key in path.split("/")[1:]]
    for key in parents:
        target = target.setdefault(key, {}) if isinstance(target, dict) else target[key]
    if value is None:
        del target[last]
    elif isinstance(target, list) and last == len(target):
        target.append(value)
    else:
        target[last] = value
    return document


THIRD_UV = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "texCoord": 2}}}
PEARL = {"extensions": {"KHR_materials_specular": {"specularTexture": {"index": 0}}}}
NOTES = [
    ("/extensionsUsed", ["EXT_a", "EXT_a", "EXT_b"], "extensions are ignored: EXT_a, EXT_b"),
    ("/animations", [{}], "animations are ignored"),
    ("/meshes/0/primitives/0/attributes/JOINTS_0", 2, "skins are ignored: /meshes/0/primitives/0"),
    ("/meshes/0/primitives/0/targets", [{}], "morph targets are ignored: /meshes/0/primitives/0"),
    ("/meshes/0/primitives/1", {"mode": 0, "attributes": {}}, "points are left out: /meshes/0/primitives/1"),
    ("/meshes/0/primitives/1", {"mode": 3, "attributes": {}}, "line strips are left out: /meshes/0/primitives/1"),
    ("/materials", [PEARL] * 7, "specularTexture is ignored: /materials/0/.*, .* and 2 more"),
    (
        "/materials",
        [{"pbrMetallicRoughness": {"metallicFactor": 2.0}}],
        r"metallicFactor is clamped to \[0, 1\]: /materials/0/pbrMetallicRoughness",
    ),
    (
        "/materials",
        [{"emissiveFactor": [-1.0, 5.0, 0.0]}],
        r"emissiveFactor is clamped to \[0, 1\.844e\+18\]: /materials/0",
    ),
    (
        "/materials",
        [THIRD_UV, THIRD_UV],
        "texture coordinates beyond the second are replaced by the first: .*/0/.*/baseColorTexture, .*/1/.*",
    ),
    (
        "/materials",
        [{"normalTexture": {"index": 1}}],
        "textures without a PNG, JPEG or WebP are left out: /textures/1",
    ),
    ("/nodes/0/rotation", [0, 0, 0, 2], "a rotation that is no unit quaternion is scaled to one: /nodes/0"),
    ("/nodes/0/rotation", [0, 0, 0, 0], "a rotation that is no unit quaternion is taken as none: /nodes/0"),
    ("/nodes/0/scale", [1, 0, 1], "a scale of 0 flattens what hangs on a node: /nodes/0"),
    ("/materials", [PEARL], "specularTexture is ignored: /materials/0/extensions/KHR_materials_specular"),
]


@pytest.mark.parametrize(("path", "value", "note"), NOTES, ids=[note.split(":")[0] for *_, note in NOTES])
def test_exactly_one_note_for_each_thing_left_out(tmp_path, path, value, note):
    document = filmed({"yfov": 1, "znear": 1})
    gltf.node(document, mesh=0, camera=0)  # the same things twice
    gltf.put(document, "images", {"uri": gltf.data_uri(gltf.png(PIXELS))})
    document["textures"] = [{"source": 0}, {}]
    notes = read(edit(document, path, value), tmp_path).notes
    assert len(notes) == 1
    assert re.fullmatch(note, notes[0])


# ---------------------------------------------------------------------------------------------------- broken files

P = "/meshes/0/primitives/0"
TRIS = f"{P}/indices"


def positions(value: float) -> np.ndarray:
    array = QUAD["POSITION"].copy()
    array[2, 1] = value
    return array


ERRORS = [
    # path edited, new value, place named, message
    ("/asset", None, "/asset", "version is missing"),
    ("/asset/version", "1.0", "/asset/version", "is '1.0', but only glTF 2.0"),
    ("/asset/minVersion", "2.1", "/asset/minVersion", "is '2.1', but only glTF 2.0"),
    ("/extensionsRequired", ["KHR_draco_mesh_compression"], "/", "requires KHR_draco_mesh_compression, which is not"),
    ("/extensionsRequired", ["KHR_texture_basisu"], "/", "requires KHR_texture_basisu, which is not supported"),
    ("/extensionsRequired", [1], "/extensionsRequired/0", "expected a string, got 1"),
    ("/extensionsUsed", [[]], "/extensionsUsed/0", r"expected a string, got \[\]"),
    ("/nodes", None, "/", "contains no triangles"),
    ("/nodes/0", {}, "/", "contains no triangles"),
    (f"{P}/mode", 1, "/", "contains no triangles"),
    (f"{P}/mode", 99, P, "mode is 99"),
    ("/nodes/0/mesh", 5, "/nodes/0/mesh", "is 5, but there are 1"),
    ("/nodes/0/mesh", "0", "/nodes/0/mesh", 'expected an integer, got "0"'),
    ("/nodes/0/mesh", True, "/nodes/0/mesh", "expected an integer, got true"),
    ("/nodes/0/children", [0], "/nodes/0", "is its own ancestor: 0 → 0"),
    ("/nodes/0/children", [7], "/nodes/0/children/0", "is 7, but there are 1"),
    ("/nodes/0/children", 7, "/nodes/0/children", "expected an array, got 7"),
    ("/nodes/0/matrix", [1.0] * 15, "/nodes/0/matrix", "has 15 numbers, but 16"),
    ("/nodes/0/matrix", [1.0] * 16, "/nodes/0", r"ends in the row \[1.0, 1.0, 1.0, 1.0\]"),
    ("/nodes/0/scale", [2, 1, "x"], "/nodes/0/scale/2", 'expected a finite number, got "x"'),
    (
        "/nodes/0/translation",
        [1e19, 0, 0],
        "/nodes/0",
        r"its world transform holds 1e\+19; at most 1\.844e\+18 is drawn",
    ),
    ("/nodes/0/scale", [1, 1e39, 1], "/nodes/0/scale/1", r"is 1e\+39, too large for a float32"),
    ("/scene", 3, "/scene", "is 3, but there are 0"),
    (f"{P}/attributes/POSITION", None, f"{P}/attributes", "POSITION is missing"),
    (f"{P}/attributes/NORMAL", 4, "/accessors/4", "has 1 components, but 3 are needed"),
    ("/accessors/1/count", 3, f"{P}/attributes", "NORMAL has 3 elements for 4 vertices"),
    (f"{P}/attributes/TEXCOORD_0", 0, "/accessors/0", "has 3 components, but 2 are needed"),
    (f"{P}/material", 0, P, "material is 0, but there are 0"),
    (TRIS, 2, TRIS, "are not unsigned integers"),
    (TRIS, 77, TRIS, "is 77, but there are 5"),
    ("/accessors/4/count", 5, TRIS, "5 corners do not make whole triangles"),
    ("/accessors/4/count", 0, "/accessors/4/count", "is 0, but at least 1"),
    ("/accessors/4/count", -3, "/accessors/4/count", "is -3, but at least 1"),
    ("/accessors/4/count", 2.5, "/accessors/4/count", "expected an integer, got 2.5"),
    ("/accessors/4/count", 9, "/accessors/4", "needs 18 bytes of its view, which has 12"),
    ("/accessors/0/count", 2_000_000_000, "/accessors/0", "needs 24000000000 bytes of its view, which has 48"),
    ("/accessors/0/byteOffset", 4, "/accessors/0", "needs 52 bytes"),
    ("/accessors/0/byteOffset", -4, "/accessors/0/byteOffset", "is -4, but at least 0"),
    ("/accessors/0/type", "MAT4", "/accessors/0/type", "is 'MAT4', but only SCALAR"),
    ("/accessors/0/componentType", 5130, "/accessors/0/componentType", "is 5130, not one of 5120"),
    ("/accessors/0/bufferView", 9, "/accessors/0/bufferView", "is 9, but there are 5"),
    ("/bufferViews/0/byteStride", 4, "/accessors/0", "byteStride is 4, less than an element's 12 bytes"),
    ("/bufferViews/0/byteLength", 10**6, "/bufferViews/0", "ends at byte 1000000 of a buffer of 204"),
    ("/bufferViews/0/byteLength", None, "/bufferViews/0", "byteLength is missing"),
    ("/bufferViews/0/buffer", 1, "/bufferViews/0/buffer", "is 1, but there are 1"),
    ("/buffers", [{"byteLength": 10**6}], "/buffers/0", "byteLength is 1000000, but only 204 bytes are there"),
    ("/buffers", [{"byteLength": 204, "uri": "gone.bin"}], "/buffers/0/uri", "gone.bin cannot be read: No such file"),
    ("/buffers", [{"byteLength": 204, "uri": "http://x.org/a.bin"}], "/buffers/0/uri", "not a relative file name"),
    ("/buffers", [{"byteLength": 204, "uri": "file:///etc/passwd"}], "/buffers/0/uri", "not a relative file name"),
    ("/buffers", [{"byteLength": 204, "uri": "/etc/passwd"}], "/buffers/0/uri", "outside the file's folder"),
    ("/buffers", [{"byteLength": 204, "uri": "a/..%2F../b"}], "/buffers/0/uri", "outside the file's folder"),
    ("/buffers", [{"byteLength": 204, "uri": "data:;base64,@@"}], "/buffers/0/uri", "not valid base64"),
    ("/buffers", [{"byteLength": 204, "uri": "data:"}], "/buffers/0/uri", "without a comma"),
    ("/materials", [{"normalTexture": {}, "doubleSided": 1}], "/materials/0/doubleSided", "expected true or false"),
    ("/materials", [{"normalTexture": {"scale": 2}}], "/materials/0/normalTexture", "index is missing"),
    ("/materials", [{"normalTexture": {"index": 0}}], "/materials/0/normalTexture/index", "is 0, but there are 0"),
    ("/materials", [[]], "/materials/0", "expected an object"),
    ("/cameras", [{"type": "perspective"}], None, None),
]


@pytest.mark.parametrize(("path", "value", "where", "message"), ERRORS)
def test_broken_documents(tmp_path, path, value, where, message):
    document = edit(quad(), path, value)
    if where is None:  # what nothing uses is not looked at
        read(document, tmp_path)
        return
    file = gltf.write(document, tmp_path / "model")
    with pytest.raises(InputError, match=message) as caught:
        read_gltf(file)
    assert (caught.value.file, caught.value.where) == (str(file), where)
    assert "\n" not in str(caught.value)


LIGHT_ERRORS = [
    ({"type": "area"}, {}, "/extensions/KHR_lights_punctual/lights/0/type", "is 'area', not one of"),
    ({"type": "point", "intensity": -1}, {}, "/extensions/KHR_lights_punctual/lights/0/intensity", "is -1, which"),
    ({"type": "directional"}, {"scale": [0, 0, 0]}, "/nodes/1", "no direction to look in"),
    (
        {"type": "spot", "spot": {"innerConeAngle": 1.0}},
        {},
        "/extensions/KHR_lights_punctual/lights/0/spot/innerConeAngle",
        "is 1, which is not in",
    ),
    ({"type": "point", "color": [0, 1e30, 0]}, {}, "/extensions/KHR_lights_punctual/lights/0/color/1", "is 1e"),
]


@pytest.mark.parametrize(("light", "node", "where", "message"), LIGHT_ERRORS)
def test_broken_lights(tmp_path, light, node, where, message):
    with pytest.raises(InputError, match=message) as caught:
        read(lit(light, nodes=[node]), tmp_path)
    assert caught.value.where == where


@pytest.mark.parametrize("lens", [{"yfov": 0, "znear": 1}, {"yfov": 1, "znear": 0}, {"yfov": 1, "znear": 2, "zfar": 1}])
def test_broken_cameras(tmp_path, lens):
    with pytest.raises(InputError, match="needs 0 < yfov") as caught:
        read(filmed(lens), tmp_path)
    assert caught.value.where == "/cameras/0/perspective"


def test_indices_beyond_the_vertices(tmp_path):
    for index in (4, 65535):
        document = gltf.new()
        corners = np.array([0, 1, 2, 0, 2, index], np.uint16)
        gltf.node(document, mesh=gltf.mesh(document, corners, **QUAD))
        with pytest.raises(InputError, match=f"{TRIS}: index {index} but only 4 vertices; export it again, or drop it"):
            read(document, tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_positions_that_are_not_finite(tmp_path, value):
    with pytest.raises(InputError, match="/accessors/0: 1 of 4 elements are not finite"):
        read(quad(POSITION=positions(value)), tmp_path)


def test_positions_and_transforms_that_overflow(tmp_path):
    with pytest.raises(InputError, match=r"/nodes/0: puts vertices 1e\+38 m away; at most 1\.844e\+18 are drawn"):
        read(quad(POSITION=positions(1e38)), tmp_path)
    document = quad(node={"scale": [1e15, 1, 1]})
    gltf.node(document, children=[0], scale=[1e15, 1, 1])
    with pytest.raises(InputError, match=r"/nodes/0: its world transform holds 1e\+30"):
        read(document, tmp_path)


def test_claims_without_data_are_not_believed(tmp_path):
    document = edit(quad(), "/accessors/0/bufferView", None)
    document["accessors"][0]["count"] = 10**12
    with pytest.raises(LimitError, match="/accessors/0: brings what it claims without data to 12000000000000"):
        read(document, tmp_path)


def test_cycles_and_two_parents(tmp_path):
    document = quad()
    for children in ([2], [3], [1]):
        gltf.node(document, children=children)
    with pytest.raises(InputError, match="/nodes/1: is its own ancestor: 1 → 2 → 3 → 1"):
        read(document, tmp_path)
    document["nodes"] = [{"mesh": 0}, {"children": [0]}, {"children": [0]}]
    with pytest.raises(InputError, match="/nodes/2: node 0 is a child of both 1 and 2"):
        read(document, tmp_path)
    document["nodes"].pop()
    document["scenes"] = [{"nodes": [0]}]
    with pytest.raises(InputError, match="/scenes/0: its root node 0 is a child of node 1"):
        read(document, tmp_path)


@pytest.mark.parametrize("name", ["gone.png", "broken.png"])
def test_missing_and_broken_pictures(tmp_path, name):
    (tmp_path / "broken.png").write_bytes(gltf.png(PIXELS)[:50])
    document = quad()
    document |= {
        "images": [{"uri": name}],
        "textures": [{"source": 0}],
        "materials": [{"emissiveTexture": {"index": 0}}],
    }
    with pytest.raises(InputError, match=rf"model\.glb: /images/0.*{name}"):
        read(document, tmp_path)
    document["images"] = [{"uri": name, "bufferView": 0}]
    with pytest.raises(InputError, match=r"/images/0: needs either a uri or a bufferView"):
        read(document, tmp_path)


TEXTS = [
    (b"", "model.gltf: is empty"),
    (b"{", "model.gltf: line 1 column 2: is not JSON"),
    (b'{\n  "asset": ,\n}', "model.gltf: line 2 column 12: is not JSON"),
    (b"[]", r"model.gltf: /: expected an object, got \[\]"),
    (b'{"asset": NaN}', "is not JSON: it holds NaN"),
    (b'{"asset": {"version": "2.0"}, "nodes": [{"scale": [1e400, 1, 1]}]}', "expected a finite number, got Infinity"),
    (b'{"asset": {"version": "2.0"}, "scene": 1' + b"0" * 5000 + b"}", "expected an integer"),
    (b"\xff\xfe{\0}\0", "byte 0: is not UTF-8"),
    (b"[" * 100_000, "nested too deeply"),
    (b'{"asset": {"version": "2.0"}}', "contains no triangles"),
    (b'\xef\xbb\xbf{"asset": {"version": "2.0"}}', "contains no triangles"),
]


@pytest.mark.parametrize(("text", "message"), TEXTS, ids=[message for _, message in TEXTS])
def test_broken_text(tmp_path, text, message):
    (tmp_path / "model.gltf").write_bytes(text)
    with pytest.raises(InputError, match=message):
        read_gltf(tmp_path / "model.gltf")


def header(magic=b"glTF", version=2, length=None, data=b"") -> bytes:
    return struct.pack("<4sII", magic, version, 12 + len(data) if length is None else length) + data


CHUNK = struct.pack("<II", 4, 0x4E4F534A) + b"{}  "
GLBS = [
    (b"glTF", "a GLB has at least 20 bytes, this one 4"),
    (header(magic=b"GLTF", data=CHUNK), "a GLB begins with b'glTF', this one with b'GLTF'"),
    (header(version=1, data=CHUNK), "is GLB version 1"),
    (header(length=1234, data=CHUNK), "says 1234 bytes, the file has 24; it is cut off"),
    (header(data=struct.pack("<II", 900, 0x4E4F534A) + b"{}  "), "chunk 0: says 900 bytes, but 4 are left"),
    (header(data=struct.pack("<II", 4, 0x004E4942) + b"{}  "), "chunk 0: is not the JSON"),
    (header(data=CHUNK), "/asset: version is missing"),
]


@pytest.mark.parametrize(("data", "message"), GLBS, ids=[message for _, message in GLBS])
def test_broken_containers(tmp_path, data, message):
    (tmp_path / "model.glb").write_bytes(data)
    with pytest.raises(InputError, match=message):
        read_gltf(tmp_path / "model.glb")


def test_every_truncation_is_noticed(tmp_path):
    data = gltf.write(quad(), tmp_path / "whole").read_bytes()
    for size in range(0, len(data), 4):
        (tmp_path / "cut.glb").write_bytes(data[:size])
        with pytest.raises(InputError):
            read_gltf(tmp_path / "cut.glb")
    binary = gltf.write(quad(), tmp_path / "files", "files").with_suffix(".bin")
    for size in (0, 100, binary.stat().st_size - 1):
        binary.write_bytes(binary.read_bytes()[:size])
        with pytest.raises(InputError, match="/buffers/0"):
            read_gltf(tmp_path / "files.gltf")
