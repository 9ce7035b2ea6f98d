"""The built-in scenes: consistent, physical, the same on every call; the Cornell box as measured."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.geometry.normals import face_normals
from jaxraster.math.transform import invert_rigid
from jaxraster.scene import LIGHT_KINDS, TEXTURE_SLOTS
from jaxraster.scenes import SCENES, cornell_box, material_grid
from jaxraster.scenes.cornell_box import CORNELL_SCALE

MADE = {name: make() for name, make in SCENES.items()}


@pytest.fixture(params=SCENES)
def name(request):
    return request.param


def test_there_are_three():
    assert sorted(SCENES) == ["cornell_box", "material_grid", "stage"]


def test_everything_is_finite_and_of_one_precision(name):
    for path, leaf in jax.tree_util.tree_flatten_with_path(MADE[name])[0]:
        assert isinstance(leaf, jax.Array) and leaf.dtype in (jnp.float32, jnp.int32, jnp.bool_), path
        assert "range" in str(path) or np.isfinite(leaf).all(), path


def test_indices_stay_inside(name):
    scene, _ = MADE[name]
    mesh, materials, textures = scene.mesh, scene.materials, scene.textures
    v, f, m = len(mesh.vertices), len(mesh.faces), len(materials.metallic)
    shapes = {n: getattr(mesh, n).shape for n in ("vertices", "normals", "tangents", "uvs", "faces", "material")}
    assert shapes == {
        "vertices": (v, 3), "normals": (v, 3), "tangents": (v, 4), "uvs": (v, 2), "faces": (f, 3), "material": (f,)
    }  # fmt: skip
    assert mesh.faces.min() == 0 and mesh.faces.max() == v - 1
    assert np.unique(mesh.material).tolist() == list(range(m)), "every material is used"
    for slot in TEXTURE_SLOTS:
        index = getattr(materials, f"{slot}_texture")
        assert index.shape == (m,) and index.min() >= -1 and index.max() < len(textures.levels)
    offset, width, height = np.asarray(textures.levels).reshape(-1, 3).T
    assert (offset + width * height).max() == len(textures.texels)


def test_frames_are_unit_and_fit_the_faces(name):
    mesh = MADE[name][0].mesh
    normals, tangents, faces = np.asarray(mesh.normals), np.asarray(mesh.tangents), np.asarray(mesh.faces)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose((normals * tangents[:, :3]).sum(1), 0, atol=1e-6)
    assert set(np.unique(tangents[:, 3])) <= {-1, 1}
    flat = np.asarray(jax.jit(face_normals)(mesh.vertices, mesh.faces))
    assert (np.einsum("fkx,fx->fk", normals[faces], flat) > 0.7).all()


def test_materials_and_lights_are_physical(name):
    scene, _ = MADE[name]
    for field in ("base_color", "metallic", "roughness", "occlusion_strength"):
        values = np.asarray(getattr(scene.materials, field))
        assert values.min() >= 0 and values.max() <= 1, field
    assert scene.materials.emissive.min() >= 0
    texels = np.asarray(scene.textures.texels)
    assert texels.min() >= 0 and texels.max() <= 1 and len(np.unique(texels)) > (100 if name == "stage" else 0)
    for kind in LIGHT_KINDS:
        lights = getattr(scene.lights, kind)
        if hasattr(lights, "direction"):
            np.testing.assert_allclose(np.linalg.norm(lights.direction, axis=1), 1, atol=1e-6)
        strength = lights.irradiance if kind == "directional" else lights.intensity
        assert (np.asarray(strength) > 0).all()


def test_scenes_do_not_change(name):
    for first, second in zip(jax.tree.leaves(MADE[name]), jax.tree.leaves(SCENES[name]())):
        np.testing.assert_array_equal(first, second)


def test_the_camera_sees_something_in_its_middle(name):
    """A ray beside the picture's very middle, where edges may meet, hits a face from its front."""
    scene, camera = MADE[name]
    view = np.asarray(invert_rigid(camera.world_from_view), np.float64)
    corners = (np.asarray(scene.mesh.vertices, np.float64) @ view[:3, :3].T + view[:3, 3])[np.asarray(scene.mesh.faces)]
    ahead = corners[(corners[..., 2] < -0.1).all(axis=1)]
    x, y = np.moveaxis(ahead[..., :2] / -ahead[..., 2:] - [0.0013, 0.0007], -1, 0)
    edges = [x[:, i - 1] * y[:, i] - x[:, i] * y[:, i - 1] for i in range(3)]
    assert (np.array(edges) > 0).all(axis=0).any()


def _area(mesh, rows):
    a, b, c = np.moveaxis(np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces)[rows]], 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 / CORNELL_SCALE**2


def _facing(mesh, axis, sign):
    return sign * np.asarray(face_normals(mesh.vertices, mesh.faces))[:, axis] > 0.999


def test_the_cornell_box_has_the_measured_size():
    mesh = MADE["cornell_box"][0].mesh
    points = np.asarray(mesh.vertices, np.float64) / CORNELL_SCALE
    np.testing.assert_allclose(np.ptp(points, axis=0), [556.0, 548.8, 559.2], rtol=1e-6)
    material, heights = np.asarray(mesh.material), points[np.asarray(mesh.faces), 1]
    ceiling, floor = heights.min(axis=1) > 548.7, heights.max(axis=1) < 0.1
    # The light fills the hole in the ceiling, and both hang downwards.
    np.testing.assert_allclose(_area(mesh, material == 3), 130 * 105, rtol=1e-6)
    np.testing.assert_allclose(_area(mesh, ceiling), 556 * 559.2, rtol=1e-6)
    np.testing.assert_allclose(_area(mesh, ceiling & (material == 0)), 556 * 559.2 - 130 * 105, rtol=1e-6)
    assert _facing(mesh, 1, -1)[ceiling].all() and _facing(mesh, 1, 1)[floor].all()
    # The floor and the back wall are trapezoids, the green wall a rectangle.
    np.testing.assert_allclose(_area(mesh, floor), (552.8 + 549.6) / 2 * 559.2, rtol=1e-6)
    np.testing.assert_allclose(_area(mesh, material == 1), 559.2 * 548.8, rtol=1e-6)
    back = (points[np.asarray(mesh.faces), 2] > 559.1).all(axis=1)
    np.testing.assert_allclose(_area(mesh, back), (549.6 + 556.0) / 2 * 548.8, rtol=1e-6)
    # Red stands on the left of the camera, which looks along +Z and so has +X there.
    assert _facing(mesh, 0, -1)[material == 2].all() and _facing(mesh, 0, 1)[material == 1].all()
    assert not np.asarray(mesh.vertices)[np.asarray(mesh.faces)[material == 2], 0].min() < 5.4


@pytest.mark.parametrize("top", [165.0, 330.0])
def test_the_cornell_blocks(top):
    mesh = MADE["cornell_box"][0].mesh
    heights = np.asarray(mesh.vertices, np.float64)[np.asarray(mesh.faces), 1] / CORNELL_SCALE
    block = np.isclose(heights.max(axis=1), top)
    lid = block & np.isclose(heights.min(axis=1), top)
    assert block.sum() == 10 and lid.sum() == 2 and _facing(mesh, 1, 1)[lid].all()
    # Corners by the shoelace formula; the measured blocks are 160 mm square to within a few mm.
    corners = {
        165.0: [(130, 65), (82, 225), (240, 272), (290, 114)],
        330.0: [(423, 247), (265, 296), (314, 456), (472, 406)],
    }
    x, z = np.array(corners[top], float).T
    exact = abs((x * np.roll(z, -1) - z * np.roll(x, -1)).sum()) / 2
    np.testing.assert_allclose(_area(mesh, lid), exact, rtol=1e-6)
    around = np.hypot(np.roll(x, -1) - x, np.roll(z, -1) - z).sum()
    np.testing.assert_allclose(_area(mesh, block & ~lid), around * top, rtol=1e-6)
    # Every side faces away from the block's middle.
    flat = np.asarray(face_normals(mesh.vertices, mesh.faces))
    centres = np.asarray(mesh.vertices)[np.asarray(mesh.faces)].mean(axis=1)
    outwards = centres - np.array([x.mean(), top / 2, z.mean()]) * CORNELL_SCALE
    assert ((flat * outwards).sum(axis=1)[block] > 0).all()


def test_the_cornell_spot_stands_in_for_the_quad():
    scene, _ = MADE["cornell_box"]
    spot = scene.lights.spot
    radiance, area = np.array([18.387, 13.9873, 6.75357]), 130 * 105 * CORNELL_SCALE**2
    np.testing.assert_allclose(scene.materials.emissive[3], radiance, rtol=1e-6)
    np.testing.assert_allclose(spot.intensity[0], radiance * area, rtol=1e-6)
    # Integrate glTF's cone over the sphere: the flux must be a Lambertian emitter's, π L A.
    theta = (np.arange(200_000) + 0.5) * (np.pi / 200_000)
    inner, outer = np.cos(float(spot.inner[0])), np.cos(float(spot.outer[0]))
    cone = np.clip((np.cos(theta) - outer) / (inner - outer), 0, 1) ** 2
    flux = 2 * np.pi * (cone * np.sin(theta)).sum() * (np.pi / 200_000)
    np.testing.assert_allclose(flux, np.pi, rtol=1e-5)
    # It hangs below the quad's middle, and can be left away.
    np.testing.assert_allclose(spot.position[0] / CORNELL_SCALE, [278.0, 547.8, 279.5], rtol=1e-6)
    without, _ = cornell_box(spot=False)
    assert without.lights.spot.position.shape == (0, 3) and without.lights.spot.inner.shape == (0,)


def test_the_cornell_camera():
    """35 mm before a film of 25 mm: the opening's edge, 278 mm aside at 800 mm, nearly fills a square picture."""
    _, camera = MADE["cornell_box"]
    np.testing.assert_allclose(camera.clip_from_view[1, 1], 2 * 0.035 / 0.025, rtol=1e-6)
    np.testing.assert_allclose(camera.world_from_view[:3, 3] / CORNELL_SCALE, [278, 273, -800], rtol=1e-6)
    np.testing.assert_allclose(camera.world_from_view[:3, 2], [0, 0, -1], atol=1e-7)


@pytest.mark.parametrize(("columns", "rows"), [(7, 5), (3, 2)])
def test_the_grid_spans_both_axes(columns, rows):
    materials = material_grid(columns, rows)[0].materials
    metallic, roughness = (np.asarray(v)[:-1].reshape(rows, columns) for v in (materials.metallic, materials.roughness))
    np.testing.assert_allclose(metallic, np.repeat(np.linspace(0, 1, rows)[:, None], columns, 1), atol=1e-7)
    np.testing.assert_allclose(roughness, np.repeat(np.linspace(0, 1, columns)[None], rows, 0), atol=1e-7)
