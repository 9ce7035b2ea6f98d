"""Loading: a scene and a camera from any file, with a rig where the file brings none, and one warning for each loss."""

import math
import subprocess
import sys
import warnings

import gltf_writer as gltf
import jax
import numpy as np
import pytest

from jaxraster.errors import AssetWarning, InputError, UsageError
from jaxraster.io.image import read_image
from jaxraster.io.load import load, save

TRIANGLE = np.array([[10, 0, 0], [14, 1, 0], [11, 3, 2]], np.float32)


def model(folder, cameras: int = 0, light: bool = False, positions: np.ndarray = TRIANGLE, **members):
    document = gltf.new() | members
    corners = np.arange(3, dtype=np.uint16)
    gltf.node(
        document,
        mesh=gltf.mesh(document, corners, POSITION=positions, NORMAL=np.tile(np.eye(3)[2:], (3, 1)).astype(np.float32)),
    )
    for i in range(cameras):
        gltf.put(document, "cameras", {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}})
        gltf.node(document, camera=i, translation=[0, 0, 10 + i])
    if light:
        document["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 5}]}}
        gltf.node(document, extensions={"KHR_lights_punctual": {"light": 0}})
    return gltf.write(document, folder / "model")


def project(points: np.ndarray, camera) -> np.ndarray:
    world_from_view = np.asarray(camera.world_from_view, np.float64)
    clip = np.asarray(camera.clip_from_view, np.float64) @ np.linalg.inv(world_from_view)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ clip.T
    return homogeneous[:, :3] / homogeneous[:, 3:]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_file_without_cameras_is_framed(tmp_path, scale):
    positions = (TRIANGLE * scale).astype(np.float32)
    _, camera = load(model(tmp_path, positions=positions))
    # The sphere about the bounding box, sampled densely, fills the picture's height but for the margin.
    center = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    radius = np.linalg.norm(positions - center, axis=1).max()
    directions = np.random.default_rng(0).normal(size=(20_000, 3))
    sphere = center + radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    seen = project(sphere, camera)
    assert 0.93 < np.abs(seen[:, :2]).max() < 1
    # Room to walk about: the near plane is a hundredth of the way to the centre, and there is no far one.
    assert 0.005 < seen[:, 2].min() < seen[:, 2].max() < 0.02
    # It stands in front, above and to the right, level and upright.
    pose = np.asarray(camera.world_from_view)
    azimuth, elevation = math.atan2(pose[0, 2], pose[2, 2]), math.asin(pose[1, 2])
    assert (azimuth, elevation) == pytest.approx((0.5, 0.25), abs=1e-5)
    assert pose[1, 0] == pytest.approx(0, abs=1e-6)
    assert pose[1, 1] > 0
    assert 2 * math.atan(1 / float(camera.clip_from_view[1, 1])) == pytest.approx(math.radians(40), rel=1e-6)


def test_a_point_like_model_still_has_a_camera(tmp_path):
    _, camera = load(model(tmp_path, positions=np.ones((3, 3), np.float32)))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(camera))
    assert np.abs(project(np.ones((1, 3)), camera)[0, :2]).max() < 1e-6


def test_a_file_without_lights_gets_a_rig(tmp_path):
    for cameras in (0, 1):
        scene, camera = load(model(tmp_path, cameras))
        key = scene.lights.directional
        assert key.direction.shape == (1, 3)
        assert (scene.lights.point.range.shape, scene.lights.spot.range.shape) == ((0,), (0,))
        in_view = np.asarray(camera.world_from_view)[:3, :3].T @ np.asarray(key.direction)[0]
        # It travels to the right, down and away from the camera.
        assert (np.sign(in_view) == [1, -1, -1]).all()
        assert np.linalg.norm(key.direction) == pytest.approx(1, abs=1e-6)
        red, green, blue = key.irradiance[0].tolist()
        assert 3.5 > red > green > blue > 2.0
        sky, ground = scene.environment.sky.tolist(), scene.environment.ground.tolist()
        assert sky[2] > sky[0] > ground[0] > ground[2] > 0
        assert scene.environment.up.tolist() == [0, 1, 0]


def test_a_file_with_lights_has_these_alone(tmp_path):
    scene, _ = load(model(tmp_path, light=True))
    assert scene.lights.directional.direction.shape == (0, 3)
    assert scene.lights.point.intensity.tolist() == [[5, 5, 5]]
    assert not scene.environment.sky.any()
    assert not scene.environment.ground.any()


def test_light_direction_replaces_all_lights(tmp_path):
    scene, _ = load(model(tmp_path, light=True), light_direction=(0, -2, 0))
    assert scene.lights.directional.direction.tolist() == [[0, -1, 0]]
    assert scene.lights.point.intensity.shape == (0, 3)
    assert scene.environment.sky.any()


@pytest.mark.parametrize("direction", [(0, 0, 0), (1, 2), (math.nan, 0, 1), (math.inf, 0, 1)])
def test_impossible_light_directions(tmp_path, direction):
    with pytest.raises(UsageError, match="light_direction: expected three numbers, not all zero"):
        load(model(tmp_path), light_direction=direction)


def test_choosing_a_camera(tmp_path):
    path = model(tmp_path, cameras=2)
    for i in range(2):
        _, camera = load(path, camera=i)
        assert float(camera.world_from_view[2, 3]) == 10 + i
    for i in (-1, 2):
        with pytest.raises(UsageError, match=f"model.glb: camera {i} is not there; the file has 2, counted from 0"):
            load(path, camera=i)
    with pytest.raises(UsageError, match="camera 1 is not there; the file has none; leave it out"):
        load(model(tmp_path), camera=1)


def test_every_array_is_32_bit_and_on_the_device(tmp_path):
    (tmp_path / "model.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for path in (model(tmp_path, cameras=1, light=True), tmp_path / "model.obj"):
        for leaf in jax.tree.leaves(load(path)):
            assert isinstance(leaf, jax.Array)
            assert leaf.dtype in (np.float32, np.int32, np.bool_)


def test_one_warning_for_each_loss_at_the_callers_line(tmp_path):
    materials = [{"extensions": {"KHR_materials_specular": {"specularTexture": {"index": 0}}}}]
    path = model(tmp_path, extensionsUsed=["EXT_a"], animations=[{}], materials=materials)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(path)
    assert [str(w.message) for w in caught] == [
        f"{path}: extensions are ignored: EXT_a",
        f"{path}: animations are ignored",
        f"{path}: specularTexture is ignored: /materials/0/extensions/KHR_materials_specular",
    ]
    assert {w.category for w in caught} == {AssetWarning}
    assert not any("jaxraster/io" in w.filename for w in caught)


@pytest.mark.parametrize(("name", "message"), [("a.fbx", "unknown model format '.fbx'"), ("a", "no suffix to tell")])
def test_unknown_suffixes(name, message):
    with pytest.raises(InputError, match=rf"^{name}: {message}.*; known are .gltf, .glb, .obj, .ply, .stl, .off$"):
        load(name)


@pytest.mark.parametrize("suffix", [".gltf", ".GLB", ".obj", ".ply", ".stl", ".off"])
def test_a_missing_file_says_so_whatever_its_kind(tmp_path, suffix):
    with pytest.raises(InputError, match=f"gone{suffix}: cannot be read: No such file or directory; check the path"):
        load(tmp_path / f"gone{suffix}")


def test_save(tmp_path):
    save(tmp_path / "a.png", np.full((2, 3, 3), 0.2, np.float32))
    np.testing.assert_allclose(read_image(tmp_path / "a.png")[..., :3], 0.2, atol=1e-7)


def test_importing_costs_no_image_or_mesh_library():
    code = "import sys, jaxraster.io; print([m for m in ('PIL', 'trimesh', 'imageio', 'scipy') if m in sys.modules])"
    clean = "import sys, jax; print([m for m in ('PIL', 'trimesh', 'imageio', 'scipy') if m in sys.modules])"
    ours, jaxs = (subprocess.run([sys.executable, "-c", c], capture_output=True, text=True) for c in (code, clean))
    assert ours.returncode == 0, ours.stderr
    assert ours.stdout == jaxs.stdout


def test_real_helmet(assets):
    scene, camera = load(assets / "FlightHelmet" / "FlightHelmet.gltf")
    seen = project(np.asarray(scene.mesh.vertices), camera)
    assert np.abs(seen[:, :2]).max() < 1
    assert 0 < seen[:, 2].min() < seen[:, 2].max() < 1
