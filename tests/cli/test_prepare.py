"""Surroundings on the command line: prepared, named, turned, and refused in one line before anything slow."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from refused import check_refused

import jaxraster
from jaxraster.cli import main
from jaxraster.environment.equirect import lookup, turned
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
    for name, texels in (("sky.exr", TEXELS), ("square.exr", TEXELS[:, :16])):
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
    ("render --environment gone.exr", 3, "gone.exr: neither a file nor 'sky'"),
    ("render --environment notes.txt", 3, "notes.txt: unknown format of light; known are .hdr, .pic, .exr"),
    ("render --environment square.exr", 3, "square.exr: has 16 x 16 pixels"),
    ("render --environment cut.exr", 3, "cut.exr"),
    ("render triangle.obj --environment sky.exr --limit light_pixels=511", 5, "(limit light_pixels)"),
    ("render --environment sky.exr -o sky.exr", 4, "sky.exr: is the environment itself; choose another name"),
    ("render --environment-rotation 90", 2, "--environment-rotation: turns what --environment names; add it"),
    ("render --environment sky --environment-rotation inf", 2, "--environment-rotation: expected a finite number"),
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
    assert map.suns.direction[0, 1] < 0 and 0.1 < np.asarray(map.texels)[:100].mean() < 1
    np.testing.assert_allclose(map.rotation, np.pi, rtol=1e-6)
