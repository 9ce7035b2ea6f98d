"""Pictures in and out: every pixel format, exact codes, broken files, and writes that never leave half a file."""

import errno
import io
import itertools
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zlib

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin
from watch import SOON, watched

from jaxraster.display.transfer import srgb_encode
from jaxraster.errors import Error, InputError, LimitError, OutputError
from jaxraster.io.image import check_writable, read_image, srgb_to_linear, write_image
from jaxraster.io.load import save
from jaxraster.io.reading import Limits

RAMP = np.arange(256, dtype=np.uint8)


def encoded(picture: Image.Image, kind: str = "PNG", **options) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, kind, **options)
    return buffer.getvalue()


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def filtered(row: bytes, above: bytes, step: int, method: int) -> bytes:
    """A row as PNG stores it: minus its left, upper, mean or Paeth neighbour."""
    out = [method]
    for i, value in enumerate(row):
        left, up = (row[i - step] if i >= step else 0), above[i]
        corner = above[i - step] if i >= step else 0
        paeth = min((left, up, corner), key=lambda c: abs(left + up - corner - c))
        out.append((value - (0, left, up, (left + up) // 2, paeth)[method]) % 256)
    return bytes(out)


PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


def png(codes: np.ndarray, depth: int, kind: int, *chunks: bytes, interlaced: bool = False) -> bytes:
    """Any PNG of samples `[h, w, c]`, every row filtered another way."""
    body = b""
    for x, y, dx, dy in PASSES if interlaced else ((0, 0, 1, 1),):
        part = codes[y::dy, x::dx]
        if not part.size:
            continue
        bits = (part.reshape(len(part), -1, 1) >> np.arange(depth)[::-1] & 1).astype(np.uint8)
        rows = [row.tobytes() for row in np.packbits(bits.reshape(len(part), -1), axis=1)]
        step = max(1, depth * codes.shape[2] // 8)
        above = [bytes(len(rows[0])), *rows]
        body += b"".join(filtered(row, above[i], step, i % 5) for i, row in enumerate(rows))
    header = struct.pack(">IIBBBBB", codes.shape[1], codes.shape[0], depth, kind, 0, 0, interlaced)
    middle = b"".join(chunks) + chunk(b"IDAT", zlib.compress(body))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + middle + chunk(b"IEND", b"")


GREY, RGB, PALETTE, GREY_ALPHA, RGBA = 0, 2, 3, 4, 6
CHANNELS = {GREY: 1, RGB: 3, PALETTE: 1, GREY_ALPHA: 2, RGBA: 4}
DEPTHS = {GREY: (1, 2, 4, 8, 16), PALETTE: (1, 2, 4, 8), RGB: (8, 16), GREY_ALPHA: (8, 16), RGBA: (8, 16)}
KINDS = [(kind, depth, clear) for kind in DEPTHS for depth in DEPTHS[kind] for clear in (False, True)]
KINDS = [(kind, depth, clear) for kind, depth, clear in KINDS if not (clear and kind in (GREY_ALPHA, RGBA))]
SHADES = np.random.default_rng(1).integers(0, 256, (256, 4)).astype(np.uint8)


@pytest.mark.parametrize("interlaced", [False, True])
@pytest.mark.parametrize(("kind", "depth", "clear"), KINDS)
def test_every_kind_of_png(kind, depth, clear, interlaced):
    """All 15 pairs of kind and depth, with and without a transparent colour, in rows and interlaced."""
    most = 2**depth - 1
    codes = np.random.default_rng(depth).integers(0, most + 1, (11, 13, CHANNELS[kind]))
    codes[3, 4] = codes[9, 9] = codes[0, 0]
    chunks, alpha = [], np.ones((11, 13))
    if kind == PALETTE:
        chunks = [chunk(b"PLTE", SHADES[: most + 1, :3].tobytes())]
        chunks += [chunk(b"tRNS", SHADES[: most + 1, 3].tobytes())] if clear else []
        expected = SHADES[codes[..., 0]] / 255
        expected[..., 3] = expected[..., 3] if clear else 1
    else:
        if clear:
            chunks = [chunk(b"tRNS", codes[0, 0].astype(">u2").tobytes())]
            alpha = (codes != codes[0, 0]).any(axis=-1).astype(np.float64)
        color = codes[..., :3] if kind in (RGB, RGBA) else np.repeat(codes[..., :1], 3, axis=-1)
        alpha = codes[..., -1] / most if kind in (GREY_ALPHA, RGBA) else alpha
        expected = np.concatenate([color / most, alpha[..., None]], axis=-1)
    image = read_image(png(codes, depth, kind, *chunks, interlaced=interlaced))
    assert image.dtype == np.float32
    np.testing.assert_array_equal(image, expected.astype(np.float32))


def jpeg() -> Image.Image:
    ramp = np.arange(64, dtype=np.uint8).reshape(8, 8) * 4
    return Image.fromarray(np.stack([ramp, ramp.T, ramp[::-1]], axis=-1))


def tags(orientation: int) -> bytes:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif.tobytes()


TEXT = PngImagePlugin.PngInfo()
TEXT.add_text("Comment", "text", zip=True)
TAGGED = {
    "png, orientation": encoded(jpeg(), exif=tags(6)),
    "png, profile": encoded(jpeg(), icc_profile=b"not a profile at all"),
    "png, gamma": encoded(jpeg())[:33] + chunk(b"gAMA", struct.pack(">I", 100_000)) + encoded(jpeg())[33:],
    "png, text": encoded(jpeg(), pnginfo=TEXT),
    "png, animated": encoded(jpeg(), save_all=True, append_images=[Image.new("RGB", (8, 8))]),
    "jpeg, orientation": encoded(jpeg(), "JPEG", exif=tags(6)),
    "jpeg, broken tags": encoded(jpeg(), "JPEG", exif=b"Exif\0\0MM\0*\xff\xff\xff\xff"),
    "jpeg, profile": encoded(jpeg(), "JPEG", icc_profile=b"not a profile at all"),
    "webp": encoded(jpeg(), "WEBP", lossless=True),
    "webp, orientation": encoded(jpeg(), "WEBP", lossless=True, exif=tags(6)),
}


@pytest.mark.parametrize("name", TAGGED)
def test_tags_change_no_pixel(name):
    plain = encoded(jpeg(), "JPEG") if "jpeg" in name else encoded(jpeg())
    image = read_image(TAGGED[name])
    assert image.shape == (8, 8, 4)
    np.testing.assert_array_equal(image, read_image(plain))


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


ALL_CODES = np.arange(65536, dtype=np.uint16).reshape(256, 256)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_16_bits_keep_every_code(tmp_path, channels):
    """In both directions and for codes as well as floats; a float is code / 65535."""
    codes = np.stack([np.roll(ALL_CODES, 7 * i + 1) for i in range(channels)], axis=-1)
    written = codes[..., 0] if channels == 1 else codes
    write_image(tmp_path / "codes.png", written)
    write_image(tmp_path / "floats.png", jnp.asarray(written.astype(np.float32) / 65535), bits=16)
    assert (tmp_path / "codes.png").read_bytes() == (tmp_path / "floats.png").read_bytes()
    image = read_image(tmp_path / "codes.png")
    np.testing.assert_array_equal(image[..., : codes.shape[2]], (codes / 65535).astype(np.float32))
    np.testing.assert_array_equal(np.rint(image[..., : codes.shape[2]] * 65535), codes)
    assert channels == 4 or (image[..., 3] == 1).all()
    # Let another program's decoder read the same file; of colour it keeps the upper bytes.
    with Image.open(tmp_path / "codes.png") as other:
        np.testing.assert_array_equal(np.asarray(other), written if channels == 1 else written >> 8)


@pytest.mark.parametrize("bits", [8, 16])
def test_codes_survive_linear_light(tmp_path, bits):
    """sRGB is decoded once and encoded once: from codes to linear light and back, all are as they were."""
    dtype = np.dtype(f"uint{bits}")
    codes = np.resize(np.arange(2**bits, dtype=dtype), (256, 256, 3))
    write_image(tmp_path / "a.png", codes)
    linear = srgb_to_linear(read_image(tmp_path / "a.png"))
    assert linear[128, 128, 0] < 0.9 * (codes[128, 128, 0] / np.iinfo(dtype).max)
    write_image(tmp_path / "b.png", srgb_encode(jnp.asarray(linear[..., :3])), bits=bits)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


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


def test_bits_are_8_or_16(tmp_path):
    with pytest.raises(ValueError, match=r"^bits: expected 8 or 16, got 10$"):
        write_image(tmp_path / "a.png", np.zeros((2, 2)), bits=10)
    with pytest.raises(ValueError, match="JPEG holds 8-bit grey or RGB, got uint16"):
        write_image(tmp_path / "a.jpg", np.zeros((2, 2)), bits=16)
    assert not any(tmp_path.iterdir())


def claiming(width: int, height: int, depth: int = 8, kind: int = GREY, data: bytes = bytes(100)) -> bytes:
    """A PNG whose header states any size; its data are a few zeros."""
    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(data)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*pair) for pair in chunks)


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
    "too little data, 16 bits": claiming(64, 64, 16, RGBA),
    "cut off, 16 bits": png(np.arange(243).reshape(9, 9, 3) ** 2, 16, RGB)[:-40],
    "no data, 16 bits": png(np.zeros((9, 9, 3), int), 16, RGB)[:33] + chunk(b"IEND", b""),
    "no such depth": claiming(2, 2, 3),
    "no such kind": claiming(2, 2, 8, 5),
    "no such kind, 16 bits": claiming(2, 2, 16, PALETTE),
    "header elsewhere": GOOD[:8] + GOOD[33:],
    "webp, cut off": TAGGED["webp"][:60],
    "another container": b"RIFF" + bytes(4) + b"WAVE" + bytes(40),
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


def jpeg_of(width: int, height: int) -> bytes:
    """A JPEG whose header states any size."""
    data = encoded(Image.new("L", (8, 8)), "JPEG")
    start = data.index(b"\xff\xc0") + 5
    return data[:start] + struct.pack(">HH", height, width) + data[start + 4 :]


def webp_of(kind: bytes, header: bytes) -> bytes:
    """A WebP that ends after the header of its first chunk."""
    return b"RIFF" + bytes(4) + b"WEBP" + kind + bytes(4) + header


PROPORTION = claiming(2**12, 2**12 + 1).ljust(104_884, b"\0")  # a 640th of the bytes of its codes
BOMBS = {
    "empty claim": (
        claiming(60_000, 60_000),
        "header claims 3600000000 pixels from a 69 byte file; export the picture again$",
    ),
    "little over": (claiming(2**12, 2**12 + 1), "header claims 16781312 pixels from a 69 byte file"),
    "little over, 16 bits": (claiming(2**12, 2**11 + 1, 16, RGBA), "header claims 8392704 pixels from a 69 byte file"),
    "little over, a larger file": (PROPORTION[:-1], "header claims 16781312 pixels from a 104883 byte file"),
    "largest claim": (claiming(2**31 - 1, 2**31 - 1), "header claims 4611686014132420609 pixels"),
    "zeros": (
        claiming(2**13, 2**13, 1, GREY, bytes(2**13 * (2**10 + 1))),
        r"header claims 67108864 pixels from a \d{4} byte file",
    ),
    "jpeg": (jpeg_of(60_000, 60_000), r"header claims 3600000000 pixels from a \d{3} byte file"),
    "webp of no size": (
        webp_of(b"VP8L", b"/" + bytes((255,)) * 4),
        "header claims 268435456 pixels from a 25 byte file",
    ),
    "large": (
        claiming(2**13 + 1, 2**13) + bytes(2**19),
        r"has 8193 x 8192 pixels; at most 67108864 are allowed \(limit image_pixels\)",
    ),
    "jpeg, large": (
        jpeg_of(2**14 + 1, 9),
        r"has a side of 16385 pixels; at most 16384 are allowed \(limit image_side\)",
    ),
    "long": (claiming(2**14 + 1, 1), r"has a side of 16385 pixels; at most 16384 are allowed \(limit image_side\)"),
    "jpeg, little over": (
        jpeg_of(2**13 + 1, 2**13) + bytes(2**19),
        "has 8193 x 8192 pixels; at most 67108864 are allowed",
    ),
    "webp": (
        webp_of(b"VP8 ", bytes(6) + struct.pack("<HH", 16383, 4097) + bytes(2**19)),
        "has 16383 x 4097 pixels; at most 67108864",
    ),
    "webp, lossless": (
        webp_of(b"VP8L", b"/" + bytes((255,)) * 4 + bytes(2**21)),
        "has 16384 x 16384 pixels; at most 67108864",
    ),
    "webp, canvas": (webp_of(b"VP8X", bytes(4) + (10**7).to_bytes(3, "little") + bytes(3)), "has a side of 10000001"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_decompression_bombs(name):
    data, message = BOMBS[name]
    began = time.process_time()
    with pytest.raises(LimitError, match=f"^bomb: {message}") as caught:
        read_image(data, name="bomb")
    assert "\n" not in str(caught.value)
    assert time.process_time() - began < 2


@pytest.mark.parametrize("data", [claiming(2**12, 2**12), claiming(2**12, 2**11, 16, RGBA), PROPORTION])
def test_the_largest_claims_are_left_to_the_decoder(data):
    with pytest.raises(InputError, match=r"^x: is broken: .*; export the picture again$"):
        read_image(data, name="x")


def deepest(interlaced: bool) -> bytes:
    """A flat PNG of 16 bits with a transparent colour, which takes longest of all that may claim 64 MiB."""
    height, width = 2**11, 2**12
    sizes = [(len(range(y, height, dy)), len(range(x, width, dx))) for x, y, dx, dy in PASSES]
    rows = b"".join(count * (b"\4" + bytes(6 * wide)) for count, wide in (sizes if interlaced else [(height, width)]))
    header = struct.pack(">IIBBBBB", width, height, 16, RGB, 0, 0, interlaced)
    chunks = ((b"IHDR", header), (b"tRNS", bytes(6)), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*pair) for pair in chunks)


LARGEST = {
    "rgba": lambda: encoded(Image.new("RGBA", (4096, 4096), (255, 10, 20, 255))),
    "one bit": lambda: encoded(Image.new("1", (4096, 4096))),
    "jpeg": lambda: encoded(Image.new("RGB", (4096, 4096)), "JPEG"),
    "webp": lambda: encoded(Image.new("RGB", (4096, 4096)), "WEBP"),
    "webp, lossless": lambda: encoded(Image.new("RGBA", (4096, 4096)), "WEBP", lossless=True),
    "16 bits": lambda: deepest(False),
    "16 bits, interlaced": lambda: deepest(True),
}


@pytest.mark.parametrize("name", LARGEST)
def test_the_largest_flat_picture_takes_two_seconds_and_512_megabytes(tmp_path, name):
    """Its codes are 64 MiB; any file may claim as many."""
    (tmp_path / "a").write_bytes(LARGEST[name]())
    with watched(tmp_path):
        assert read_image(tmp_path / "a").shape == (2048 if "16" in name else 4096, 4096, 4)


def test_a_jpeg_of_many_scans_is_refused():
    """Each goes over all pixels again, however few bytes it has."""
    data = encoded(Image.new("L", (64, 64), 51), "JPEG", progressive=True)
    last = data[data.rindex(b"\xff\xda") : -2]
    more = 64 - data.count(b"\xff\xda")
    image = read_image(data[:-2] + more * last + data[-2:])
    np.testing.assert_allclose(image, np.broadcast_to((0.2, 0.2, 0.2, 1), (64, 64, 4)), atol=2 / 255)
    with pytest.raises(LimitError, match=r"^x: has 65 scans; at most 64 are allowed; export the picture again$"):
        read_image(data[:-2] + (more + 1) * last + data[-2:], name="x")


SMALL = {
    "png": encoded(jpeg().resize((8, 4))),
    "png, 16 bits": png(np.zeros((4, 8, 3), int), 16, RGB),
    "jpeg": encoded(jpeg().resize((8, 4)), "JPEG"),
    "webp": encoded(jpeg().resize((8, 4)), "WEBP"),
}


@pytest.mark.parametrize("name", SMALL)
def test_each_limit_is_the_last_size_that_is_read(tmp_path, monkeypatch, name):
    """Also beyond the limit that Pillow has for itself, but for WebP."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 16 if name == "webp" else 10)
    (tmp_path / "a").write_bytes(SMALL[name])
    size = len(SMALL[name])
    limits = {
        "image_side": (8, "has a side of 8 pixels"),
        "image_pixels": (32, "has 8 x 4 pixels"),
        "file_bytes": (size, f"has {size} bytes"),
    }
    for limit, (most, message) in limits.items():
        assert read_image(tmp_path / "a", limits=Limits(**{limit: most})).shape == (4, 8, 4)
        with pytest.raises(LimitError, match=rf"a: {message}; at most {most - 1} are allowed \(limit {limit}\)$"):
            read_image(tmp_path / "a", limits=Limits(**{limit: most - 1}))


def test_webp_has_a_limit_of_its_own(monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 15)
    with pytest.raises(LimitError, match=r"^x: is too large: .*\(32 pixels\) exceeds limit of 30 .*; scale it down$"):
        read_image(SMALL["webp"], name="x")


def test_an_animation_is_no_picture():
    data = encoded(jpeg(), "WEBP", save_all=True, append_images=[Image.new("RGB", (8, 8))])
    with pytest.raises(InputError, match=r"^x: is an animation; export a single picture$"):
        read_image(data, name="x")


def test_unreadable_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "device.png").symlink_to("/dev/zero")
    cases = {
        "missing.png": "No such file",
        "": "is a folder",
        "pipe.png": "is not a regular file",
        "device.png": "is not a regular file",
        "a\0.png": "null",
    }
    for name, message in cases.items():
        with pytest.raises(InputError, match=message) as caught:
            read_image(f"{tmp_path}/{name}")
        assert "\n" not in str(caught.value)
    with open(tmp_path / "huge.png", "wb") as file:
        file.truncate(2**31 + 1)
    with pytest.raises(LimitError, match=r"has 2147483649 bytes; at most 2147483648 are allowed \(limit file_bytes\)$"):
        read_image(tmp_path / "huge.png")


def test_a_file_that_may_not_be_read(tmp_path):
    """Rights do not bind the superuser, so ask as nobody."""
    (tmp_path / "a.png").write_bytes(GOOD)
    (tmp_path / "a.png").chmod(0)
    user = os.geteuid()
    try:
        if user == 0:
            os.seteuid(65534)
        with pytest.raises(InputError, match=r"a\.png: cannot be read: Permission denied; check the path and its"):
            read_image(tmp_path / "a.png")
    finally:
        os.seteuid(user)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
@pytest.mark.parametrize("size", [(1, 1), (1, 16383), (16383, 1), (3, 5), (257, 129)])
def test_any_shape_is_read_and_any_name(tmp_path, kind, size):
    """Sides need be no powers of two, and a suffix decides nothing."""
    picture = Image.new("RGB", size, (0, 51, 255))
    (tmp_path / "a.gif").write_bytes(encoded(picture, kind, **({"lossless": True} if kind == "WEBP" else {})))
    image = read_image(tmp_path / "a.gif")
    assert image.shape == (size[1], size[0], 4)
    np.testing.assert_allclose(image, np.broadcast_to((0, 0.2, 1, 1), image.shape), atol=2 / 255 * (kind == "JPEG"))


def test_the_longest_side_is_read():
    assert read_image(encoded(Image.new("1", (1, 2**14)))).shape == (2**14, 1, 4)


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


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666])
def test_a_replaced_file_keeps_its_permissions(tmp_path, mode):
    (tmp_path / "a.png").write_bytes(b"old")
    (tmp_path / "a.png").chmod(mode)
    write_image(tmp_path / "a.png", PICTURE)
    assert (tmp_path / "a.png").stat().st_mode & 0o7777 == mode
    assert read_image(tmp_path / "a.png").shape == (4, 4, 4)


def test_a_read_only_file_is_not_replaced(tmp_path, monkeypatch):
    """Whoever asks: the superuser, whom no permissions bind, is told what others are."""
    (tmp_path / "a.png").write_bytes(b"old")
    monkeypatch.setattr(os, "access", lambda path, mode: not (str(path).endswith("a.png") and mode == os.W_OK))
    for attempt in (check_writable, lambda path: write_image(path, PICTURE)):
        with pytest.raises(OutputError, match=r"cannot be written: the file is read-only; choose another name$"):
            attempt(tmp_path / "a.png")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.png": b"old"}


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 64 kB."""
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True) if shutil.which("mount") else None
    if done is None or done.returncode:
        pytest.skip(f"mounting is not permitted: {done.stderr.strip() if done else 'there is no mount'}")
    yield tmp_path
    subprocess.run(["umount", str(tmp_path)], check=True)


@pytest.mark.parametrize("suffix", [".png", ".hdr", ".exr"])
def test_a_disk_that_is_full_keeps_the_old_file(small_disk, suffix):
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    old = np.random.default_rng(0).bytes(4096)
    path = small_disk / f"a{suffix}"
    path.write_bytes(old)
    noise = np.random.default_rng(1).random((256, 256, 3)).astype(np.float32)
    with pytest.raises(OutputError, match=r"^\S*a\.\w+: cannot be written: No space left on device") as caught:
        save(path, noise)
    assert "\n" not in str(caught.value)
    assert {p.name: p.read_bytes() for p in small_disk.iterdir()} == {f"a{suffix}": old}


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


def test_a_read_only_folder_is_found_before_rendering():
    """Rights do not bind the superuser, so ask as nobody, who may not enter the folders that pytest makes."""
    command = [sys.executable, "-c", "import sys; from jaxraster.io.image import check_writable as c; c(sys.argv[1])"]
    if os.geteuid() == 0:
        if not shutil.which("setpriv"):
            pytest.skip("running as root, and no setpriv to become somebody else")
        command = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups", *command]
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o555)
        done = subprocess.run([*command, f"{folder}/a.png"], capture_output=True, text=True, timeout=100, cwd="/")
    if "ModuleNotFoundError" in done.stderr:
        pytest.skip("this Python cannot be used by another user")
    assert done.returncode == 1
    assert "OutputError" in done.stderr
    assert "cannot be written: Permission denied" in done.stderr


def test_no_warning_escapes():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_image(FORMATS["palette and alpha"][0])


def test_save_keeps_light_and_pictures_apart(tmp_path):
    """A picture is clipped and coded; light, whose values may be any, is not."""
    light = np.full((2, 9, 3), 5.0, np.float32)
    save(tmp_path / "a.png", light)
    save(tmp_path / "a.hdr", light)
    assert (read_image(tmp_path / "a.png") == 1).all()
    assert (tmp_path / "a.hdr").read_bytes().startswith(b"#?RADIANCE")
    with pytest.raises(OutputError, match=r"unknown picture format '\.bmp'"):
        save(tmp_path / "a.bmp", light)


def outcome(data: bytes) -> str:
    """Whether a picture came of a file, or one typed error."""
    began = time.process_time()
    try:
        image = read_image(data, name="x")
    except Error as error:
        assert str(error).startswith("x: ")
        assert "\n" not in str(error)
        return "refused"
    finally:
        assert time.process_time() - began < SOON
    assert image.dtype == np.float32
    assert image.shape[2:] == (4,)
    assert 0 <= image.min() <= image.max() <= 1
    return "read"


TALL = png(np.random.default_rng(3).integers(0, 256, (33, 17, 3)), 8, RGB)


def test_a_file_cut_off_anywhere_gives_a_picture_or_one_typed_error(tmp_path):
    """A picture only where no more than the two checksums of the pixels, 8 bytes, and the end mark, 12, are missing."""
    with watched(tmp_path):
        outcomes = {end: outcome(TALL[:end]) for end in range(0, len(TALL) + 1, 4)}
    assert outcomes == {end: "read" if end >= len(TALL) - 20 else "refused" for end in outcomes}


def test_swapped_header_fields_give_a_picture_or_one_typed_error(tmp_path):
    """Width, height, depth, kind and interlacing in every order, with the checksum made right again."""
    fields, read = (17, 33, 8, RGB, 0), set()
    with watched(tmp_path):
        for order in itertools.permutations(range(5)):
            width, height, depth, kind, interlaced = (fields[i] for i in order)
            header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, interlaced))
            if outcome(TALL[:8] + header + TALL[33:]) == "read":
                read.add((width, height, depth, kind, interlaced))
    assert read == {fields}


VALID = [
    GOOD,
    encoded(Image.new("LA", (9, 9), (51, 102))),
    png(np.random.default_rng(2).integers(0, 65536, (9, 9, 3)), 16, RGB),
    png(np.random.default_rng(2).integers(0, 4, (9, 9, 1)), 2, GREY, chunk(b"tRNS", b"\0\2"), interlaced=True),
    palette(alpha=True),
]


@settings(max_examples=500, deadline=None, derandomize=True)
@given(
    st.sampled_from(VALID),
    st.lists(st.tuples(st.integers(0, 100) | st.integers(0, 2**16), st.integers(1, 255)), max_size=4),
    st.booleans(),
    st.data(),
)
def test_damage_gives_an_image_or_one_typed_error(data, flips, mend, draw):
    """`mend` makes the header's checksum right again, so that the damage gets past it."""
    broken = bytearray(data)
    for place, bits in flips:
        broken[place % len(broken)] ^= bits
    if mend:
        broken[29:33] = struct.pack(">I", zlib.crc32(broken[12:29]))
    broken = bytes(broken[: draw.draw(st.integers(0, len(broken)) | st.just(len(broken)))])
    outcome(broken)
