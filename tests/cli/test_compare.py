"""`jaxraster compare`: the table is what the metrics say, the map is drawn to a fixed scale, refusals are one line."""

import pathlib

import jax.numpy as jnp
import numpy as np
import pytest
from refused import check_refused

from jaxraster import metrics
from jaxraster.cli import main
from jaxraster.io.image import read_image, write_image
from jaxraster.io.radiance import read_hdr, write_hdr

SIZE = (16, 20)
RNG = np.random.default_rng(2)
CODES = RNG.random((*SIZE, 3)).astype(np.float32)
LIGHT = (RNG.lognormal(0.0, 1.0, (*SIZE, 3))).astype(np.float32)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> pathlib.Path:
    """Run in a folder with pictures: two of a size, a small one, one with holes; light, some of it broken."""
    write_image(tmp_path / "a.png", CODES)
    write_image(tmp_path / "b.png", np.clip(CODES + 0.1 * RNG.normal(size=CODES.shape), 0, 1))
    write_image(tmp_path / "small.png", CODES[:4, :5])
    write_image(tmp_path / "holes.png", np.concatenate([CODES, CODES[..., :1]], axis=-1))
    write_hdr(tmp_path / "a.hdr", LIGHT)
    write_hdr(tmp_path / "b.hdr", 1.2 * LIGHT)
    (tmp_path / "cut.png").write_bytes((tmp_path / "a.png").read_bytes()[:60])
    (tmp_path / "linked.png").symlink_to("b.png")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(words: str) -> int:
    return main(["compare", *words.split()])


def table(text: str) -> dict[str, str]:
    """The rows of the table, by their names."""
    return {line[:13].strip(): line[14:] for line in text.splitlines()[1:] if not line.startswith("wrote")}


def test_pictures_are_compared_as_display_codes(capsys, folder):
    assert run("a.png b.png -o map.png") == 0
    out, err = capsys.readouterr()
    assert err == "" and out.startswith("20 x 16 pixels of display codes\n")
    a, b = (jnp.asarray(read_image(name)[..., :3]) for name in ("a.png", "b.png"))
    assert table(out) == {
        "relative MSE": f"{metrics.relative_mse(a, b).value:.6g}",
        "PSNR": f"{metrics.psnr(a, b).value:.2f} dB",
        "SSIM": f"{metrics.ssim(a, b).value:.6g}",
        "FLIP": f"{metrics.flip(a, b).value:.6g}",
        "not finite": "0 of 320 pixels, in no mean",
    }
    assert out.endswith("wrote map.png (FLIP: black is 0, pale yellow 1, the greatest difference to the eye)\n")
    drawn = read_image("map.png")[..., :3]
    np.testing.assert_allclose(drawn, metrics.heat(metrics.flip(a, b).map), atol=0.5 / 255 + 1e-6)


def test_light_is_compared_as_light(capsys, folder):
    """By what needs no white; the relative error is the same everywhere but in the dark."""
    assert run("b.hdr a.hdr --metric relative_mse -o map.png") == 0
    rows = table(capsys.readouterr().out)
    assert rows.keys() == {"relative MSE", "FLIP", "not finite"}
    assert 0.03 < float(rows["relative MSE"]) < 0.045 and 0.01 < float(rows["FLIP"]) < 0.2
    drawn = read_image("map.png")[..., :3]
    np.testing.assert_allclose(np.median(drawn, axis=(0, 1)), metrics.heat(jnp.full((1, 1), 0.2))[0, 0], atol=0.03)


def test_what_is_not_finite_is_counted_and_green(capsys, folder):
    exr = pytest.importorskip("jaxraster.io.exr")
    pytest.importorskip("OpenEXR", reason="EXR is read by an optional package")
    broken = 1.1 * LIGHT
    broken[2, 3], broken[4, 5, 1] = np.nan, np.inf
    for name, light in (("a", LIGHT), ("b", broken)):
        exr.write_exr(f"{name}.exr", {letter: light[..., i] for i, letter in enumerate("RGB")})
    assert run("b.exr a.exr -o map.png") == 0
    rows = table(capsys.readouterr().out)
    assert rows["not finite"] == "2 of 320 pixels, in no mean"
    assert 0 < float(rows["relative MSE"]) <= 0.01 + 1e-6 and 0 < float(rows["FLIP"]) < 1
    green = (read_image("map.png")[..., :3] == [0, 1, 0]).all(axis=-1)
    assert sorted(map(tuple, np.argwhere(green))) == [(2, 3), (4, 5)]


@pytest.mark.parametrize("metric", ["relative_mse", "psnr", "ssim", "flip"])
def test_a_picture_is_equal_to_itself(metric, capsys, folder):
    assert run(f"a.png a.png --metric {metric} -o map.png") == 0
    assert table(capsys.readouterr().out) == {
        "relative MSE": "0",
        "PSNR": "inf dB",
        "SSIM": "1",
        "FLIP": "0",
        "not finite": "0 of 320 pixels, in no mean",
    }
    assert (read_image("map.png")[..., :3] == np.array([0, 0, 4], np.float32) / np.float32(255)).all()


def test_what_is_left_out_is_said(capsys, folder):
    """Windows that do not fit, and opacity."""
    assert run("small.png small.png") == 0
    assert "SSIM" not in table(capsys.readouterr().out)
    assert run("holes.png a.png") == 0
    out, err = capsys.readouterr()
    assert table(out)["FLIP"] == "0"
    assert err == (
        "jaxraster: warning: holes.png: is transparent in places; its colours are compared, its opacity is not\n"
    )


REFUSED = [
    ("", 2, "the following arguments are required: IMAGE, REFERENCE"),
    ("a.png", 2, "the following arguments are required: REFERENCE"),
    ("a.png b.png c.png", 2, "one argument too many: 'c.png'"),
    ("a.png b.png --metrik ssim", 2, "unknown option '--metrik'; did you mean '--metric'?"),
    ("a.png b.png --metric flop", 2, "--metric: unknown name 'flop'; did you mean 'flip'?"),
    ("a.hdr b.hdr --metric ssim", 2, "--metric: ssim needs a white, which light does not have"),
    ("small.png small.png --metric ssim", 2, "--metric: ssim needs 11 x 11 pixels, there are 5 x 4"),
    ("a.png b.hdr", 2, "b.hdr is for light, a.png is not; compare two of one kind"),
    ("a.exr b.png", 2, "a.exr is for light, b.png is not; compare two of one kind"),
    ("a.png small.png", 3, "a.png: has 20 x 16 pixels, small.png 5 x 4; compare pictures of one size"),
    ("gone.png a.png", 3, "gone.png: cannot be read: No such file or directory"),
    ("a.png cut.png", 3, "cut.png: "),
    ("a.hdr gone.exr", 3, "gone.exr: "),
    ("a.png b.png -o b.png", 4, "b.png: is one of the pictures themselves; choose another name"),
    ("a.png b.png -o linked.png", 4, "linked.png: is one of the pictures themselves"),
    ("a.png b.png -o map.exr", 4, "map.exr: unknown picture format '.exr'"),
    ("a.png b.png -o nowhere/map.png", 4, "nowhere/map.png: cannot be written: there is no folder"),
    ("a.png b.png --pixels-per-degree 0", 2, "--pixels-per-degree: expected a number from 1 to 1000, got '0'"),
    ("a.png b.png --pixels-per-degree near", 2, "--pixels-per-degree: expected a finite number, got 'near'"),
    ("a.png b.png --limit file_bytes=9", 5, "a.png: has "),
]


@pytest.mark.parametrize(("words", "code", "says"), REFUSED, ids=[words or "nothing" for words, *_ in REFUSED])
def test_refusals(words, code, says, capsys, folder):
    check_refused(run, words, code, says, capsys, folder)


@pytest.mark.parametrize("suffix", ["png", "hdr"])
def test_flip_looks_from_as_close_as_is_said(suffix, capsys):
    """Of noise, one who stands farther off sees less."""
    read = {"png": lambda name: read_image(name)[..., :3], "hdr": read_hdr}[suffix]
    a, b = (jnp.asarray(read(f"{name}.{suffix}")) for name in "ab")
    function = metrics.flip if suffix == "png" else metrics.hdr_flip
    assert run(f"a.{suffix} b.{suffix} --pixels-per-degree 200") == 0
    assert table(capsys.readouterr().out)["FLIP"] == f"{function(a, b, pixels_per_degree=200.0).value:.6g}"
    assert function(a, b, pixels_per_degree=200.0).value < function(a, b).value


def test_help_names_the_metrics(capsys):
    assert run("--help") == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("relative_mse", "psnr", "ssim", "flip"))
