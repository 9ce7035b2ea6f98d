"""The built-in scenes written as glTF and read back: every number that the format keeps comes back bit for bit."""

import gltf_writer as gltf
import numpy as np
import pytest

from jaxraster.io.gltf import read_gltf
from jaxraster.scene import TEXTURE_SLOTS
from jaxraster.scenes import SCENES

INFOS = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "occlusionTexture", "emissiveTexture")
SRGB = ("base_color", "emissive")


def image(textures, row: int) -> np.ndarray:
    offset, width, height = np.asarray(textures.levels)[row, 0]
    return np.asarray(textures.texels)[offset : offset + width * height].reshape(height, width, 4)


def encode(linear: np.ndarray, srgb: bool) -> np.ndarray:
    color = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return np.rint(255 * (color if srgb else linear)[..., :3]).astype(np.uint8)


def write_material(document: dict, scene, row: int) -> None:
    """A row of the materials, its textures as 8-bit pictures."""
    m = scene.materials
    infos = {}
    for slot, info in zip(TEXTURE_SLOTS, INFOS):
        if (index := int(getattr(m, f"{slot}_texture")[row])) >= 0:
            codes = encode(image(scene.textures, index), slot in SRGB)
            source = gltf.put(document, "images", {"uri": gltf.data_uri(gltf.png(codes), "image/png")})
            infos[info] = {"index": gltf.put(document, "textures", {"source": source})}
    for info, key, values in (
        ("normalTexture", "scale", m.normal_scale),
        ("occlusionTexture", "strength", m.occlusion_strength),
    ):
        if info in infos:
            infos[info][key] = float(values[row])
    pbr = {"baseColorFactor": m.base_color[row].tolist(), "metallicFactor": float(m.metallic[row])}
    pbr |= {"roughnessFactor": float(m.roughness[row])}
    pbr |= {info: infos.pop(info) for info in INFOS[:2] if info in infos}
    # The format holds emission as a colour of at most 1 and a strength; powers of two keep every bit.
    strength = 2.0 ** np.ceil(np.log2(max(1.0, float(m.emissive[row].max()))))
    item = {"pbrMetallicRoughness": pbr, "doubleSided": bool(m.double_sided[row]), **infos}
    item["emissiveFactor"] = (np.asarray(m.emissive[row], np.float64) / strength).tolist()
    item["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
    gltf.put(document, "materials", item)


def aim(direction: np.ndarray) -> dict:
    """The matrix of a node whose -Z is `direction`."""
    back = -direction / np.linalg.norm(direction)
    right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
    right /= np.linalg.norm(right)
    return {
        "matrix": np.block([[np.stack([right, np.cross(back, right), back]), np.zeros((3, 1))], [0, 0, 0, 1]])
        .ravel()
        .tolist()
    }


def write_lights(document: dict, lights) -> None:
    rows = []
    for direction, irradiance in zip(np.asarray(lights.directional.direction, float), lights.directional.irradiance):
        rows.append(({"type": "directional", "color": irradiance.tolist()}, aim(direction)))
    for i, position in enumerate(np.asarray(lights.spot.position, float)):
        cone = {"innerConeAngle": float(lights.spot.inner[i]), "outerConeAngle": float(lights.spot.outer[i])}
        node = aim(np.asarray(lights.spot.direction[i], float))
        node["matrix"][12:15] = position.tolist()
        rows.append(({"type": "spot", "color": lights.spot.intensity[i].tolist(), "spot": cone}, node))
    for i, position in enumerate(np.asarray(lights.point.position, float)):
        node = {"translation": position.tolist()}
        rows.append(({"type": "point", "color": lights.point.intensity[i].tolist()}, node))
    document["extensions"] = {"KHR_lights_punctual": {"lights": [light for light, _ in rows]}}
    for i, (_, node) in enumerate(rows):
        gltf.node(document, extensions={"KHR_lights_punctual": {"light": i}}, **node)


def export(scene, camera) -> dict:
    document, mesh = (
        gltf.new(),
        {name: np.asarray(value) for name, value in vars(scene.mesh).items() if value is not None},
    )
    names = {"POSITION": "vertices", "NORMAL": "normals", "TANGENT": "tangents", "TEXCOORD_0": "uvs"}
    shared = {name: gltf.accessor(document, mesh[field]) for name, field in names.items()}
    # One primitive for each run of faces of one material, all of the same vertices, keeps the faces' order.
    starts = np.flatnonzero(np.diff(mesh["material"], prepend=-1))
    primitives = []
    for start, stop in zip(starts, [*starts[1:], len(mesh["faces"])]):
        indices = gltf.accessor(document, mesh["faces"][start:stop].astype(np.uint32).reshape(-1))
        primitives.append({"attributes": shared, "indices": indices, "material": int(mesh["material"][start])})
    gltf.node(document, mesh=gltf.put(document, "meshes", {"primitives": primitives}))
    for row in range(len(scene.materials.metallic)):
        write_material(document, scene, row)
    write_lights(document, scene.lights)
    clip = np.asarray(camera.clip_from_view, float)
    # Row 2 of a projection with reversed depth is (0, 0, a, b), a = near / (far - near) and b = a far, or 0 and near.
    near = clip[2, 3] / (1 + clip[2, 2])
    lens = {"yfov": float(2 * np.arctan(1 / clip[1, 1])), "znear": float(near)}
    lens |= {"zfar": float(clip[2, 3] / clip[2, 2])} if clip[2, 2] else {}
    gltf.put(document, "cameras", {"type": "perspective", "perspective": lens})
    gltf.node(document, camera=0, matrix=np.asarray(camera.world_from_view, float).T.ravel().tolist())
    return document


@pytest.mark.parametrize("name", SCENES)
def test_scenes_survive(tmp_path, name):
    scene, camera = SCENES[name]()
    asset = read_gltf(gltf.write(export(scene, camera), tmp_path / name))
    faces, vertices = np.asarray(scene.mesh.faces), asset.mesh.vertices.shape[0]
    assert asset.notes == () and asset.mesh.faces.shape == faces.shape and vertices % len(scene.mesh.vertices) == 0
    np.testing.assert_array_equal(np.asarray(asset.mesh.faces) % len(scene.mesh.vertices), faces)
    np.testing.assert_array_equal(asset.mesh.material, scene.mesh.material)
    for field, bound in (("vertices", 0), ("uvs", 0), ("normals", 2e-7), ("tangents", 2e-7)):
        written, read = (np.asarray(getattr(mesh, field)) for mesh in (scene.mesh, asset.mesh))
        np.testing.assert_allclose(read[: len(written)], written, rtol=0, atol=bound, err_msg=field)
    for field, value in vars(scene.materials).items():
        if value is not None and not field.endswith("_texture"):
            unused = {"normal_scale": "normal_texture", "occlusion_strength": "occlusion_texture"}.get(field)
            there = np.asarray(getattr(scene.materials, unused)) >= 0 if unused else np.ones(len(value), bool)
            read = np.asarray(getattr(asset.materials, field))
            np.testing.assert_array_equal(read[there], np.asarray(value)[there], err_msg=field)
    for slot in TEXTURE_SLOTS:
        for old, new in zip(getattr(scene.materials, f"{slot}_texture"), getattr(asset.materials, f"{slot}_texture")):
            assert (old < 0) == (new < 0)
            if old >= 0:
                codes = [
                    encode(image(t, int(i)), slot in SRGB) for t, i in ((scene.textures, old), (asset.textures, new))
                ]
                np.testing.assert_array_equal(*codes)
    for kind in ("directional", "point", "spot"):
        for field, value in vars(getattr(scene.lights, kind)).items():
            read = getattr(getattr(asset.lights, kind), field)
            np.testing.assert_allclose(read, value, rtol=1e-6, atol=1e-6, err_msg=f"{kind}.{field}")
    np.testing.assert_allclose(asset.cameras[0].world_from_view, camera.world_from_view, atol=1e-6)
    np.testing.assert_allclose(asset.cameras[0].clip_from_view, camera.clip_from_view, rtol=2e-6, atol=1e-6)
