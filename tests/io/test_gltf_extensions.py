"""What few glTF files have: second uvs, mapped uvs, colours, strips, filters, parallel cameras, further materials."""

import math
from dataclasses import replace

import gltf_writer as gltf
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from PIL import Image

import jaxraster as jr
from jaxraster.errors import InputError
from jaxraster.io.gltf import read_gltf
from jaxraster.scene import BLEND, FIRST, LINEAR, MASK, NEAREST, OPAQUE, TEXTURE_SLOTS

QUAD = {
    "POSITION": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32),
    "NORMAL": np.tile(np.float32([0, 0, 1]), (4, 1)),
    "TEXCOORD_0": np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32),
    "TEXCOORD_1": np.array([[0.5, 1], [1, 1], [1, 0.5], [0.5, 0.5]], np.float32),
}
CORNERS = np.array([0, 1, 2, 0, 2, 3], np.uint16)
# Four quadrants of distinct greys, each 4 x 4 texels.
GREYS = np.repeat(np.repeat(np.array([[40, 90], [150, 220]], np.uint8), 4, axis=0), 4, axis=1)


def quad(materials=(), primitive=None, indices=CORNERS, **arrays) -> dict:
    """A document of the unit square with its first material, whose textures are all the four greys."""
    document = gltf.new()
    attributes = {name: array for name, array in (QUAD | arrays).items() if array is not None}
    members = ({"material": 0} if materials else {}) | (primitive or {})
    gltf.node(document, mesh=gltf.mesh(document, indices, members, **attributes))
    if materials:
        document["materials"] = list(materials)
        document["images"] = [{"uri": gltf.data_uri(gltf.png(GREYS[..., None].repeat(3, axis=2)), "image/png")}]
        document["textures"] = [{"source": 0}]
    return document


def read(document: dict, folder):
    return read_gltf(gltf.write(document, folder / "model"))


def with_extension(name: str, **members) -> dict:
    return {"extensions": {f"KHR_materials_{name}": members}}


# ---------------------------------------------------------------------------------------------------- geometry

STRIP = [0, 1, 3, 2]
FAN = [1, 2, 3, 0]
MODES = {
    "strip": (5, STRIP, [(0, 1, 3), (1, 2, 3)]),
    "fan": (6, FAN, [(2, 3, 1), (3, 0, 1)]),
    "strip of five": (5, [0, 1, 3, 2, 0], [(0, 1, 3), (1, 2, 3), (3, 2, 0)]),
    "strip that repeats a corner": (5, [0, 1, 1, 2], [(0, 1, 1), (1, 2, 1)]),
}


@pytest.mark.parametrize("name", MODES)
def test_strips_and_fans(tmp_path, name):
    """Triangle i of a strip is i, i+1, i+2, of which every second swaps the last two; of a fan i+1, i+2, 0."""
    mode, order, faces = MODES[name]
    asset = read(quad(primitive={"mode": mode}, indices=np.array(order, np.uint16)), tmp_path)
    np.testing.assert_array_equal(asset.mesh.faces, faces)
    assert asset.notes == ()


def test_strips_without_indices(tmp_path):
    order = {name: array[STRIP] for name, array in QUAD.items()}
    mesh = read(quad(primitive={"mode": 5}, indices=None, **order), tmp_path).mesh
    np.testing.assert_array_equal(np.asarray(mesh.vertices)[mesh.faces], QUAD["POSITION"][[(0, 1, 3), (1, 2, 3)]])


COLORS = {
    "float32": (np.float32([[1, 0.5, 0.25], [0, 0, 0], [1, 1, 1], [0.1, 0.2, 0.3]]), 1.0),
    "uint8": (np.array([[255, 128, 0, 64]] * 4, np.uint8), 255.0),
    "uint16": (np.array([[65535, 1, 0, 300]] * 4, np.uint16), 65535.0),
}


@pytest.mark.parametrize("kind", COLORS)
def test_vertex_colours_are_linear_and_have_alpha(tmp_path, kind):
    codes, scale = COLORS[kind]
    document = quad()
    attribute = gltf.accessor(document, codes, **({} if kind == "float32" else {"normalized": True}))
    document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = attribute
    colors = np.asarray(read(document, tmp_path).mesh.colors)
    np.testing.assert_allclose(colors[:, : codes.shape[1]], codes / np.float32(scale), rtol=1e-7)
    assert colors.shape == (4, 4) and (codes.shape[1] == 4 or (colors[:, 3] == 1).all())


def test_pieces_without_colours_are_white(tmp_path):
    document = quad(COLOR_0=np.full((4, 3), 0.5, np.float32))
    gltf.node(document, mesh=gltf.mesh(document, CORNERS, **QUAD))
    np.testing.assert_array_equal(read(document, tmp_path).mesh.colors, [[0.5, 0.5, 0.5, 1]] * 4 + [[1] * 4] * 4)


def test_second_uvs_are_kept_where_a_material_asks_for_them(tmp_path):
    info = {"index": 0}
    plain = {"pbrMetallicRoughness": {"baseColorTexture": info}, "normalTexture": info}
    for slot, material in (
        ("base_color", {**plain, "pbrMetallicRoughness": {"baseColorTexture": info | {"texCoord": 1}}}),
        ("normal", {**plain, "normalTexture": info | {"texCoord": 1}}),
    ):
        asset = read(quad([material]), tmp_path)
        np.testing.assert_array_equal(asset.mesh.second_uvs, QUAD["TEXCOORD_1"])
        assert asset.materials.uv_sets.tolist() == [[int(slot == name) for name in TEXTURE_SLOTS]]
    asset = read(quad([plain]), tmp_path)
    assert asset.mesh.second_uvs is None and asset.materials.uv_sets is None


def test_missing_tangents_follow_the_uvs_of_the_normal_map(tmp_path):
    """u runs along x in the first set, along -y in the second, and along (1, 1) where the map is turned by 45°."""
    second = np.array([[1, 0], [1, 1], [0, 1], [0, 0]], np.float32)
    turned = {"KHR_texture_transform": {"rotation": math.pi / 4}}
    half = math.sqrt(0.5)
    for info, expected in (
        ({"index": 0}, (1, 0, 0)),
        ({"index": 0, "texCoord": 1}, (0, -1, 0)),
        ({"index": 0, "extensions": turned}, (half, -half, 0)),
    ):
        mesh = read(quad([{"normalTexture": info}], TEXCOORD_1=second), tmp_path).mesh
        np.testing.assert_allclose(mesh.tangents[:, :3], np.tile(expected, (4, 1)), atol=1e-6)


# ---------------------------------------------------------------------------------------------------- textures

TRANSFORMS = {
    # members, and the uv at which the texture is looked up for (u, v)
    "offset": ({"offset": [0.25, -0.5]}, lambda u, v: (u + 0.25, v - 0.5)),
    "scale": ({"scale": [2.0, 0.5]}, lambda u, v: (2 * u, 0.5 * v)),
    "a quarter turn": ({"rotation": math.pi / 2}, lambda u, v: (v, -u)),
    "all": (
        {"offset": [1, 2], "rotation": -math.pi / 2, "scale": [3, 4]},
        lambda u, v: (1 - 4 * v, 2 + 3 * u),
    ),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_texture_transforms(tmp_path, name):
    members, expected = TRANSFORMS[name]
    info = {"index": 0, "extensions": {"KHR_texture_transform": members}}
    asset = read(quad([{"emissiveTexture": info}]), tmp_path)
    matrix = np.asarray(asset.materials.uv_transforms)[0]
    for uv in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.3, 0.7)):
        np.testing.assert_allclose(matrix[4, :, :2] @ uv + matrix[4, :, 2], expected(*uv), atol=1e-6)
    np.testing.assert_array_equal(matrix[:4], [np.eye(2, 3)] * 4)
    assert asset.notes == ()


def test_a_transform_may_choose_the_uvs(tmp_path):
    info = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}}
    assert read(quad([{"emissiveTexture": info}]), tmp_path).materials.uv_sets.tolist() == [[0, 0, 0, 0, 1]]


FILTERS = {
    "none": ({}, None),
    "trilinear": ({"magFilter": 9729, "minFilter": 9987}, None),
    "nearest": ({"magFilter": 9728, "minFilter": 9728}, (NEAREST, NEAREST, FIRST)),
    "linear": ({"minFilter": 9729}, (LINEAR, LINEAR, FIRST)),
    "nearest, nearest level": ({"minFilter": 9984}, (LINEAR, NEAREST, NEAREST)),
    "linear, nearest level": ({"minFilter": 9985}, (LINEAR, LINEAR, NEAREST)),
    "nearest, linear levels": ({"minFilter": 9986}, (LINEAR, NEAREST, LINEAR)),
}


@pytest.mark.parametrize("name", FILTERS)
def test_sampler_filters(tmp_path, name):
    sampler, expected = FILTERS[name]
    document = quad([{"emissiveTexture": {"index": 0}}])
    document["samplers"], document["textures"][0]["sampler"] = [sampler], 0
    filters = read(document, tmp_path).textures.filters
    assert filters is None if expected is None else filters.tolist() == [[*expected]]


def test_unknown_filters(tmp_path):
    document = quad([{"emissiveTexture": {"index": 0}}])
    document["samplers"], document["textures"][0]["sampler"] = [{"magFilter": 9987}], 0
    with pytest.raises(InputError, match="/samplers/0: magFilter 9987 is not one of 9728, 9729"):
        read(document, tmp_path)


def test_webp_textures(tmp_path):
    """A WebP is taken where the extension names one, whatever the fallback for others is."""
    Image.fromarray(GREYS).save(tmp_path / "a.webp", lossless=True)
    document = quad([{"occlusionTexture": {"index": 0}}])
    document["images"] = [{"uri": "gone.png"}, {"uri": "a.webp", "mimeType": "image/webp"}]
    document["textures"] = [{"source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}}]
    document["extensionsRequired"] = document["extensionsUsed"] = ["EXT_texture_webp"]
    texels = np.asarray(read(document, tmp_path).textures.texels)
    np.testing.assert_allclose(texels[:64, 0].reshape(8, 8), GREYS / 255, rtol=1e-6)


# ---------------------------------------------------------------------------------------------------- materials

MATERIALS = {
    "ior": (with_extension("ior", ior=1.8), {"ior": 1.8}),
    "ior 0": (with_extension("ior", ior=0), {"ior": 0}),
    "specular": (
        with_extension("specular", specularFactor=0.25, specularColorFactor=[1, 0.5, 2]),
        {"specular": [1, 0.5, 2, 0.25]},
    ),
    "unlit": (with_extension("unlit"), {"unlit": True}),
    "mask": ({"alphaMode": "MASK", "alphaCutoff": 0.25}, {"alpha_mode": MASK, "alpha_cutoff": 0.25}),
    "mask, default cutoff": ({"alphaMode": "MASK"}, {"alpha_mode": MASK}),
    "blend": ({"alphaMode": "BLEND"}, {"alpha_mode": BLEND}),
    "clearcoat": (
        with_extension("clearcoat", clearcoatFactor=0.5, clearcoatRoughnessFactor=0.25),
        {"clearcoat": [0.5, 0.25]},
    ),
    "sheen": (
        with_extension("sheen", sheenColorFactor=[0.5, 0.25, 1], sheenRoughnessFactor=0.75),
        {"sheen": [0.5, 0.25, 1, 0.75]},
    ),
}
RARE = ("uv_sets", "uv_transforms", "ior", "specular", "unlit", "alpha_mode", "alpha_cutoff", "clearcoat", "sheen")
NEUTRAL = {
    "ior": 1.5,
    "specular": [1] * 4,
    "unlit": False,
    "alpha_mode": OPAQUE,
    "clearcoat": [0] * 2,
    "sheen": [0] * 4,
}


@pytest.mark.parametrize("name", MATERIALS)
def test_material_extensions(tmp_path, name):
    """The factors of the material that has them, neutral ones for its neighbour, and None for what neither has."""
    material, expected = MATERIALS[name]
    asset = read(quad([material, {}]), tmp_path)
    assert {field for field in RARE if getattr(asset.materials, field) is not None} == expected.keys()
    for field, value in expected.items():
        first, second = np.asarray(getattr(asset.materials, field))
        np.testing.assert_array_equal(first, np.float32(value))
        np.testing.assert_array_equal(second, np.float32(NEUTRAL.get(field, 0.5)))


BROKEN = [
    (with_extension("ior", ior=0.5), "ior is 0.5, but 0 or at least 1 is needed"),
    (with_extension("ior", ior=-1), "is -1, which is not in"),
    ({"alphaMode": "GLASS"}, "is 'GLASS', not one of OPAQUE, MASK, BLEND"),
    ({"alphaMode": "MASK", "alphaCutoff": -1}, "is -1, which is not in"),
]


@pytest.mark.parametrize(("material", "message"), BROKEN)
def test_broken_extensions(tmp_path, material, message):
    with pytest.raises(InputError, match=f"/materials/0.*: {message}"):
        read(quad([material]), tmp_path)


# ---------------------------------------------------------------------------------------------------- cameras


def test_parallel_cameras(tmp_path):
    document = quad()
    lens = {"xmag": 4, "ymag": -2.5, "znear": 0.5, "zfar": 8}
    gltf.put(document, "cameras", {"type": "orthographic", "orthographic": lens})
    gltf.node(document, camera=0, translation=[0, 0, 3])
    (camera,) = read(document, tmp_path).cameras
    clip = np.asarray(camera.clip_from_view)
    np.testing.assert_allclose(clip @ [0, 2.5, -0.5, 1], [0, 1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(clip @ [-2.5, 0, -8, 1], [-1, 0, 0, 1], atol=1e-6)
    for change, message in (({"ymag": 0}, "needs ymag other than 0"), ({"zfar": 0.5}, "0 <= znear < zfar")):
        document["cameras"][0]["orthographic"] = lens | change
        with pytest.raises(InputError, match=f"/cameras/0/orthographic: .*{message}"):
            read(document, tmp_path)
    document["cameras"][0] = {"type": "fisheye"}
    with pytest.raises(InputError, match="/cameras/0/type: is 'fisheye', not one of perspective, orthographic"):
        read(document, tmp_path)


# ---------------------------------------------------------------------------------------------------- as it is drawn

SIZE = 24


def draw(document: dict, folder, **look):
    """The square filling the picture, its emission and base colour alone: what is looked up, in linear light."""
    asset = read(document, folder)
    scene, _ = jr.load(folder / "model.glb")
    scene = replace(scene, lights=small.scene().lights, environment=replace(scene.environment, sky=jnp.zeros(3)))
    camera = jr.Camera(
        world_from_view=jr.look_at((0.5, 0.5, 1.0), (0.5, 0.5, 0.0)), clip_from_view=jr.orthographic(0.5, 0.1, 2.0)
    )
    plan = jr.Plan(width=SIZE, height=SIZE, ambient=None, background=None, light_kinds=(), **look)
    frame = jax.jit(jr.render)(scene, camera, plan)
    assert (frame.visibility.face >= 0).all() and asset.mesh.faces.shape == scene.mesh.faces.shape
    return frame


def grey(code: int) -> float:
    return ((code / 255 + 0.055) / 1.055) ** 2.4


def test_each_texture_is_looked_up_at_its_own_uvs(tmp_path):
    """Emission shows the lower right quadrant through the second uvs, base colour the upper left, magnified by 2."""
    second = {"index": 0, "texCoord": 1}
    magnified = {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [0.5, 0.5]}}}
    sharp = {"magFilter": 9728, "minFilter": 9728, "wrapS": 33071, "wrapT": 33071}
    document = quad(
        [
            {
                "emissiveTexture": second,
                "emissiveFactor": [1, 1, 1],
                "pbrMetallicRoughness": {"baseColorTexture": magnified, "metallicFactor": 0},
            }
        ]
    )
    document["samplers"], document["textures"][0]["sampler"] = [sharp], 0
    surface = draw(document, tmp_path).surface
    np.testing.assert_allclose(surface.emissive, grey(220), rtol=1e-5)
    np.testing.assert_allclose(surface.diffuse_color, grey(40), rtol=1e-5)


def test_nearest_texels_have_sharp_edges(tmp_path):
    document = quad([{"emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1]}])
    document["samplers"], document["textures"][0]["sampler"] = [{"magFilter": 9728}], 0
    shown = np.asarray(draw(document, tmp_path).surface.emissive[..., 0])
    expected = np.array([[grey(40), grey(90)], [grey(150), grey(220)]]).repeat(SIZE // 2, 0).repeat(SIZE // 2, 1)
    np.testing.assert_allclose(shown, expected, rtol=1e-5)
    document["samplers"][0] = {"magFilter": 9729}
    blended = np.asarray(draw(document, tmp_path).surface.emissive[..., 0])
    assert 1.5 * grey(40) < blended[SIZE // 4, SIZE // 2 - 1] < 0.9 * grey(90)


def test_vertex_colours_multiply_the_base_colour(tmp_path):
    ramp = np.float32([[0, 0.25, 1, 1], [1, 0.25, 1, 1], [1, 0.25, 1, 1], [0, 0.25, 1, 1]])
    material = {"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 0.5, 1], "metallicFactor": 0}}
    shown = np.asarray(draw(quad([material], COLOR_0=ramp), tmp_path).surface.diffuse_color)
    x = (np.arange(SIZE) + 0.5) / SIZE
    np.testing.assert_allclose(shown, np.stack(np.broadcast_arrays(x[None], 0.25, 0.5), -1).repeat(SIZE, 0), atol=2e-6)


def test_unlit_shows_the_base_colour_in_any_light(tmp_path):
    material = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 1]}, **with_extension("unlit")}
    frame = draw(quad([material]), tmp_path)
    np.testing.assert_allclose(frame.hdr, np.broadcast_to([0.5, 0.25, 0.125], (SIZE, SIZE, 3)), rtol=1e-6)
    scene, camera = jr.load(tmp_path / "model.glb")
    plan, reasons = jr.plan_for(scene, camera, width=8, height=8)
    assert reasons["emission"].on and "light directional" in reasons
    lit = jax.jit(jr.render)(scene, camera, plan)
    seen = np.asarray(lit.visibility.face) >= 0
    assert seen.any()
    np.testing.assert_allclose(np.asarray(lit.hdr)[seen], np.tile([0.5, 0.25, 0.125], (seen.sum(), 1)), rtol=1e-6)


def test_ior_and_specular_scale_what_is_mirrored(tmp_path):
    for extension, f0, f90 in (
        (with_extension("ior", ior=2.0), [1 / 9] * 3, 1.0),
        (with_extension("specular", specularFactor=0.5), [0.02] * 3, 0.5),
        (with_extension("specular", specularColorFactor=[1, 2, 50]), [0.04, 0.08, 1.0], 1.0),
    ):
        surface = draw(quad([{"pbrMetallicRoughness": {"metallicFactor": 0}, **extension}]), tmp_path).surface
        np.testing.assert_allclose(surface.f0, np.broadcast_to(f0, surface.f0.shape), rtol=1e-5)
        np.testing.assert_allclose(surface.f90, f90, rtol=1e-6)
        metal = draw(quad([{"pbrMetallicRoughness": {"metallicFactor": 1}, **extension}]), tmp_path).surface
        np.testing.assert_allclose(metal.f0, 1, rtol=1e-6)
        np.testing.assert_allclose(metal.f90, 1, rtol=1e-6)
