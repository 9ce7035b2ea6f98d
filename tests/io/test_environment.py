"""Surroundings from files: read, refused, prepared once and found again, and put into scenes."""

import dataclasses
import io
import os
import pathlib
import shutil
import sys
import warnings

import gltf_writer as gltf
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import small

import jaxraster as jr
from jaxraster.environment.prepare import prepare
from jaxraster.environment.sky import sky
from jaxraster.environment.sun import cut_suns
from jaxraster.errors import AssetWarning, InputError, LimitError, OutputError, UsageError
from jaxraster.io import cache
from jaxraster.io.disk import read_file
from jaxraster.io.environment import clear_sky, prepare_environment, read_environment, surroundings
from jaxraster.io.exr import write_exr
from jaxraster.io.radiance import write_hdr
from jaxraster.io.reading import Limits
from jaxraster.scene import Environment, check_map, check_scene

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


UNREADABLE = [
    ("no.exr", "cannot be read"),
    ("sky.png", "unknown format of light '.png'; known are .hdr, .pic, .exr"),
    (".", "no suffix to tell the format of light; known are .hdr, .pic, .exr"),
    ("folder.hdr", "is a folder"),
    ("empty.hdr", "is empty"),
]


@pytest.mark.parametrize(("name", "message"), UNREADABLE)
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, name, message):
    (tmp_path / "sky.png").write_bytes(b"not a picture")
    (tmp_path / "empty.hdr").write_bytes(b"")
    (tmp_path / "folder.hdr").mkdir()
    for act in (read_environment, prepare_environment):
        with pytest.raises(InputError) as caught:
            act(tmp_path / name)
        assert message in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_is_read_once(tmp_path, monkeypatch):
    """What is prepared is made of the very bytes that it is kept under."""
    path, seen = picture(tmp_path), []
    monkeypatch.setattr("jaxraster.io.environment.read_file", lambda *given: seen.append(given) or read_file(*given))
    for elsewhere in ("light", "exr", "radiance"):
        monkeypatch.setattr(f"jaxraster.io.{elsewhere}.read_file", None)
    for act in (read_environment, prepare_environment, read_environment):
        act(path)
    assert len(seen) == 3


# -- What is put right -------------------------------------------------------------------------------------------------


def spoilt(folder: pathlib.Path) -> pathlib.Path:
    texels = TEXELS.copy()
    texels[2, 3], texels[2, 4], texels[2, 5, 1] = np.nan, -1.0, 1e30
    return picture(folder, texels)


REPAIRED = (
    "1 of 512 texels are not finite; they become black",
    "1 of 512 texels are negative; they become 0",
    "1 of 512 texels are above 1.844e+18; they become that",
)


def test_what_was_put_right_is_said_every_time(tmp_path):
    path = spoilt(tmp_path)
    for act in (read_environment, prepare_environment, read_environment):
        with pytest.warns(AssetWarning) as caught:
            act(path)
        assert [str(one.message) for one in caught] == [f"{path}: {what}" for what in REPAIRED]


def test_what_was_put_right_in_surroundings_is_said_where_they_are_loaded(tmp_path):
    file, path = model(tmp_path, False), spoilt(tmp_path)
    with pytest.warns(AssetWarning) as caught:
        jr.load(file, environment=path)
    assert [str(one.message) for one in caught] == [f"{path}: {what}" for what in REPAIRED]
    assert not any("jaxraster/io" in one.filename for one in caught)


def test_strict_refuses_what_would_be_put_right(tmp_path):
    """Whether or not a repaired map has been prepared before."""
    file, path = model(tmp_path, False), spoilt(tmp_path)
    acts = (
        lambda: read_environment(path, strict=True),
        lambda: prepare_environment(path, strict=True),
        lambda: jr.load(file, environment=path, strict=True),
        lambda: jr.io.read_light(path, strict=True),
    )
    for _ in range(2):
        for act in acts:
            with pytest.raises(InputError) as caught:
                act()
            assert str(caught.value) == f"{path}: {REPAIRED[0]}, which strict forbids; export it again"
        with warnings.catch_warnings(action="ignore"):
            prepare_environment(path)


def test_strict_takes_what_needs_no_repair(tmp_path, monkeypatch):
    """From what was prepared, too; and a remark is no repair."""
    path, black = picture(tmp_path), picture(tmp_path, 0 * TEXELS, "black.exr")
    prepare_environment(path, strict=True)
    with pytest.warns(AssetWarning, match="it is black all over"):
        read_environment(black, strict=True)
    monkeypatch.setattr("jaxraster.io.environment.prepare", None)
    assert read_environment(path, strict=True).texels.shape == TEXELS.shape


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


def archive(arrays: dict) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def damage(data: bytes, how: str) -> bytes:
    """What lies in the place of a prepared map."""
    middle, arrays = len(data) // 2, dict(np.load(io.BytesIO(data)))
    single = io.BytesIO()
    np.save(single, arrays["texels"])
    return {
        "cut off": data[:middle],
        "a byte changed": data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :],
        "empty": b"",
        "no archive": b"something else" * 100,
        "one array": single.getvalue(),
        "an archive of nothing": archive({}),
        "an array missing": archive({name: array for name, array in arrays.items() if name != "specular"}),
        "tables of other texels": archive(arrays | {"texels": np.ones((300, 600, 3), np.float32)}),
        "integers": archive(arrays | {"texels": np.ones((16, 32, 3), np.int32)}),
        "objects": archive(arrays | {"notes": np.array([{}])}),
    }[how]


HOW = "cut off", "a byte changed", "empty", "no archive", "one array", "an archive of nothing"
HOW += "an array missing", "tables of other texels", "integers", "objects"


@pytest.mark.parametrize("how", HOW)
def test_what_is_damaged_is_made_anew_with_a_warning(tmp_path, how, monkeypatch):
    # Users do not have the type checker of these tests.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    path = picture(tmp_path)
    kept = pathlib.Path(prepare_environment(path).path)
    whole = kept.read_bytes()
    kept.write_bytes(damage(whole, how))
    with pytest.warns(AssetWarning, match="is damaged") as caught:
        read = read_environment(path)
    assert len(caught) == 1 and "\n" not in str(caught[0].message)
    same(read, read_environment(path, cache=False))
    prepare_environment(path)
    with warnings.catch_warnings(action="error"):
        same(read_environment(path), read)
    assert [one.name for one in kept.parent.iterdir()] == [kept.name]


def test_a_folder_in_the_place_of_a_prepared_map_is_no_map(tmp_path):
    path = picture(tmp_path)
    kept = pathlib.Path(prepare_environment(path).path)
    kept.unlink()
    kept.mkdir()
    assert read_environment(path).suns.irradiance.shape == (1, 3)
    with pytest.raises(OutputError, match="is a folder, where a file is to be kept; remove it"):
        prepare_environment(path)


def test_what_may_not_be_read_is_made_anew(tmp_path, monkeypatch):
    """As for a file of somebody else; these tests may run as one who may read all."""
    path = picture(tmp_path)
    expected = prepare_environment(path).map

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("jaxraster.io.cache.zipfile.ZipFile", refuse)
    with pytest.warns(AssetWarning, match=r"is damaged \(.*Permission denied\); prepare it again"):
        same(read_environment(path), expected)


def test_what_cannot_be_kept_is_said_and_the_old_file_stays(tmp_path, monkeypatch):
    path = picture(tmp_path)
    kept = pathlib.Path(prepare_environment(path).path)
    kept.write_bytes(b"old")

    def refuse(*_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OutputError, match="cannot be written: Read-only file system"):
        prepare_environment(path)
    assert kept.read_bytes() == b"old" and [one.name for one in kept.parent.iterdir()] == [kept.name]


@pytest.mark.parametrize(
    "maker", ["environment/sun.py", "io/light.py", "io/exr.py", "io/radiance.py", "math/rec709.py"]
)
def test_other_code_looks_for_another_file(tmp_path, monkeypatch, maker):
    """Whatever says what is read of a picture and made of it has its part in the name."""
    before, files = cache.cached_path(b"picture", True), cache.resources.files
    shutil.copytree(files("jaxraster"), tmp_path / "jaxraster")
    monkeypatch.setattr(cache.resources, "files", lambda name: tmp_path / name.replace(".", "/"))
    assert cache.cached_path(b"picture", True) == before
    assert len({before, cache.cached_path(b"picture", False), cache.cached_path(b"another", True)}) == 3
    with open(tmp_path / "jaxraster" / maker, "a") as file:
        file.write("# changed")
    assert cache.cached_path(b"picture", True) != before


def test_limits_hold_for_what_is_prepared(tmp_path):
    path = picture(tmp_path)
    prepare_environment(path)
    for limits in (Limits(light_side=31), Limits(light_pixels=511), Limits(file_bytes=100)):
        with pytest.raises(LimitError):
            read_environment(path, limits=limits)


@pytest.mark.parametrize("place", ["file", "/proc"])
def test_a_folder_that_cannot_be_written_is_an_error_of_output(tmp_path, monkeypatch, place):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / place))
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
    assert cache.cache_folder() == pathlib.Path(expected).expanduser()


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


TONES = [
    (0.5, [(0.5,) * 3] * 2),
    (np.array([1, 2, 3]), [(1, 2, 3)] * 2),
    ([(1.0, 2.0, 3.0), (4.0, 5.0, 6.0)], [(1, 2, 3), (4, 5, 6)]),
    ([[1.0], [0.25]], [(1,) * 3, (0.25,) * 3]),
    (jnp.zeros(3), [(0,) * 3] * 2),
]


@pytest.mark.parametrize(("given", "expected"), TONES)
def test_tones_are_a_grey_a_colour_or_two_of_them(given, expected):
    around, notes = surroundings(given)
    np.testing.assert_array_equal([around.sky, around.ground], expected)
    assert around.up.tolist() == [0, 1, 0] and around.map is None and notes == ()


def test_a_clear_sky_has_a_name(tmp_path, monkeypatch):
    monkeypatch.setattr("jaxraster.io.environment.SKY_ROWS", 8)
    around = jr.load(model(tmp_path, False), environment="sky")[0].environment
    same(around.map, clear_sky())
    assert around.map.suns.irradiance.shape == (1, 3) and not jnp.any(around.sky)
    other = clear_sky((0.0, 1.0, 1.0), 8.0, rotation=1.0)
    same(other, prepare(*sky((0.0, 1.0, 1.0), 8.0, height=8, width=16, gain=3e-5), 1.0))


NOTHING = [True, (1.0, 2.0), (1.0, -1.0, 1.0), (np.nan, 0.0, 0.0), 1e19, None, {"sky": 1}, ["sky"] * 3, [[1.0], [1, 2]]]


@pytest.mark.parametrize("given", NOTHING, ids=repr)
def test_what_is_nothing_of_these_is_refused(given, monkeypatch):
    # Users do not have the type checker of these tests.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(UsageError, match="expected a path, 'sky', a grey, a colour or two of them, from 0 to"):
        surroundings(given)


def test_surroundings_that_cannot_be_read_name_their_own_file(tmp_path):
    with pytest.raises(InputError, match=r"no\.hdr"):
        jr.load(model(tmp_path, False), environment=tmp_path / "no.hdr")


# -- Tables held against texels ----------------------------------------------------------------------------------------


def array(*shape: int, dtype=np.float32) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(shape, dtype)


def ready(height: int, lead: tuple[int, ...] = ()):
    """The shapes of a prepared map, or of a batch of them."""
    made = jax.eval_shape(prepare, array(height, 2 * height, 3))
    return jax.tree.map(lambda leaf: array(*lead, *leaf.shape), made)


@pytest.mark.parametrize("height", [1, 2, 64, 65, 128, 129, 256, 257, 600])
def test_every_map_that_is_prepared_passes(height):
    check_map("map", ready(height))
    check_map("map", ready(height, (3,)), batched=True)


MIXED_UP = [
    ({"specular": array(1, 1)}, ValueError, "specular must be [36864, 12] for texels [16, 32, 3], got [1, 1]; call"),
    (
        {"specular": array(86016, 12)},
        ValueError,
        "specular must be [36864, 12] for texels [16, 32, 3], got [86016, 12]",
    ),
    (
        {"texels": array(65, 130, 3)},
        ValueError,
        "specular must be [86016, 12] for texels [65, 130, 3], got [36864, 12]",
    ),
    (
        {"irradiance": array(1024, 12)},
        ValueError,
        "irradiance must be [4096, 12] for texels [16, 32, 3], got [1024, 12]",
    ),
    ({"irradiance": array(4096, 3)}, ValueError, "irradiance must be [4096, 12] for texels [16, 32, 3], got [4096, 3]"),
    ({"harmonics": array(16, 3)}, ValueError, "harmonics must be float [9, 3], got float32 [16, 3]"),
    ({"texels": array(0, 0, 3)}, ValueError, "texels has none, its shape is [0, 0, 3]"),
    ({"texels": array(16, 32, 4)}, ValueError, "texels must be float [h, w, 3], got float32 [16, 32, 4]"),
    ({"texels": array(16, 32, 3, dtype=np.uint8)}, TypeError, "texels must be float [h, w, 3], got uint8 [16, 32, 3]"),
    ({"rotation": array(2)}, ValueError, "rotation must be float [], got float32 [2]; map over a batch with jax.vmap"),
]


@pytest.mark.parametrize(("changes", "kind", "message"), MIXED_UP, ids=lambda value: str(value)[:40])
def test_a_map_of_other_texels_is_refused_with_the_scene(changes, kind, message, monkeypatch):
    # Users do not have the type checker of these tests.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    scene, camera = small.scene(), small.camera()

    def check(map, batched):
        around = dataclasses.replace(scene.environment, map=map)
        check_scene(dataclasses.replace(scene, environment=around), camera, batched=batched)

    check(ready(16), False)
    with pytest.raises(kind) as caught:
        check(dataclasses.replace(ready(16), **changes), False)
    assert str(caught.value).startswith(f"scene.environment.map.{message}") and "\n" not in str(caught.value)
    # The same of a batch, whose leading axes are no part of what is wrong.
    many = {name: array(2, *one.shape, dtype=one.dtype) for name, one in changes.items()}
    check(ready(16, (2,)), True)
    if "rotation" not in changes:
        with pytest.raises(kind, match=rf"scene.environment.map.{next(iter(message.split()))}"):
            check(dataclasses.replace(ready(16, (2,)), **many), True)
