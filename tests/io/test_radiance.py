"""Radiance pictures: every code of pixels, every orientation, exact values, guards, and one error for any damage."""

import itertools
import os
import time

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from watch import SOON, watched

from jaxraster.errors import Error, InputError, LimitError, OutputError
from jaxraster.io.light import read_light
from jaxraster.io.load import save
from jaxraster.io.radiance import LARGEST, read_hdr, write_hdr
from jaxraster.io.reading import Limits

HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def file(pixels: bytes, height: int, width: int, header: bytes = HEADER) -> bytes:
    return header + f"-Y {height} +X {width}\n".encode() + pixels


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """Read bytes through a file named sky.hdr."""
    folder = tmp_path_factory.mktemp("light")

    def read(data: bytes, limits: Limits | None = None) -> np.ndarray:
        (folder / "sky.hdr").write_bytes(data)
        return read_hdr(folder / "sky.hdr", limits or Limits())

    read.folder = folder
    return read


def radiance(codes: np.ndarray) -> np.ndarray:
    """The definition, in double precision."""
    mantissa, exponent = codes[..., :3].astype(np.float64), codes[..., 3:].astype(np.float64)
    return np.where(exponent > 0, mantissa * 2.0 ** (exponent - 136), 0)


def flat(codes: np.ndarray) -> bytes:
    return codes.tobytes()


def older(codes: np.ndarray) -> bytes:
    """Every repeat as a run, its count in base 256, low digit first."""
    out = b""
    for line in codes.tolist():
        at = 0
        while at < len(line):
            count = 1
            while at + count < len(line) and line[at + count] == line[at]:
                count += 1
            out += bytes(line[at])
            rest, at = count - 1, at + count
            while rest:
                out += bytes((1, 1, 1, rest % 256))
                rest //= 256
    return out


def newer(codes: np.ndarray, longest: int = 127) -> bytes:
    """Single values and pairs as literals, three or more equal ones as runs of at most `longest`."""
    out = b""
    for line in codes:
        out += b"\2\2" + len(line).to_bytes(2, "big")
        for plane in line.T.tolist():
            at = 0
            while at < len(plane):
                count = 1
                while at + count < len(plane) and plane[at + count] == plane[at] and count < longest:
                    count += 1
                out += bytes((128 + count, plane[at])) if count > 2 else bytes((count, *plane[at : at + count]))
                at += count
    return out


def noise(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Codes with stretches of equal pixels, none of which looks like a run."""
    random = np.random.default_rng(seed)
    codes = random.integers(0, 256, (height, width, 4)).astype(np.uint8)
    codes[..., 0] |= 128
    repeat = random.random((height, width)) < 0.7
    for x in range(1, width):
        codes[:, x] = np.where(repeat[:, x : x + 1], codes[:, x - 1], codes[:, x])
    return codes


WIDE = np.full((2, 600, 4), 200, np.uint8)  # its runs need two digits, then none
ENCODINGS = {
    "flat": (flat, noise(5, 40)),
    "flat, too narrow for run lengths": (flat, noise(5, 7)),
    "flat, too wide for run lengths": (flat, noise(1, 2**15)),
    "flat, first pixel looks like a newer scanline": (flat, np.array([[[2, 2, 128, 130]] * 9], np.uint8)),
    "flat, single pixel": (flat, noise(1, 1)),
    "older": (older, noise(5, 40)),
    "older, narrow": (older, noise(5, 3)),
    "older, runs of 256 and more": (older, WIDE),
    "older, a run of 257": (older, WIDE[:, :258]),
    "newer": (newer, noise(5, 40)),
    "newer, narrowest": (newer, noise(5, 8)),
    "newer, widest": (newer, noise(1, 2**15 - 1)),
    "newer, runs of one": (lambda codes: newer(codes, 1), noise(5, 9)),
}


@pytest.mark.parametrize("name", ENCODINGS)
def test_each_encoding_is_read(read, name):
    encode, codes = ENCODINGS[name]
    light = read(file(encode(codes), *codes.shape[:2]))
    assert light.dtype == np.float32
    np.testing.assert_array_equal(light, radiance(codes))
    # Bytes after the last scanline are nobody's.
    np.testing.assert_array_equal(read(file(encode(codes) + b"tail", *codes.shape[:2])), light)


def test_encodings_may_change_between_scanlines(read):
    codes = noise(6, 40)
    pixels = b"".join(encode(codes[i : i + 1]) for i, encode in enumerate((newer, flat, older, older, newer, flat)))
    np.testing.assert_array_equal(read(file(pixels, 6, 40)), radiance(codes))


def test_every_mantissa_and_exponent(read):
    mantissa, exponent = np.meshgrid(np.arange(256), np.arange(256), indexing="ij")
    codes = np.stack([mantissa, 255 - mantissa, mantissa // 2, exponent], axis=-1).astype(np.uint8)
    light = read(file(newer(codes), 256, 256))
    np.testing.assert_array_equal(light, radiance(codes))
    assert light[255, 255, 0] == np.float32(LARGEST)
    assert not light[:, 0].any()


@pytest.mark.parametrize("encode", [flat, newer])
@pytest.mark.parametrize("axes", ["-Y +X", "-Y -X", "+Y +X", "+Y -X", "+X -Y", "-X -Y", "+X +Y", "-X +Y"])
def test_each_orientation(read, axes, encode):
    """The first axis is that of the scanlines; Y grows upward in the picture, X to the right."""
    count, width = 9, 12
    codes = noise(count, width)
    slow, fast = axes.split()
    height_and_width = (count, width) if slow[1] == "Y" else (width, count)
    expected = np.zeros((*height_and_width, 3))
    for i in range(count):
        for j in range(width):
            place = {slow[1]: (slow[0], i, count), fast[1]: (fast[0], j, width)}
            sign, step, size = place["Y"]
            row = step if sign == "-" else size - 1 - step
            sign, step, size = place["X"]
            column = step if sign == "+" else size - 1 - step
            expected[row, column] = radiance(codes[i, j])
    resolution = f"{slow} {count} {fast} {width}\n".encode()
    np.testing.assert_array_equal(read(HEADER + resolution + encode(codes)), expected)


@pytest.mark.parametrize(
    ("lines", "factor"),
    [
        ("", (1, 1, 1)),
        ("# a comment\nmade by hand\nPRIMARIES=0 0 0 0 0 0 0 0\nGAMMA=1\nVIEW= -vtv\n", (1, 1, 1)),
        ("FORMAT=32-bit_rle_rgbe\nFORMAT = 8-bit\n\tFORMAT=32-bit_rle_xyze\n", (1, 1, 1)),
        ("EXPOSURE=0.5\n", (2, 2, 2)),
        ("EXPOSURE= 4.0e+00\r\nEXPOSURE=0.5\n", (0.5, 0.5, 0.5)),
        ("COLORCORR=2 4 8\nCOLORCORR=1 0.5 0.25\nEXPOSURE=0.25\n", (2, 2, 2)),
        ("\tEXPOSURE=7\n # EXPOSURE=7\nEXPOSURES=7\n", (1, 1, 1)),
    ],
)
@pytest.mark.parametrize("magic", ["#?RADIANCE", "#?RGBE", "#?"])
def test_header_lines(read, lines, factor, magic):
    codes = noise(2, 9)
    light = read(file(newer(codes), 2, 9, f"{magic}\n{lines}\n".encode()))
    np.testing.assert_array_equal(light, radiance(codes) * factor)
    assert light.dtype == np.float32


def test_an_exposure_that_overflows_is_infinite_and_repaired(tmp_path):
    codes = np.array([[[255, 0, 1, 255], [128, 128, 128, 129]]], np.uint8)
    (tmp_path / "a.hdr").write_bytes(file(flat(codes), 1, 2, b"#?RADIANCE\nEXPOSURE=1e-30\n\n"))
    assert read_hdr(tmp_path / "a.hdr")[0, 0].tolist() == [np.inf, 0, np.inf]
    light, notes = read_light(tmp_path / "a.hdr")
    assert light[0, 0].tolist() == [0, 0, 0]
    assert light[0, 1, 0] == np.float32(1.844e18)
    assert notes == (
        "1 of 2 texels are not finite; they become black",
        "1 of 2 texels are above 1.844e+18; they become that",
    )


ONE = flat(noise(1, 1))
PLAIN = b"-Y 1 +X 1\n" + ONE
BAD_HEADERS = {
    "wrong magic": (b"P6\n1 1\n255\n...", "not a Radiance picture: it begins with b'P6"),
    "a png": (b"\x89PNG\r\n\x1a\n", "not a Radiance picture"),
    "nothing": (b"", "is empty"),
    "no magic": (HEADER[10:] + PLAIN, "not a Radiance picture: it begins with b'\\\\nFORMAT="),
    "endless": (b"#?RADIANCE\n" + b"a=1\n" * 30_000, "header: has no empty line"),
    "xyze": (
        b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n" + PLAIN,
        "its colours are CIE XYZ, .* convert it to RGB",
    ),
    "unknown format": (b"#?RADIANCE\nFORMAT=16-bit\n\n" + PLAIN, "header: unknown format '16-bit'; known is 32-bit"),
    "exposure of nothing": (b"#?RADIANCE\nEXPOSURE=0\n\n" + PLAIN, "'EXPOSURE=0' is not 1 positive number"),
    "exposure of text": (b"#?RADIANCE\nEXPOSURE=bright\n\n" + PLAIN, "'EXPOSURE=bright' is not 1 positive number"),
    "exposure of NaN": (b"#?RADIANCE\nEXPOSURE=nan\n\n" + PLAIN, "'EXPOSURE=nan' is not 1 positive number"),
    "two corrections": (b"#?RADIANCE\nCOLORCORR=1 2\n\n" + PLAIN, "'COLORCORR=1 2' is not 3 positive numbers"),
    "exposures beyond": (b"#?RADIANCE\n" + b"EXPOSURE=1e200\n" * 2 + b"\n" + PLAIN, "exposures multiply to .*inf"),
    "no resolution": (b"#?RADIANCE\n\n", "header: '' is not a resolution"),
    "resolution of nothing": (HEADER + b"-Y 0 +X 5\n", "'-Y 0 .X 5' is not a resolution"),
    "negative size": (HEADER + b"-Y -3 +X 5\n", "'-Y -3 .X 5' is not a resolution"),
    "one axis twice": (HEADER + b"-Y 3 +Y 5\n", "'-Y 3 .Y 5' is not a resolution"),
    "an axis without sign": (HEADER + b"Y 3 X 5\n", "'Y 3 X 5' is not a resolution"),
    "cut off in the resolution": (HEADER + b"-Y 3 +X 5", "is not a resolution"),
    "a number of 5000 digits": (HEADER + b"-Y " + b"9" * 5000 + b" +X 5\n", "is not a resolution"),
}


@pytest.mark.parametrize("name", BAD_HEADERS)
def test_bad_headers(read, name):
    data, message = BAD_HEADERS[name]
    with pytest.raises(InputError, match=rf"sky\.hdr: .*{message}") as caught:
        read(data)
    assert "\n" not in str(caught.value)


GOOD = b"\2\2\0\x08" + bytes((136, 1)) * 4
BAD_SCANLINES = {
    "flat, cut off": (9, flat(noise(3, 9))[:-1], "scanline 3 of 3: is cut off"),
    "flat, nothing": (9, b"", "scanline 1 of 3: is cut off"),
    "newer, cut off between scanlines": (8, GOOD * 2, "scanline 3 of 3: is cut off"),
    "newer, cut off in a literal": (8, GOOD + b"\2\2\0\x08" + bytes((8, 1, 2)), "scanline 2 of 3: is cut off"),
    "newer, cut off in a run": (8, GOOD + b"\2\2\0\x08" + bytes((136,)), "scanline 2 of 3: is cut off"),
    "newer, cut off in its mark": (8, GOOD + b"\2\2\0", "scanline 2 of 3: is cut off"),
    "newer, last literal promises more": (
        8,
        GOOD * 2 + GOOD[:-2] + bytes((9, *range(8))),
        "scanline 3 of 3: is cut off",
    ),
    "newer, run too long": (
        8,
        GOOD + b"\2\2\0\x08" + bytes((138, 1)) * 4,
        "scanline 2 of 3: has a run that ends 2 ",
    ),
    "newer, literal too long": (
        8,
        b"\2\2\0\x08" + bytes((9, *range(9))) * 4,
        "scanline 1 of 3: has a run that ends 1 ",
    ),
    "newer, empty run": (8, b"\2\2\0\x08" + bytes((0, 5)) * 4, "scanline 1 of 3: has an empty run"),
    "newer, another width": (8, b"\2\2\0\x09" + GOOD, "scanline 1 of 3: states 9 pixels, the header 8"),
    "older, begins with a run": (9, bytes((1, 1, 1, 9)) * 9, "scanline 1 of 3: begins with a run"),
    "older, run too long": (9, bytes((9, 9, 9, 9, 1, 1, 1, 9)) * 9, "scanline 1 of 3: has a run that ends 1 pixels"),
    "older, run of 256^10": (
        20,
        bytes((9, 9, 9, 9)) + bytes((1, 1, 1, 0)) * 10 + bytes((1, 1, 1, 1)) * 30,
        "scanline 1 of 3: has a run that ends",
    ),
}


@pytest.mark.parametrize("name", BAD_SCANLINES)
def test_bad_scanlines_are_named(read, name):
    width, pixels, message = BAD_SCANLINES[name]
    with pytest.raises(InputError, match=rf"sky\.hdr: {message}.*; export the picture again$") as caught:
        read(file(pixels, 3, width))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("height", "width", "size", "message"),
    [
        (40_000, 40_000, 53, "header claims 1600000000 pixels from a 53 byte file; export the picture again$"),
        (8_888_888, 4, 100, "header claims 35555552 pixels from a 100 byte file"),
        (10**18 - 1, 10**18 - 1, 100, "pixels from a 100 byte file"),
        (2**12, 2**11 + 1, 100, "header claims 8392704 pixels from a 100 byte file"),
        (2**12, 2**12, 209_715, "header claims 16777216 pixels from a 209715 byte file"),
        (2**13, 2**14 + 1, 2**23, r"has 16385 x 8192 pixels; at most 134217728 are allowed \(limit light_pixels\)$"),
        (2**15 + 1, 1, 100, r"has a side of 32769 pixels; at most 32768 are allowed \(limit light_side\)$"),
    ],
)
def test_guards(read, height, width, size, message):
    start = file(b"", height, width)
    began = time.process_time()
    with pytest.raises(LimitError, match=message):
        read(start.ljust(size, b"\0"))
    assert time.process_time() - began < 2


@pytest.mark.parametrize(
    ("limit", "most", "message"),
    [
        ("light_side", 9, "has a side of 9 pixels"),
        ("light_pixels", 27, "has 9 x 3 pixels"),
        ("file_bytes", 153, "has 153 bytes"),
    ],
)
def test_each_limit_is_the_last_size_that_is_read(read, limit, most, message):
    data = file(flat(noise(3, 9)), 3, 9)
    assert read(data, Limits(**{limit: most})).shape == (3, 9, 3)
    with pytest.raises(LimitError, match=rf"sky\.hdr: {message}; at most {most - 1} are allowed \(limit {limit}\)$"):
        read(data, Limits(**{limit: most - 1}))


@pytest.mark.parametrize("exposure", ["", "EXPOSURE=3\n"])
def test_the_largest_flat_picture_takes_two_seconds_and_512_megabytes(tmp_path, exposure):
    """Its codes count as 64 MiB; any file may claim as many."""
    pixels = bytes((130, 130, 130, 130, 1, 1, 1, 4095 & 255, 1, 1, 1, 4095 >> 8)) * 2**11
    (tmp_path / "a.hdr").write_bytes(file(pixels, 2**11, 2**12, f"#?RADIANCE\n{exposure}\n".encode()))
    with watched(tmp_path):
        light, _ = read_light(tmp_path / "a.hdr")
    assert light.shape == (2**11, 2**12, 3)
    assert (light == np.float32(radiance(np.full(4, 130)) / (3 if exposure else 1))).all()


def test_a_larger_file_may_claim_640_bytes_for_each_of_its_own(read):
    """One byte less, and it is refused; so is not this one, which is cut off."""
    with pytest.raises(InputError, match="scanline 13 of 4096: is cut off"):
        read(file(b"", 2**12, 2**12).ljust(209_716, b"\0"))


def test_the_size_claimed_may_be_what_run_lengths_reach(read):
    """A picture of one colour is the smallest file of its size, and no bomb."""
    codes = np.full((1500, 4000, 4), 130, np.uint8)
    light = read(file(newer(codes[:1]) * 1500, 1500, 4000))
    assert light.shape == (1500, 4000, 3)
    assert (light == radiance(codes[0, 0])).all()


def test_a_real_panorama(assets):
    path = assets / "environments" / "spiaggia_di_mondello_1k.hdr"
    if not path.is_file():
        pytest.skip(f"no {path}")
    seconds = []
    for _ in range(3):
        began = time.process_time()
        light = read_hdr(path)
        seconds.append(time.process_time() - began)
    assert light.shape == (512, 1024, 3)
    assert light.max() == 72704  # 142 * 512, which a reader that adds half a step has as 72960
    assert 0 < light.min() < 0.01
    assert min(seconds) < 0.5


EXACT = {
    "zero": (0.0, (0, 0, 0, 0)),
    "one": (1.0, (128, 128, 128, 129)),
    "largest": (LARGEST, (255, 255, 255, 255)),
    "smallest": (2.0**-128, (128, 128, 128, 1)),
    "below the smallest": (2.0**-128 * (1 - 2.0**-8), (0, 0, 0, 0)),
    "1e38": (1e38, (150, 150, 150, 255)),
    "1e-38": (1e-38, (218, 218, 218, 2)),
    "rounds up to the next exponent": (1 - 2.0**-10, (128, 128, 128, 129)),
    "does not yet": (1 - 3 * 2.0**-10, (255, 255, 255, 128)),
    "the last float below one": (1 - 2.0**-24, (128, 128, 128, 129)),
    "a half rounds to even": (129.5 / 128, (130, 130, 130, 129)),
    "a half rounds to even, down": (130.5 / 128, (130, 130, 130, 129)),
}


@pytest.mark.parametrize("name", EXACT)
def test_codes_of_values(tmp_path, name):
    value, codes = EXACT[name]
    write_hdr(tmp_path / "a.hdr", np.full((1, 2, 3), value))
    assert (tmp_path / "a.hdr").read_bytes().endswith(b"-Y 1 +X 2\n" + bytes(codes) * 2)


def test_the_smaller_channels_share_the_exponent(tmp_path):
    write_hdr(tmp_path / "a.hdr", np.array([[[1.0, 0.25, 2.0**-9], [0.0, 3e-38, 1e38]]]))
    assert (tmp_path / "a.hdr").read_bytes()[-8:] == bytes((128, 32, 0, 129, 0, 0, 150, 255))


@pytest.mark.parametrize("width", [1, 7, 8, 9, 127, 128, 129, 131, 300, 2**15 - 1, 2**15])
def test_exact_values_survive(tmp_path, width):
    """Whatever the format can hold comes back bit by bit, in runs and literals of every length."""
    codes = noise(3, width, seed=width)
    codes[..., 3] |= 1
    if width > 8:
        codes[1, :, :] = codes[1, :1, :]
        codes[2, : width // 2] = codes[2, 0]
    light = radiance(codes).astype(np.float32)
    write_hdr(tmp_path / "a.hdr", light)
    np.testing.assert_array_equal(read_hdr(tmp_path / "a.hdr"), light)
    data = (tmp_path / "a.hdr").read_bytes()
    pixels = data[data.index(b"\n", data.index(b"-Y")) + 1 :]
    assert data.startswith(b"#?RADIANCE\n")
    assert (pixels[:4] == b"\2\2" + width.to_bytes(2, "big")) == (8 <= width < 2**15)
    assert len(pixels) <= 3 * (4 + 4 * (width + (width + 127) // 128))


def test_one_colour_takes_two_bytes_a_run(tmp_path):
    write_hdr(tmp_path / "a.hdr", np.ones((2, 1024, 3)))
    size = len((tmp_path / "a.hdr").read_bytes())
    assert size - len(b"#?RADIANCE\nSOFTWARE=jaxraster\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 1024\n") == 2 * (
        4 + 4 * 2 * 9
    )


def test_error_is_at_most_a_256th_of_the_largest_channel(tmp_path):
    """Over all magnitudes, and for channels that differ by up to 40 powers of two."""
    random = np.random.default_rng(0)
    largest = np.exp2(random.uniform(-126, np.log2(LARGEST), (100, 200, 1)))
    light = np.minimum(largest * np.exp2(random.uniform(-40, 0, (100, 200, 3))), LARGEST).astype(np.float32)
    light[..., 1:2] = largest
    write_hdr(tmp_path / "a.hdr", light)
    again = read_hdr(tmp_path / "a.hdr")
    assert (np.abs(again.astype(np.float64) - light).max(axis=-1) <= light.max(axis=-1).astype(np.float64) / 256).all()
    write_hdr(tmp_path / "a.hdr", again)
    np.testing.assert_array_equal(read_hdr(tmp_path / "a.hdr"), again)


def test_the_bound_on_the_error_is_nearly_reached(tmp_path):
    light = np.full((1, 1, 3), 1 + 0.499 / 128)
    write_hdr(tmp_path / "a.hdr", light)
    assert np.abs(read_hdr(tmp_path / "a.hdr") - light).max() > light.max() * 0.99 / 256


@pytest.mark.parametrize(
    ("light", "kind", "message"),
    [
        ([[[np.nan, 1, 2], [np.nan, 1, 2]]], ValueError, r"^light: of 6 values 2 NaN; mask them"),
        ([[[np.inf, 1, 2]]], ValueError, r"of 3 values 1 above 1\.69e\+38; mask"),
        ([[[-np.inf, -1e-30, 2]]], ValueError, "of 3 values 2 negative; mask"),
        ([[[np.nan, -1, 1.7e38], [1e300, 0, 0]]], ValueError, r"of 6 values 1 NaN, 1 negative, 2 above 1\.69e\+38"),
        ([[1.0, 2.0, 3.0]], ValueError, r"expected \[h, w, 3\], got shape \[1, 3\]"),
        ([[[1.0, 2.0, 3.0, 4.0]]], ValueError, r"got shape \[1, 1, 4\]"),
        (np.zeros((0, 5, 3)), ValueError, r"got shape \[0, 5, 3\]"),
        (np.zeros((1, 1, 3), np.uint8), TypeError, "expected linear floats, got uint8"),
        (np.zeros((1, 1, 3), bool), TypeError, "expected linear floats, got bool"),
    ],
)
def test_unwritable_light(tmp_path, light, kind, message):
    (tmp_path / "a.hdr").write_bytes(b"old")
    with pytest.raises(kind, match=message):
        write_hdr(tmp_path / "a.hdr", np.asarray(light))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.hdr": b"old"}


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16, jnp.float32])
def test_arrays_of_any_precision_are_written(tmp_path, dtype):
    save(tmp_path / "a.HDR", jnp.full((2, 9, 3), 1.5, dtype))
    assert (read_hdr(tmp_path / "a.HDR") == 1.5).all()


def test_a_failing_disk_keeps_the_old_picture(tmp_path, monkeypatch):
    (tmp_path / "a.hdr").write_bytes(b"old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OutputError, match=r"a\.hdr: cannot be written: No space left"):
        write_hdr(tmp_path / "a.hdr", np.ones((2, 2, 3)))
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.hdr": b"old"}


def test_read_light_of_a_good_file_has_no_notes(tmp_path):
    for name in ("a.hdr", "a.PIC"):
        write_hdr(tmp_path / name, np.full((2, 3, 3), 0.5))
        light, notes = read_light(tmp_path / name)
        assert (light == 0.5).all()
        assert light.shape == (2, 3, 3)
        assert light.dtype == np.float32
        assert notes == ()
    write_hdr(tmp_path / "a.hdr", np.zeros((2, 3, 3)))
    assert read_light(tmp_path / "a.hdr")[1] == ("it is black all over",)


def test_read_light_refuses_other_files(tmp_path):
    for name, message in {"a.png": "unknown format of light '.png'; known are .hdr", "b.hdr": "No such file"}.items():
        with pytest.raises(InputError, match=message):
            read_light(tmp_path / name)


def outcome(read, data: bytes) -> str:
    """Whether light came of a file, or one typed error."""
    began = time.process_time()
    try:
        light = read(data)
    except Error as error:
        assert "sky.hdr: " in str(error)
        assert "\n" not in str(error)
        return "refused"
    finally:
        assert time.process_time() - began < SOON
    assert light.dtype == np.float32
    assert light.shape[2:] == (3,)
    assert np.isfinite(light).all()
    assert (light >= 0).all()
    return "read"


LINES = [b"#?RADIANCE", b"EXPOSURE=2", b"COLORCORR=1 2 4", b"FORMAT=32-bit_rle_rgbe", b"", b"-Y 6 +X 40"]


def test_a_file_cut_off_anywhere_is_refused(read):
    data = file(newer(noise(6, 40)), 6, 40)
    with watched(read.folder):
        assert {outcome(read, data[:end]) for end in range(0, len(data), 4)} == {"refused"}
        assert outcome(read, data) == "read"


def test_header_lines_in_any_order_give_light_or_one_typed_error(read):
    """All that stands before the empty line may stand in any order, but for the first."""
    outcomes = {}
    with watched(read.folder):
        for one, other in itertools.combinations(range(len(LINES)), 2):
            lines = [*LINES]
            lines[one], lines[other] = lines[other], lines[one]
            outcomes[one, other] = outcome(read, b"\n".join(lines) + b"\n" + newer(noise(6, 40)))
    assert {swap for swap, found in outcomes.items() if found == "read"} == {(1, 2), (1, 3), (2, 3)}


VALID = [file(newer(noise(6, 40)), 6, 40), file(older(noise(6, 40)), 6, 40), file(flat(noise(6, 5)), 6, 5)]


@settings(max_examples=500, deadline=None, derandomize=True)
@given(st.sampled_from(VALID), st.lists(st.tuples(st.integers(0, 2**16), st.integers(1, 255)), max_size=4), st.data())
def test_damage_gives_light_or_one_typed_error(read, data, flips, draw):
    broken = bytearray(data)
    for place, bits in flips:
        broken[place % len(broken)] ^= bits
    broken = bytes(broken[: draw.draw(st.integers(0, len(broken)) | st.just(len(broken)))])
    outcome(read, broken)
