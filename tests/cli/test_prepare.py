"""Surroundings on the command line: prepared, named, turned, and refused in one line before anything slow."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from refused import check_refused

import jaxraster
from jaxraster.cli import main
from jaxraster.environment.equirect import lookup, turned
from jaxraster.environment.sky import sky
from jaxraster.io.exr import write_exr

TEXELS = np.random.default_rng(4).uniform(0.25, 1.0, (16, 32, 3)).astype(np.float32)
TEXELS[5, 20] = 3000.0


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "triangle.obj").write_text("v -1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "cut.exr").write_bytes(b"v/1\1")
    (tmp_path / "notes.txt").write_text("sky")
    (tmp_path / "empty.hdr").write_bytes(b"")
    (tmp_path / "folder.hdr").mkdir()
    # Say nothing here of how finely the built-in sky is drawn.
    monkeypatch.setattr("jaxraster.io.environment.SKY_ROWS", 16)
    spoilt = np.where(np.arange(32)[:, None] + 32 * np.arange(16)[:, None, None] == 99, np.float32(np.nan), TEXELS)
    for name, texels in (("sky.exr", TEXELS), ("square.exr", TEXELS[:, :16]), ("spoilt.exr", spoilt)):
        write_exr(tmp_path / name, {letter: texels[..., i] for i, letter in enumerate("RGB")})


def run(words: str) -> int:
    return main(words.split())


REFUSED = [
    ("prepare", 2, "FILE"),
    ("prepare gone.exr", 3, "gone.exr: cannot be read"),
    (
        "prepare square.exr",
        3,
        "square.exr: has 16 x 16 pixels, but all directions make a picture twice as wide as high",
    ),
    ("prepare notes.txt", 3, "notes.txt: unknown format of light '.txt'; known are .hdr, .pic, .exr"),
    ("prepare sky.exr --limit light_side=16", 5, "(limit light_side)"),
    ("prepare spoilt.exr --strict", 3, "spoilt.exr: 1 of 512 texels are not finite; they become black, which strict"),
    ("render --environment gone.exr", 3, "gone.exr: is neither a file, nor 'sky', nor numbers"),
    ("render --environment notes.txt", 3, "notes.txt: unknown format of light '.txt'; known are .hdr, .pic, .exr"),
    ("render --environment empty.hdr", 3, "empty.hdr: is empty"),
    ("render --environment folder.hdr", 3, "folder.hdr: is a folder"),
    ("render --environment spoilt.exr --strict", 3, "spoilt.exr: 1 of 512 texels are not finite"),
    ("render triangle.obj --environment spoilt.exr --strict", 3, "which strict forbids"),
    ("render --environment sky --strict", 2, "--strict: is for files; 'stage' is built in"),
    ("render --environment 1,2", 2, "--environment: expected 1, 3 or 6 numbers of at least 0, got '1,2'"),
    ("render --environment -1", 2, "--environment: expected 1, 3 or 6 numbers of at least 0, got '-1'"),
    ("render --environment 1,nan,1", 2, "--environment: expected 1, 3 or 6 numbers of at least 0, got '1,nan,1'"),
    ("render --environment 1,inf,1", 2, "--environment: expected 1, 3 or 6 numbers of at least 0, got '1,inf,1'"),
    ("render triangle.obj --environment 1e19", 2, "from 0 to 1.844e+18"),
    ("render --environment square.exr", 3, "square.exr: has 16 x 16 pixels"),
    ("render --environment cut.exr", 3, "cut.exr"),
    ("render triangle.obj --environment sky.exr --limit light_pixels=511", 5, "(limit light_pixels)"),
    ("render --environment sky.exr -o sky.exr", 4, "sky.exr: is the environment itself; choose another name"),
    ("render --environment-rotation 90", 2, "--environment-rotation: turns the picture that --environment names; add"),
    ("render --environment 0.5 --environment-rotation 90", 2, "names; tones look the same from all sides; drop one"),
    ("render --environment sky --environment-rotation inf", 2, "--environment-rotation: expected a finite number"),
    ("render --sun-direction 1,1,1", 2, "--sun-direction: is for '--environment sky'; add it"),
    ("render --turbidity 3", 2, "--turbidity: is for '--environment sky'; add it"),
    ("render --environment sky.exr --turbidity 3", 2, "--turbidity: is for '--environment sky'; add it"),
    ("render --environment sky --sun-direction 1,-0.5,1", 2, "--sun-direction: a sun at Y = -0.5 is below the horizon"),
    ("render --environment sky --sun-direction 0,0,0", 2, "--sun-direction: a direction needs a length above zero"),
    ("render --environment sky --sun-direction 1,2", 2, "--sun-direction: expected three finite numbers x,y,z"),
    ("render --environment sky --sun-direction -1 2 3", 2, "--sun-direction: expected three finite numbers x,y,z"),
    ("render --environment sky --turbidity 1.9", 2, "--turbidity: expected a number from 2 to 10, got 1.9"),
    ("render --environment sky --turbidity 10.1", 2, "--turbidity: expected a number from 2 to 10, got 10.1"),
    ("render --environment sky --turbidity nan", 2, "--turbidity: expected a finite number, got 'nan'"),
]


@pytest.mark.parametrize(("words", "code", "message"), REFUSED)
def test_what_is_refused_is_one_line(words, code, message, capsys, tmp_path):
    check_refused(run, words, code, message, capsys, tmp_path)


def test_a_picture_is_prepared_and_said_to_be(tmp_path, capsys):
    assert run("prepare sky.exr") == 0
    out, err = capsys.readouterr()
    assert err == "" and len(out.splitlines()) == 2
    assert out.startswith("sky.exr: 32 x 16 pixels, suns cut out to cast shadows: 1\n")
    path, size = re.search(r"wrote (\S+) \((\d+\.\d) MB\) in \d+\.\d s\n", out).groups()
    (kept,) = (tmp_path / "cache" / "jaxraster").iterdir()
    assert str(kept) == path and abs(kept.stat().st_size / 1e6 - float(size)) < 0.051


def loaded(words: str, monkeypatch):
    """The scene and camera that a command would plan."""
    seen = []

    def stop(scene, camera, **_):
        seen.extend([scene, camera])
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxraster.planner.plan_for", stop)
    assert run(words) == 130
    return seen


@pytest.mark.parametrize("rotation", ["", "--environment-rotation 90", "--environment-rotation -45.5"])
def test_a_file_is_lit_by_the_surroundings_that_are_named(rotation, monkeypatch):
    scene, camera = loaded(f"render triangle.obj --environment sky.exr {rotation}", monkeypatch)
    angle = np.radians(float(rotation.split()[-1])) if rotation else 0.0
    around = scene.environment
    np.testing.assert_allclose(around.map.rotation, angle, rtol=1e-6)
    assert around.map.suns.irradiance.shape == (1, 3) and not np.any(around.sky)
    # What was towards +X is seen the angle further, counter-clockwise from above.
    seen = lookup(around.map.texels, turned(jnp.array([[np.cos(angle), 0.0, -np.sin(angle)]]), -around.map.rotation))
    np.testing.assert_allclose(seen[0], np.asarray(around.map.texels)[7:9, 15:17].mean(axis=(0, 1)), atol=1e-4)
    assert len(scene.lights.directional.direction) == 0
    assert camera.world_from_view.shape == (4, 4)


def test_a_built_in_scene_keeps_its_lights(monkeypatch):
    own, _ = jaxraster.scenes.SCENES["stage"]()
    scene, _ = loaded("render stage --environment sky.exr", monkeypatch)
    np.testing.assert_array_equal(scene.lights.directional.irradiance, own.lights.directional.irradiance)
    assert scene.environment.map is not None and not np.any(scene.environment.sky)


def test_a_clear_sky_needs_no_file(monkeypatch):
    scene, _ = loaded("render triangle.obj --environment sky --environment-rotation 180", monkeypatch)
    map = scene.environment.map
    assert map.suns.irradiance.shape == (1, 3) and 2 < map.suns.irradiance[0, 1] < 4
    # Light from above and the front left, before it is turned.
    assert map.suns.direction[0, 1] < 0 and 0.1 < np.asarray(map.texels)[:8].mean() < 1
    np.testing.assert_allclose(map.rotation, np.pi, rtol=1e-6)


@pytest.mark.parametrize("towards", ["-1,2,-3", "0,1,0", "1,0,0", "1e-25,2e-25,0", "1e30,1e30,1e30"])
def test_the_sun_stands_where_it_is_told_to(towards, monkeypatch):
    scene, _ = loaded(f"render --environment sky --sun-direction {towards} --turbidity 5.5", monkeypatch)
    map, sun = scene.environment.map, np.array([float(x) for x in towards.split(",")])
    np.testing.assert_allclose(map.suns.direction[0], -sun / np.linalg.norm(sun), atol=1e-6)
    texels, light = sky(sun, 5.5, height=16, width=32, gain=3e-5)
    np.testing.assert_array_equal(map.texels, texels)
    np.testing.assert_array_equal(map.suns.irradiance, light.irradiance)
    assert np.isfinite(texels).all()


TONES = [("0.5", (0.5,) * 3, (0.5,) * 3), ("1,2,3", (1, 2, 3), (1, 2, 3)), ("1,2,3,4,5,.5", (1, 2, 3), (4, 5, 0.5))]


@pytest.mark.parametrize(("words", "tone", "ground"), [*TONES, ("0", (0,) * 3, (0,) * 3)])
def test_tones_are_a_grey_a_colour_or_two_of_them(words, tone, ground, monkeypatch):
    for scene in ("stage", "triangle.obj"):
        around = loaded(f"render {scene} --environment {words}", monkeypatch)[0].environment
        assert (around.sky.tolist(), around.ground.tolist(), around.map) == (list(tone), list(ground), None)


def test_what_is_put_right_is_said_and_what_is_whole_is_strict_enough(monkeypatch, capsys):
    loaded("render --environment spoilt.exr", monkeypatch)
    warning = "jaxraster: warning: spoilt.exr: 1 of 512 texels are not finite; they become black\n"
    assert capsys.readouterr().err == warning
    assert loaded("render --environment sky.exr --strict", monkeypatch)[0].environment.map is not None
