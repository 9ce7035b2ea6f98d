"""Pictures in and out: every pixel format, exact codes, broken files, and writes that never leave half a file."""

import errno
import io
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import warnings
import zlib

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from jaxraster.errors import InputError, LimitError, OutputError
from jaxraster.io.image import check_writable, read_image, srgb_to_linear, write_image

RAMP = np.arange(256, dtype=np.uint8)


def encoded(picture: Image.Image, kind: str = "PNG", **options) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, kind, **options)
    return buffer.getvalue()


def palette(alpha: bool) -> bytes:
    picture = Image.new("P", (2, 1))
    picture.putpalette([255, 0, 0, 0, 51, 255])
    picture.putpixel((1, 0), 1)
    return encoded(picture, transparency=bytes([0, 102])) if alpha else encoded(picture)


FORMATS = {
    "grey": (encoded(Image.new("L", (2, 1), 51)), (0.2, 0.2, 0.2, 1)),
    "grey and alpha": (encoded(Image.new("LA", (2, 1), (51, 102))), (0.2, 0.2, 0.2, 0.4)),
    "grey, 16 bits": (encoded(Image.fromarray(np.full((1, 2), 257, np.uint16))), (1 / 255, 1 / 255, 1 / 255, 1)),
    "one bit": (encoded(Image.new("1", (2, 1), 1)), (1, 1, 1, 1)),
    "palette": (palette(alpha=False), (1, 0, 0, 1)),
    "palette and alpha": (palette(alpha=True), (1, 0, 0, 0)),
    "rgb": (encoded(Image.new("RGB", (2, 1), (0, 51, 255))), (0, 0.2, 1, 1)),
    "rgba": (encoded(Image.new("RGBA", (2, 1), (0, 51, 255, 102))), (0, 0.2, 1, 0.4)),
    "jpeg, grey": (encoded(Image.new("L", (2, 1), 51), "JPEG"), (0.2, 0.2, 0.2, 1)),
    "jpeg, cmyk": (encoded(Image.new("CMYK", (2, 1), (255, 255, 255, 255)), "JPEG"), (0, 0, 0, 1)),
}


@pytest.mark.parametrize("name", FORMATS)
def test_read_image_gives_rgba(name):
    data, expected = FORMATS[name]
    image = read_image(data)
    assert image.shape == (1, 2, 4)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image[0, 0], expected, rtol=0, atol=1e-7)


def test_16_bit_grey_keeps_every_code(tmp_path):
    codes = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    write_image(tmp_path / "a.png", codes)
    image = read_image(tmp_path / "a.png")
    np.testing.assert_array_equal(np.rint(image[..., 0] * 65535).astype(np.uint16), codes)


def test_16_bit_colour_is_refused_and_not_cut(tmp_path):
    with pytest.raises(ValueError, match=r"PNG holds 8 bits or 16-bit grey, got uint16 \[3, 5, 3\]"):
        write_image(tmp_path / "a.png", np.zeros((3, 5, 3), np.uint16))
    assert not any(tmp_path.iterdir())


def test_srgb_to_linear_matches_the_standard():
    codes = np.arange(65536) / 65535
    exact = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    image = np.repeat(codes[:, None], 4, axis=1).astype(np.float32)
    linear = srgb_to_linear(image)
    np.testing.assert_allclose(linear[:, 1], exact, rtol=2e-6)
    np.testing.assert_array_equal(linear[:, 3], image[:, 3])
    assert linear.dtype == np.float32
    # Known values of the standard's own table, which a plain power 2.2 misses by 0.4 % to 300 %.
    known = {10: 0.0030352698, 11: 0.0033465358, 128: 0.2158605, 255: 1.0}
    for code, value in known.items():
        assert srgb_to_linear(np.full(3, code / 255, np.float32))[0] == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("shape", [(16, 16), (16, 16, 3), (16, 16, 4)])
def test_all_codes_survive(tmp_path, shape):
    codes = np.resize(RAMP, shape)
    write_image(tmp_path / "float.png", jnp.asarray(codes.astype(np.float32) / 255))
    write_image(tmp_path / "codes.png", codes)
    assert (tmp_path / "float.png").read_bytes() == (tmp_path / "codes.png").read_bytes()
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "codes.png")), codes)
    again = read_image(tmp_path / "float.png")
    np.testing.assert_array_equal(np.rint(again[..., : codes.reshape(16, 16, -1).shape[2]] * 255).squeeze(), codes)


def test_rounding_and_clipping(tmp_path):
    image = np.array([[0.5, 1.5, 2.5, -3.0, 300.0, np.inf, -np.inf, 254.4]], np.float64) / 255
    write_image(tmp_path / "a.png", image)
    codes = np.asarray(Image.open(tmp_path / "a.png"))
    assert codes.tolist() == [[0, 2, 2, 0, 255, 255, 0, 254]]


def test_half_precision_images_are_written(tmp_path):
    write_image(tmp_path / "a.png", jnp.ones((2, 2, 3), jnp.bfloat16))
    assert np.asarray(Image.open(tmp_path / "a.png")).min() == 255


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".JPG"])
def test_jpeg_is_close(tmp_path, suffix):
    ramp = np.linspace(0, 1, 64, dtype=np.float32)
    image = np.stack(np.broadcast_arrays(ramp[None, :], ramp[:, None], np.float32(0.5)), axis=-1)
    write_image(tmp_path / f"a{suffix}", image)
    assert (tmp_path / f"a{suffix}").read_bytes()[:2] == b"\xff\xd8"
    np.testing.assert_allclose(read_image(tmp_path / f"a{suffix}")[..., :3], image, atol=4 / 255)


@pytest.mark.parametrize(
    ("name", "image", "kind", "message"),
    [
        ("a.png", np.array([[0.0, np.nan, np.nan]]), ValueError, "2 of 3 values are NaN"),
        ("a.png", np.zeros((2, 2, 2)), ValueError, r"got shape \[2, 2, 2\]"),
        ("a.png", np.zeros((2,)), ValueError, r"got shape \[2\]"),
        ("a.png", np.zeros((0, 2, 3)), ValueError, r"got shape \[0, 2, 3\]"),
        ("a.png", np.zeros((2, 2), np.int64), TypeError, "got int64"),
        ("a.png", np.zeros((2, 2), bool), TypeError, "got bool"),
        ("a.jpg", np.zeros((2, 2, 4)), ValueError, "write a .png"),
        ("a.jpg", np.zeros((2, 2), np.uint16), ValueError, "write a .png"),
    ],
)
def test_unwritable_arrays(tmp_path, name, image, kind, message):
    (tmp_path / name).write_bytes(b"old")
    with pytest.raises(kind, match=message):
        write_image(tmp_path / name, image)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {name: b"old"}


def claiming(width: int, height: int) -> bytes:
    """A PNG whose header states any size; its data are a few zeros."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(100))), (b"IEND", b""))
    body = b"".join(struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + body


GOOD = encoded(Image.fromarray(np.random.default_rng(0).integers(0, 256, (32, 32, 3)).astype(np.uint8)))
BROKEN = {
    "nothing": b"",
    "junk": b"junk" * 20,
    "another format": encoded(Image.new("L", (2, 2)), "GIF"),
    "no pixels": claiming(0, 0),
    "cut off": GOOD[: len(GOOD) // 2],
    "cut off in the header": GOOD[:20],
    "bad checksum": GOOD[:60] + bytes([GOOD[60] ^ 255]) + GOOD[61:],
    "too little data": claiming(64, 64),
    "jpeg, cut off": encoded(Image.new("RGB", (64, 64)), "JPEG")[:300],
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_images(tmp_path, name):
    with pytest.raises(InputError, match=r"^x\.gltf: /images/3: .*; export the picture again$") as caught:
        read_image(BROKEN[name], name="x.gltf: /images/3")
    assert "\n" not in str(caught.value)
    (tmp_path / "a.png").write_bytes(BROKEN[name])
    with pytest.raises(InputError, match=r"a\.png: "):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("side", [10_000, 60_000])
def test_decompression_bombs(side):
    with pytest.raises(
        LimitError, match=rf"^bomb: is too large: .*{side * side} pixels.*limit of \d+ pixels.*; scale it down$"
    ):
        read_image(claiming(side, side), name="bomb")


def test_unreadable_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    cases = {"missing.png": "No such file", "": "is a folder", "pipe.png": "not a regular file", "a\0.png": "null"}
    for name, message in cases.items():
        with pytest.raises(InputError, match=message):
            read_image(f"{tmp_path}/{name}")
    with open(tmp_path / "huge.png", "wb") as file:
        file.truncate(2**31 + 1)
    with pytest.raises(LimitError, match="has 2147483649 bytes; at most 2147483648"):
        read_image(tmp_path / "huge.png")


PICTURE = np.zeros((4, 4, 3), np.float32)


def unwritable(folder) -> dict:
    (folder / "folder.png").mkdir()
    (folder / "file").write_bytes(b"")
    os.mkfifo(folder / "pipe.png")
    (folder / "loop.png").symlink_to("loop.png")
    return {
        "nowhere/a.png": f"there is no folder {folder}/nowhere; create it",
        "folder.png": "is a folder; add a file name",
        "file/a.png": "there is no folder",
        "pipe.png": "not a regular file",
        "loop.png": "symbolic links",
        "a": "no suffix .*; end the name with .png, .jpg, .jpeg",
        "a.exr": "unknown picture format '.exr'",
        "x" * 300 + ".png": "too long",
        "a\0b.png": "null",
    }


def test_impossible_targets(tmp_path):
    cases = unwritable(tmp_path)
    before = sorted(os.listdir(tmp_path))
    for name, message in cases.items():
        for attempt in (check_writable, lambda path: write_image(path, PICTURE)):
            with pytest.raises(OutputError, match=message) as caught:
                attempt(f"{tmp_path}/{name}")
            assert "\n" not in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == before


def test_check_writable_leaves_no_trace(tmp_path):
    (tmp_path / "old.png").write_bytes(b"old")
    check_writable(tmp_path / "old.png")
    check_writable(tmp_path / "new.png")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"old.png": b"old"}


def test_written_files_have_ordinary_rights_and_links_are_followed(tmp_path):
    (tmp_path / "link.png").symlink_to("real.png")
    before = os.umask(0o027)
    try:
        write_image(tmp_path / "link.png", PICTURE)
    finally:
        os.umask(before)
    assert (tmp_path / "link.png").is_symlink()
    assert read_image(tmp_path / "real.png").shape == (4, 4, 4)
    assert (tmp_path / "real.png").stat().st_mode & 0o777 == 0o640
    assert len(os.listdir(tmp_path)) == 2


@pytest.mark.parametrize("function", ["fsync", "replace"])
@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), OutputError, r"a\.png: cannot be written: No space left"),
        (KeyboardInterrupt("stop"), KeyboardInterrupt, "stop"),
    ],
)
def test_a_failing_disk_keeps_the_old_picture(tmp_path, monkeypatch, function, error, kind, message):
    (tmp_path / "a.png").write_bytes(b"old")

    def fail(*_):
        raise error

    monkeypatch.setattr(os, function, fail)
    with pytest.raises(kind, match=message):
        write_image(tmp_path / "a.png", PICTURE)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.png": b"old"}


def test_the_bytes_reach_the_disk_before_the_name(tmp_path, monkeypatch):
    calls = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda fd: (calls.append(os.path.isdir(f"/proc/self/fd/{fd}")), fsync(fd)))
    monkeypatch.setattr(os, "replace", lambda a, b: (calls.append((os.path.dirname(a), b)), replace(a, b)))
    write_image(tmp_path / "a.png", PICTURE)
    folder = os.path.realpath(tmp_path)
    assert calls == [False, (folder, f"{folder}/a.png"), True]


def test_a_full_disk_keeps_the_old_picture(tmp_path):
    """A limit on the size of files makes the kernel stop the write half way, as a full disk does."""
    (tmp_path / "a.png").write_bytes(b"old")
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
        with pytest.raises(OutputError, match="File too large"):
            write_image(tmp_path / "a.png", noise)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.png": b"old"}


def test_a_read_only_folder_is_found_before_rendering(tmp_path):
    """Rights do not bind the superuser, so ask as nobody."""
    command = [sys.executable, "-c", "import sys; from jaxraster.io.image import check_writable as c; c(sys.argv[1])"]
    command.append(str(tmp_path / "a.png"))
    if os.geteuid() == 0:
        if not shutil.which("setpriv"):
            pytest.skip("running as root, and no setpriv to become somebody else")
        command = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", *command]
        for parent in [*tmp_path.parents][:3]:
            parent.chmod(parent.stat().st_mode | 0o055)
    tmp_path.chmod(0o555)
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, cwd="/")
    tmp_path.chmod(0o755)
    if "ModuleNotFoundError" in done.stderr:
        pytest.skip("this Python cannot be used by another user")
    assert done.returncode == 1
    assert "OutputError" in done.stderr
    assert "cannot be written: Permission denied" in done.stderr


def test_no_warning_escapes():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_image(FORMATS["palette and alpha"][0])
