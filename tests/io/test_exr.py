"""EXR pictures: channels by name without loss, what counts as light in them, and one error for any damage."""

import io
import os
import struct
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from watch import SOON, watched

from jaxraster.errors import Error, InputError, LimitError, OutputError
from jaxraster.io.exr import read_exr, read_exr_light, write_exr
from jaxraster.io.light import read_light
from jaxraster.io.load import save
from jaxraster.io.reading import Limits

OpenEXR = pytest.importorskip("OpenEXR")
RANDOM = np.random.default_rng(0)


def values(height: int, width: int) -> np.ndarray:
    return RANDOM.random((height, width)).astype(np.float32)


def encoded(channels: dict, **header) -> bytes:
    """A file made by the package itself, with any header."""
    stream = io.BytesIO()
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, **header}, channels).write(stream)
    return stream.getvalue()


def test_channels_survive_bit_by_bit(tmp_path):
    single, half = values(5, 7), values(5, 7).astype(np.float16)
    single.ravel()[:5] = np.nan, np.inf, -np.inf, -0.0, 1e-45
    half.ravel()[:3] = np.nan, -np.inf, 6e-8
    channels = {
        "R": single,
        "G": half,
        "depth.Z": np.asfortranarray(values(5, 7)),
        "normal.X": values(10, 14)[::2, ::2],
        "normal.Y": values(7, 5).T,
        "normal.Z": -values(5, 7),
        "face": np.arange(35, dtype=np.uint32).reshape(5, 7) - np.uint32(1),
        "big endian": values(5, 7).astype(">f4"),
        "n" * 255: values(5, 7),
    }
    write_exr(tmp_path / "a.exr", channels)
    again = read_exr(tmp_path / "a.exr")
    assert again.keys() == channels.keys()
    for name, stored in channels.items():
        assert again[name].dtype == stored.dtype.newbyteorder("="), name
        assert again[name].tobytes() == np.ascontiguousarray(stored, again[name].dtype).tobytes(), name
    first = (tmp_path / "a.exr").read_bytes()
    write_exr(tmp_path / "a.exr", channels)
    assert (tmp_path / "a.exr").read_bytes() == first


def test_other_floats_become_single(tmp_path):
    write_exr(tmp_path / "a.exr", {"R": np.full((1, 1), 0.1), "G": jnp.full((1, 1), 0.1, jnp.bfloat16)})
    again = read_exr(tmp_path / "a.exr")
    assert {name: pixels.dtype for name, pixels in again.items()} == {"R": np.float32, "G": np.float32}
    assert again["R"][0, 0] == np.float32(0.1)
    assert again["G"][0, 0] == np.float32(0.10009765625)


PLANE = np.zeros((2, 3), np.float32)


@pytest.mark.parametrize(
    ("channels", "kind", "message"),
    [
        ({}, ValueError, r"^channels: expected at least one, all of one size, got the sizes \[\]"),
        ({"R": PLANE, "G": PLANE.T}, ValueError, r"got the sizes \[\(2, 3\), \(3, 2\)\]"),
        ({"R": PLANE[0]}, ValueError, r"expected \[h, w\] for 'R', got shape \[3\]"),
        ({"R": PLANE[:0]}, ValueError, r"got shape \[0, 3\]"),
        ({"": PLANE}, ValueError, "expected names of 1 to 255 printable characters, got ''"),
        ({"a\n": PLANE}, ValueError, r"got 'a\\n'"),
        ({"n" * 256: PLANE}, ValueError, "got 'nnn"),
        ({"face": PLANE.astype(np.int32)}, TypeError, "expected floats or uint32 for 'face', got int32"),
        ({"mask": PLANE.astype(bool)}, TypeError, "for 'mask', got bool"),
    ],
)
def test_unwritable_channels(tmp_path, channels, kind, message):
    (tmp_path / "a.exr").write_bytes(b"old")
    with pytest.raises(kind, match=message):
        write_exr(tmp_path / "a.exr", channels)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.exr": b"old"}


def test_a_failing_disk_keeps_the_old_picture(tmp_path, monkeypatch):
    (tmp_path / "a.exr").write_bytes(b"old")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OutputError, match=r"a\.exr: cannot be written: No space left"):
        write_exr(tmp_path / "a.exr", {"R": PLANE})
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.exr": b"old"}


def test_save_names_the_channels(tmp_path):
    image = np.stack([values(4, 6) for _ in range(4)], axis=-1)
    save(tmp_path / "rgba.exr", jnp.asarray(image))
    save(tmp_path / "rgb.EXR", image[..., :3])
    assert sorted(read_exr(tmp_path / "rgba.exr")) == ["A", "B", "G", "R"]
    for name in ("rgba.exr", "rgb.EXR"):
        light, notes = read_light(tmp_path / name)
        np.testing.assert_array_equal(light, image[..., :3])
        assert notes == ()
    with pytest.raises(ValueError, match=r"got shape \[4, 6, 2\]"):
        save(tmp_path / "a.exr", image[..., :2])


def test_without_the_package(tmp_path, monkeypatch):
    write_exr(tmp_path / "a.exr", {"Y": PLANE})
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    message = r"\.exr: EXR needs the package OpenEXR; pip install OpenEXR$"
    with pytest.raises(InputError, match=message):
        read_light(tmp_path / "a.exr")
    with pytest.raises(OutputError, match=message):
        write_exr(tmp_path / "b.exr", {"Y": PLANE})
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


R, G, B, Y = (values(6, 5) for _ in range(4))
HALF = G.astype(np.float16)
RGB = np.stack([R, G, B], axis=-1)
ACES = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
PRIMARIES = "its primaries are not those of Rec. 709; its colours are taken as if they were"
LIGHTS = {
    "R, G, B": ({"R": R, "G": G, "B": B}, {}, RGB, ()),
    "halves": ({"R": R, "G": HALF, "B": B, "A": R}, {}, np.stack([R, HALF, B], axis=-1).astype(np.float32), ()),
    "luminance": ({"Y": Y}, {}, np.stack([Y, Y, Y], axis=-1), ()),
    "luminance and alpha": ({"A": R, "Y": Y}, {}, np.stack([Y, Y, Y], axis=-1), ()),
    "colour before luminance": ({"R": R, "G": G, "B": B, "Y": Y}, {}, RGB, ()),
    "one layer": ({"v.R": R, "v.G": G, "v.B": B, "depth.Z": Y, "u.R": Y}, {}, RGB, ()),
    "no layer before any": ({"R": R, "G": G, "B": B, "v.R": Y, "v.G": Y, "v.B": Y}, {}, RGB, ()),
    "tiles": ({"R": R, "G": G, "B": B}, {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}, RGB, ()),
    "from the bottom": ({"R": R, "G": G, "B": B}, {"lineOrder": OpenEXR.DECREASING_Y}, RGB, ()),
    "other primaries": ({"R": R, "G": G, "B": B}, {"chromaticities": ACES}, RGB, (PRIMARIES,)),
    "Rec. 709": ({"R": R, "G": G, "B": B}, {"chromaticities": REC_709}, RGB, ()),
    "uncompressed": ({"R": R, "G": G, "B": B}, {"compression": OpenEXR.NO_COMPRESSION}, RGB, ()),
    "wavelets": ({"R": R, "G": G, "B": B}, {"compression": OpenEXR.PIZ_COMPRESSION}, RGB, ()),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_what_is_light(tmp_path, name):
    channels, header, expected, expected_notes = LIGHTS[name]
    (tmp_path / "a.exr").write_bytes(encoded(channels, **header))
    light, notes = read_light(tmp_path / "a.exr")
    assert light.dtype == np.float32
    np.testing.assert_array_equal(light, expected)
    assert notes == expected_notes


def window(left: int, top: int, width: int, height: int) -> tuple:
    return (left, top), (left + width - 1, top + height - 1)


@pytest.mark.parametrize(
    ("stored", "shown", "expected"),
    [
        (window(0, 0, 3, 2), window(0, 0, 3, 2), [[1, 2, 3], [4, 5, 6]]),
        (window(-7, 90, 3, 2), window(-7, 90, 3, 2), [[1, 2, 3], [4, 5, 6]]),
        (window(1, 1, 3, 2), window(0, 0, 5, 4), [[0, 0, 0, 0, 0], [0, 1, 2, 3, 0], [0, 4, 5, 6, 0], [0, 0, 0, 0, 0]]),
        (window(-1, -1, 3, 2), window(0, 0, 2, 1), [[5, 6]]),
        (window(0, 0, 3, 2), window(2, 1, 2, 2), [[6, 0], [0, 0]]),
        (window(0, 0, 3, 2), window(50, 0, 2, 1), [[0, 0]]),
    ],
)
def test_the_display_window_is_what_is_seen(tmp_path, stored, shown, expected):
    pixels = np.arange(1, 7, dtype=np.float32).reshape(2, 3)
    (tmp_path / "a.exr").write_bytes(encoded({"Y": pixels}, dataWindow=stored, displayWindow=shown))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")["Y"], expected)


def test_of_many_parts_the_first_is_read(tmp_path):
    parts = [OpenEXR.Part({}, {"Y": Y + i}, f"part {i}") for i in range(3)]
    stream = io.BytesIO()
    OpenEXR.File(parts).write(stream)
    (tmp_path / "a.exr").write_bytes(stream.getvalue())
    light, notes = read_light(tmp_path / "a.exr")
    np.testing.assert_array_equal(light[..., 1], Y)
    assert notes == ("2 further parts are ignored",)


def test_texels_that_are_no_light_are_repaired_and_counted(tmp_path):
    red = np.array([[np.nan, np.inf, -1, 2e18, 1]], np.float32)
    other = np.array([[1, 1, 1, 3e18, -np.inf]], np.float32)
    write_exr(tmp_path / "a.exr", {"R": red, "G": other, "B": np.ones_like(red)})
    light, notes = read_light(tmp_path / "a.exr")
    top = np.float32(1.844e18)
    np.testing.assert_array_equal(light[0], np.array([[0, 0, 0], [0, 0, 0], [0, 1, 1], [top, top, 1], [0, 0, 0]]))
    assert notes == (
        "3 of 5 texels are not finite; they become black",
        "1 of 5 texels are negative; they become 0",
        "1 of 5 texels are above 1.844e+18; they become that",
    )


def claiming(width: int, height: int, *windows: str) -> bytes:
    """A file of 4 x 4 pixels, of which the header states any size."""
    data = encoded({"R": values(4, 4)})
    for name in windows:
        start = data.index(name.encode() + b"\0box2i\0") + len(name) + 11
        data = data[:start] + struct.pack("<4i", 0, 0, width - 1, height - 1) + data[start + 16 :]
    return data


def tall_tile() -> bytes:
    """A picture of 4 x 4 pixels in a tile of 32 x 14,000,000, which a decoder would make room for."""
    data = encoded({"R": values(4, 4)}, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription())
    start = data.index(b"tiles\0tiledesc\0") + 19
    return data[:start] + struct.pack("<II", 32, 14_000_000) + data[start + 8 :]


def many(num_parts: int, num_channels: int) -> bytes:
    """Parts of 1024 x 1024 black pixels."""
    planes = {f"c{i}": np.zeros((1024, 1024), np.float16) for i in range(num_channels)}
    stream = io.BytesIO()
    OpenEXR.File([OpenEXR.Part({}, planes, f"part {i}") for i in range(num_parts)]).write(stream)
    return stream.getvalue()


BOTH = ("dataWindow", "displayWindow")
LIMITS = {
    "40000 x 40000": (
        claiming(40_000, 40_000, *BOTH),
        r"header claims 1600000000 pixels from a \d{3} byte file; export",
    ),
    "data alone": (claiming(40_000, 40_000, "dataWindow"), "header claims 1600000000 pixels"),
    "display alone": (claiming(40_000, 40_000, "displayWindow"), "header claims 1600000000 pixels"),
    "long": (
        claiming(2**15 + 1, 4, "displayWindow"),
        r"has a side of 32769 pixels; at most 32768 are allowed \(limit light_side\)$",
    ),
    "tile": (tall_tile(), r"header claims 448000000 pixels"),
    "parts": (many(9, 1), r"header claims 1048576 pixels from a \d+ byte file; export"),
    "channels": (many(1, 33), r"header claims 1048576 pixels from a \d+ byte file; export"),
}


@pytest.mark.parametrize("compression", [OpenEXR.ZIP_COMPRESSION, OpenEXR.DWAA_COMPRESSION])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_the_largest_flat_picture_takes_two_seconds_and_512_megabytes(tmp_path, dtype, compression):
    """Its codes are 64 MiB; any file may claim as many."""
    planes = {c: np.ones((2**12, 2**11), dtype) for c in "RGBA"}
    (tmp_path / "a.exr").write_bytes(encoded(planes, compression=compression))
    del planes
    with watched(tmp_path):
        light, _ = read_light(tmp_path / "a.exr")
    assert (light == 1).all()
    assert light.shape == (2**12, 2**11, 3)


@pytest.mark.parametrize("name", LIMITS)
def test_guards(tmp_path, name):
    data, message = LIMITS[name]
    (tmp_path / "a.exr").write_bytes(data)
    began = time.process_time()
    with pytest.raises(LimitError, match=rf"a\.exr: {message}"):
        read_exr(tmp_path / "a.exr")
    assert time.process_time() - began < 2


@pytest.mark.parametrize(
    ("limit", "most", "message"),
    [
        ("light_side", 6, "has a side of 6 pixels"),
        ("light_pixels", 30, "has 5 x 6 pixels"),
        ("file_bytes", None, r"has \d+ bytes"),
    ],
)
def test_each_limit_is_the_last_size_that_is_read(tmp_path, limit, most, message):
    (tmp_path / "a.exr").write_bytes(encoded({"Y": Y}))
    most = most or (tmp_path / "a.exr").stat().st_size
    for read in (read_exr, read_exr_light):
        read(tmp_path / "a.exr", Limits(**{limit: most}))
        with pytest.raises(LimitError, match=rf"a\.exr: {message}; at most {most - 1} are allowed \(limit {limit}\)$"):
            read(tmp_path / "a.exr", Limits(**{limit: most - 1}))


def deep() -> bytes:
    """One sample in each of two pixels."""
    samples = np.empty((1, 2), object)
    samples[0, 0], samples[0, 1] = np.ones(1, np.float32), np.ones(1, np.float32)
    return encoded({"Z": samples}, type=OpenEXR.deepscanline, compression=OpenEXR.ZIPS_COMPRESSION)


def subsampled() -> bytes:
    """A channel whose header says that only every second row and column is stored."""
    data = encoded({"Y": values(4, 4), "RY": values(4, 4)})
    start = data.index(b"RY\0") + 3 + 8
    return data[:start] + struct.pack("<II", 2, 2) + data[start + 8 :]


GOOD = encoded({"R": values(32, 32), "G": values(32, 32), "B": values(32, 32)})
SMOOTH = encoded({"Y": np.linspace(0, 1, 1024, dtype=np.float32).reshape(32, 32)})
BROKEN = {
    "nothing": (b"", "is empty"),
    "junk": (b"junk" * 20, "is not an OpenEXR picture"),
    "magic alone": (GOOD[:4], "is broken: Unable to open"),
    "cut off in the header": (GOOD[:100], "is broken: Unable to open"),
    "cut off in the pixels": (GOOD[:-10], "is broken: Unable to query scanline information; export the picture again"),
    "cut off half way": (GOOD[: len(GOOD) // 2], "is broken: "),
    "damaged pixels": (SMOOTH[:-9] + bytes(8) + SMOOTH[-1:], "is broken: "),
    "deep": (deep(), "holds deep pixels, which are not supported; flatten"),
    "subsampled": (subsampled(), "'RY': is stored at a lower resolution, which is not supported"),
    "no colour": (encoded({"Z": R}), "needs channels R, G and B, or Y, or one layer with these; it has 'Z'"),
    "two layers": (
        encoded({f"{layer}.{c}": R for layer in "ab" for c in "RGB"}),
        ".* it has 'a.B', 'a.G', 'a.R', 'b.B'",
    ),
    "chroma": (encoded({"Y": Y, "RY": Y, "BY": Y}), "stores luminance and chroma, which is not supported; export RGB"),
    "integers": (encoded({"Y": np.ones((2, 2), np.uint32)}), "'Y': holds integers, not light; export floats"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_no_light_is_refused(tmp_path, name, capfd):
    data, message = BROKEN[name]
    (tmp_path / "a.exr").write_bytes(data)
    with pytest.raises(InputError, match=rf"a\.exr: {message}") as caught:
        read_light(tmp_path / "a.exr")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_only_while_a_file_is_read_nothing_is_printed(tmp_path, capfd):
    (tmp_path / "a.exr").write_bytes(GOOD[: len(GOOD) // 2])
    for _ in range(3):
        with pytest.raises(InputError):
            read_exr(tmp_path / "a.exr")
    open_files = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else None
    with pytest.raises(InputError):
        read_exr(tmp_path / "a.exr")
    assert open_files is None or open_files == len(os.listdir("/proc/self/fd"))
    print("out")
    os.write(2, b"error")
    assert capfd.readouterr() == ("out\n", "error")


def test_without_an_error_stream_files_are_read(tmp_path):
    (tmp_path / "a.exr").write_bytes(GOOD)
    kept = os.dup(2)
    os.close(2)
    try:
        channels = read_exr(tmp_path / "a.exr")
    finally:
        os.dup2(kept, 2)
        os.close(kept)
    assert sorted(channels) == ["B", "G", "R"]


def test_threads_that_read_at_once_leave_the_streams_as_they_were(tmp_path, capfd):
    (tmp_path / "a.exr").write_bytes(GOOD)
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(lambda _: read_exr(tmp_path / "a.exr"), range(64)))
    print("out")
    os.write(2, b"error")
    assert capfd.readouterr() == ("out\n", "error")


VALID = [GOOD, encoded({"R": R, "G": HALF, "B": B}, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription())]


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    st.sampled_from(VALID),
    st.lists(st.tuples(st.integers(0, 700) | st.integers(0, 2**16), st.integers(1, 255)), max_size=4),
    st.data(),
)
def test_damage_gives_light_or_one_typed_error(tmp_path_factory, data, flips, draw):
    broken = bytearray(data)
    for place, bits in flips:
        broken[place % len(broken)] ^= bits
    path = tmp_path_factory.getbasetemp() / "damaged.exr"
    path.write_bytes(broken[: draw.draw(st.integers(1, len(broken)) | st.just(len(broken)))])
    began = time.process_time()
    try:
        light, _ = read_light(path)
    except Error as error:
        assert str(error).startswith(f"{path}: ")
        assert "\n" not in str(error)
    else:
        assert light.dtype == np.float32
        assert light.shape[2:] == (3,)
        assert np.isfinite(light).all()
        assert (light >= 0).all()
    assert time.process_time() - began < SOON
