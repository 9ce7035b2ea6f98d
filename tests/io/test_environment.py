"""Surroundings from files: read, refused, prepared once and found again, and put into scenes."""

import pathlib
import sys
import warnings

import gltf_writer as gltf
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import jaxraster as jr
from jaxraster.environment.prepare import prepare
from jaxraster.environment.sun import cut_suns
from jaxraster.errors import AssetWarning, InputError, LimitError, OutputError, UsageError
from jaxraster.io.cache import cache_folder
from jaxraster.io.environment import prepare_environment, read_environment, surroundings
from jaxraster.io.exr import write_exr
from jaxraster.io.radiance import write_hdr
from jaxraster.io.reading import Limits
from jaxraster.scene import Environment

TEXELS = np.random.default_rng(4).uniform(0.25, 1.0, (16, 32, 3)).astype(np.float32)
TEXELS[5, 20] = (4000.0, 3000.0, 2000.0)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def picture(folder: pathlib.Path, texels=TEXELS, name: str = "sky.exr") -> pathlib.Path:
    path = folder / name
    if path.suffix == ".exr":
        write_exr(path, {letter: texels[..., i] for i, letter in enumerate("RGB")})
    else:
        write_hdr(path, texels)
    return path


def same(one, other) -> None:
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other)):
        np.testing.assert_array_equal(a, b)


def test_a_picture_is_prepared_with_its_suns_cut_out(tmp_path):
    read = read_environment(picture(tmp_path))
    same(read, prepare(*(lambda left, suns: (jnp.asarray(left), suns))(*cut_suns(TEXELS))))
    assert read.suns.irradiance.shape == (1, 3) and read.texels.max() <= 1
    whole = read_environment(picture(tmp_path), suns=False, rotation=1.5)
    assert whole.suns.irradiance.shape == (0, 3) and whole.rotation == 1.5
    np.testing.assert_array_equal(whole.texels, TEXELS)
    coarse = read_environment(picture(tmp_path, name="sky.hdr"), suns=False)
    np.testing.assert_allclose(coarse.texels, TEXELS, rtol=0.02)


@pytest.mark.parametrize(("height", "width"), [(16, 31), (32, 16), (16, 16), (1, 4), (3, 4)])
def test_what_is_no_picture_of_all_directions_is_refused(tmp_path, height, width):
    path = picture(tmp_path, np.ones((height, width, 3), np.float32))
    with pytest.raises(InputError) as caught:
        read_environment(path)
    expected = f"has {width} x {height} pixels, but all directions make a picture twice as wide as high"
    assert str(caught.value).startswith(f"{path}: {expected}") and "\n" not in str(caught.value)


def test_one_pixel_is_light_from_all_around(tmp_path):
    read = read_environment(picture(tmp_path, np.full((1, 1, 3), 2.0, np.float32)))
    np.testing.assert_allclose(read.irradiance, np.full(read.irradiance.shape, 2.0), rtol=1e-5)
    assert read.suns.irradiance.shape == (0, 3)


@pytest.mark.parametrize(("name", "kind"), [("no.exr", InputError), ("sky.png", InputError), (".", InputError)])
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, name, kind):
    (tmp_path / "sky.png").write_bytes(b"not a picture")
    for act in (read_environment, prepare_environment):
        with pytest.raises(kind) as caught:
            act(tmp_path / name)
        assert "\n" not in str(caught.value)


# -- Prepared once -----------------------------------------------------------------------------------------------------


def test_what_is_prepared_is_found_again(tmp_path, monkeypatch):
    path = picture(tmp_path)
    fresh, done = read_environment(path), prepare_environment(path)
    assert pathlib.Path(done.path).parent == tmp_path / "cache" / "jaxraster"
    assert pathlib.Path(done.path).stat().st_size == done.size
    # By its bytes alone: another name, another folder, and no code that prepares is called.
    (tmp_path / "other").mkdir()
    moved = path.rename(tmp_path / "other" / "moved.exr")
    monkeypatch.setattr("jaxraster.io.environment.prepare", None)
    same(read_environment(moved), fresh)
    assert read_environment(moved, rotation=2.0).rotation == 2.0
    for changes in ({"cache": False}, {"suns": False}):
        with pytest.raises(TypeError):
            read_environment(moved, **changes)
    picture(tmp_path / "other", 2 * TEXELS, "moved.exr")
    with pytest.raises(TypeError):
        read_environment(moved)


def damage(data: bytes, how: str) -> bytes:
    if how == "cut off":
        return data[: len(data) // 2]
    if how == "a byte changed":
        return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 1]) + data[len(data) // 2 + 1 :]
    return b"" if how == "empty" else b"something else" * 100


@pytest.mark.parametrize("how", ["cut off", "a byte changed", "empty", "no archive"])
def test_what_is_damaged_is_made_anew_with_a_warning(tmp_path, how):
    path = picture(tmp_path)
    kept = pathlib.Path(prepare_environment(path).path)
    kept.write_bytes(damage(kept.read_bytes(), how))
    with pytest.warns(AssetWarning, match="is damaged") as caught:
        read = read_environment(path)
    assert len(caught) == 1 and "\n" not in str(caught[0].message)
    same(read, read_environment(path, cache=False))
    prepare_environment(path)
    with warnings.catch_warnings(action="error"):
        same(read_environment(path), read)


def test_what_was_put_right_is_said_every_time(tmp_path):
    texels = TEXELS.copy()
    texels[2, 3], texels[2, 4] = np.nan, -1.0
    path = picture(tmp_path, texels)
    said = []
    for act in (read_environment, prepare_environment, read_environment):
        with pytest.warns(AssetWarning) as caught:
            act(path)
        said.append([str(one.message) for one in caught])
    assert said[0] == said[1] == said[2] and len(said[0]) == 2
    assert said[0][0] == f"{path}: 1 of 512 texels are not finite; they become black"


def test_limits_hold_for_what_is_prepared(tmp_path):
    path = picture(tmp_path)
    prepare_environment(path)
    for limits in (Limits(light_side=31), Limits(light_pixels=511), Limits(file_bytes=100)):
        with pytest.raises(LimitError):
            read_environment(path, limits=limits)


def test_a_folder_that_cannot_be_written_is_an_error_of_output(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(OutputError, match="XDG_CACHE_HOME"):
        prepare_environment(picture(tmp_path))
    assert read_environment(picture(tmp_path)).suns.irradiance.shape == (1, 3)


@pytest.mark.parametrize(
    ("platform", "variables", "expected"),
    [
        ("linux", {"XDG_CACHE_HOME": "/x"}, "/x/jaxraster"),
        ("linux", {"XDG_CACHE_HOME": ""}, "~/.cache/jaxraster"),
        ("linux", {"XDG_CACHE_HOME": "relative"}, "~/.cache/jaxraster"),
        ("darwin", {"XDG_CACHE_HOME": ""}, "~/Library/Caches/jaxraster"),
        ("win32", {"XDG_CACHE_HOME": "", "LOCALAPPDATA": "/local"}, "/local/jaxraster"),
    ],
)
def test_the_folder_is_where_the_system_keeps_such_files(monkeypatch, platform, variables, expected):
    monkeypatch.setattr(sys, "platform", platform)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert cache_folder() == pathlib.Path(expected).expanduser()


# -- In scenes ---------------------------------------------------------------------------------------------------------


def model(folder: pathlib.Path, light: bool) -> pathlib.Path:
    document = gltf.new()
    arrays = {"POSITION": np.eye(3, dtype=np.float32), "NORMAL": np.eye(3, dtype=np.float32)}
    gltf.node(document, mesh=gltf.mesh(document, np.arange(3, dtype=np.uint16), **arrays))
    if light:
        document["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 5}]}}
        gltf.node(document, extensions={"KHR_lights_punctual": {"light": 0}})
    return gltf.write(document, folder / "model")


def counts(scene) -> tuple[int, int]:
    return len(scene.lights.directional.direction), len(scene.lights.point.position)


def test_surroundings_light_a_file_without_lights_and_leave_those_of_others(tmp_path):
    grey = (0.5, 0.5, 0.5)
    for light, expected in ((False, (0, 0)), (True, (0, 1))):
        scene, _ = jr.load(model(tmp_path, light), environment=grey)
        assert counts(scene) == expected
        np.testing.assert_array_equal([scene.environment.sky, scene.environment.ground], [grey, grey])
    assert counts(jr.load(model(tmp_path, False))[0]) == (1, 0)
    lit, _ = jr.load(model(tmp_path, True), environment=grey, light_direction=(0, -1, 0))
    assert counts(lit) == (1, 0) and lit.environment.sky[0] == 0.5


def test_surroundings_may_be_a_path_a_colour_a_map_or_whole(tmp_path):
    path, file = picture(tmp_path), model(tmp_path, False)
    map = read_environment(path)
    for given in (path, str(path), map):
        around = jr.load(file, environment=given)[0].environment
        same(around.map, map)
        assert not jnp.any(around.sky) and not jnp.any(around.ground)
    own = Environment(up=jnp.array([0.0, 0.0, 1.0]), sky=jnp.ones(3), ground=jnp.zeros(3), map=map)
    assert jr.load(file, environment=own)[0].environment is own
    assert surroundings(np.array([1, 2, 3])).sky.tolist() == [1, 2, 3]


@pytest.mark.parametrize("given", [1.0, (1.0, 2.0), (1.0, -1.0, 1.0), (np.nan, 0.0, 0.0), None, {"sky": 1}])
def test_what_is_nothing_of_these_is_refused(given, monkeypatch):
    # Users do not have the type checker of these tests.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(UsageError, match="expected a path, three numbers of at least 0"):
        surroundings(given)


def test_surroundings_that_cannot_be_read_name_their_own_file(tmp_path):
    with pytest.raises(InputError, match=r"no\.hdr"):
        jr.load(model(tmp_path, False), environment=tmp_path / "no.hdr")
