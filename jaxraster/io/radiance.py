"""Radiance pictures (.hdr, .pic): linear light of three 8-bit mantissas with one exponent, run-length encoded.

A channel is m 2^(e - 136), and 0 where e is 0. Radiance itself decodes (m + 1/2) 2^(e - 136); we decode without the
half, as OpenCV and most programs do, and so round to the nearest m where Radiance rounds down.

Source: Ward, "Real Pixels", Graphics Gems II, 1991; "Radiance File Formats" (filefmts.pdf of Radiance 5).
"""

import os
import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from ..errors import InputError
from .disk import Path, read_file, write_file
from .png import AGAIN, check_size
from .reading import DEFAULT, Limits

MOST_HEADER = 2**16  # bytes
LARGEST = 255 * 2.0**119  # the largest value that the format holds


class _Header(NamedTuple):
    """`divisor` turns what is stored into radiance; `axes` names the scanlines' order, then the pixels' in them."""

    divisor: Float[np.ndarray, "3"]
    axes: tuple[str, str]
    sizes: tuple[int, int]
    pixels_at: int


def _factors(value: str, count: int, line: str, name: str) -> Float[np.ndarray, " n"]:
    """The positive numbers of an EXPOSURE or COLORCORR line."""
    try:
        factors = np.array([float(word) for word in value.split()])
    except ValueError:
        factors = np.zeros(0)
    if len(factors) != count or not (np.isfinite(factors) & (factors > 0)).all():
        raise InputError(name, "header", f"{line[:40]!r} is not {count} positive number{'s'[: count - 1]}{AGAIN}")
    return factors


def _read_header(data: bytes, name: str, limits: Limits) -> _Header:
    """The header up to the pixels; only sizes that may be decoded pass."""
    if not data.startswith(b"#?"):
        raise InputError(name, "", f"is not a Radiance picture: it begins with {data[:10]!r}, not '#?RADIANCE'")
    end = re.compile(rb"\n\r?\n").search(data, 0, MOST_HEADER)
    if end is None:
        raise InputError(name, "header", f"has no empty line at its end{AGAIN}")
    factors = [np.ones(3)]
    # Take lines from their start only: indented ones tell of pictures that this one was made from.
    for line in data[: end.start()].decode("latin-1").split("\n")[1:]:
        key, _, value = line.rstrip("\r").partition("=")
        if key == "EXPOSURE":
            factors.append(_factors(value, 1, line, name))
        elif key == "COLORCORR":
            factors.append(_factors(value, 3, line, name))
        elif key == "FORMAT" and value.strip() == "32-bit_rle_xyze":
            raise InputError(name, "header", "its colours are CIE XYZ, which is not supported; convert it to RGB")
        elif key == "FORMAT" and value.strip() != "32-bit_rle_rgbe":
            raise InputError(name, "header", f"unknown format {value.strip()[:40]!r}; known is 32-bit_rle_rgbe")
    with np.errstate(over="ignore"):
        divisor = np.prod(np.broadcast_arrays(*factors), axis=0)
    if not (np.isfinite(divisor) & (divisor > 0)).all():
        raise InputError(name, "header", f"its exposures multiply to {divisor}{AGAIN}")

    found = re.compile(rb"([+-][XY]) +(\d{1,18}) +([+-][XY]) +(\d{1,18}) *\r?\n").match(data, end.end())
    if found is None or found[1][1:] == found[3][1:] or not int(found[2]) or not int(found[4]):
        line = data[end.end() : end.end() + 40].split(b"\n")[0].decode("latin-1")
        raise InputError(name, "header", f"{line!r} is not a resolution such as '-Y 512 +X 1024'{AGAIN}")
    count, width = int(found[2]), int(found[4])
    # Count eight bytes a pixel, four of codes and a third of twelve of light: more than older run lengths are free.
    check_size(width, count, len(data), name, limits, each=8, kind="light")
    return _Header(divisor, (found[1].decode(), found[3].decode()), (count, width), found.end())


def _new_scanline(data: bytes, at: int, width: int) -> tuple[bytes, int]:
    """The four planes of a scanline, each in runs (128 + n, value) and literals (n, value...), and where it ends."""
    line = bytearray()
    for end in (width, 2 * width, 3 * width, 4 * width):
        while len(line) < end:
            code = data[at]
            if code > 128:
                line += data[at + 1 : at + 2] * (code - 128)
                at += 2
            elif code:
                line += data[at + 1 : at + 1 + code]
                at += 1 + code
            else:
                raise ValueError("has an empty run")
        if len(line) > end:
            raise ValueError(f"has a run that ends {len(line) - end} pixels beyond its {width}")
    if at > len(data):
        raise IndexError
    return bytes(line), at


def _old_scanline(data: bytes, at: int, width: int) -> tuple[UInt8[np.ndarray, "w 4"], int]:
    """The pixels of a flat or older scanline, and where it ends.

    There (1, 1, 1, n) repeats the pixel before n times, and the k-th such in a row n 256^k times.
    """
    stored = np.frombuffer(data[at : at + min(width, (len(data) - at) // 4) * 4], np.uint8).reshape(-1, 4)
    index, is_run = np.arange(len(stored)), (stored[:, :3] == 1).all(axis=1)
    if is_run[:1].any():
        raise ValueError("begins with a run, which has nothing to repeat")
    source = np.maximum.accumulate(np.where(is_run, -1, index))
    # Bound the power: from the fifth run on, anything but nothing is too long.
    power = np.minimum(index - source - 1, 4)
    total = np.cumsum(np.where(is_run, stored[:, 3].astype(np.int64) << 8 * np.maximum(power, 0), 1))
    stop = int(np.searchsorted(total, width))
    if stop == len(stored):
        raise IndexError
    if total[stop] > width:
        raise ValueError(f"has a run that ends {total[stop] - width} pixels beyond its {width}")
    repeats = np.diff(total[: stop + 1], prepend=0)
    return np.repeat(stored[source[: stop + 1]], repeats, axis=0), at + 4 * (stop + 1)


def _scanlines(data: bytes, at: int, count: int, width: int, name: str) -> UInt8[np.ndarray, "count width 4"]:
    """All scanlines as they are stored."""
    may_be_new = 8 <= width < 2**15
    if len(data) - at >= 4 * count * width:
        # Take a flat file as it is: no pixel of it looks like a run, and no scanline like a newer one.
        flat = np.frombuffer(data, np.uint8, 4 * count * width, at).reshape(count, width, 4)
        new = may_be_new & (flat[:, 0, :2] == 2).all(axis=-1) & (flat[:, 0, 2] < 128)
        if not new.any() and not (flat[..., :3] == 1).all(axis=-1).any():
            return flat

    codes = np.empty((count, width, 4), np.uint8)
    for row in range(count):
        head = data[at : at + 4]
        try:
            if may_be_new and head[:2] == b"\2\2" and head[2] < 128:
                if (stated := head[2] << 8 | head[3]) != width:
                    raise ValueError(f"states {stated} pixels, the header {width}")
                line, at = _new_scanline(data, at + 4, width)
                codes[row] = np.frombuffer(line, np.uint8).reshape(4, width).T
            else:
                codes[row], at = _old_scanline(data, at, width)
        except IndexError:
            raise InputError(name, f"scanline {row + 1} of {count}", f"is cut off{AGAIN}") from None
        except ValueError as error:
            raise InputError(name, f"scanline {row + 1} of {count}", f"{error}{AGAIN}") from None
    return codes


def decode_hdr(data: bytes, name: str, limits: Limits = DEFAULT) -> Float[np.ndarray, "h w 3"]:
    """What `read_hdr` returns, from the bytes of a file; `name` is for errors."""
    header = _read_header(data, name, limits)
    codes = _scanlines(data, header.pixels_at, *header.sizes, name)
    if header.axes[0][1] == "X":
        codes = codes.swapaxes(0, 1)
    if "+Y" in header.axes:
        codes = codes[::-1]
    if "-X" in header.axes:
        codes = codes[:, ::-1]

    scale = np.ldexp(np.float32(1), np.arange(256) - 136)
    scale[0] = 0
    light = codes[..., :3] * scale[codes[..., 3:]]
    if (header.divisor != 1).any():
        # Let what an extreme exposure overflows be infinite; `read_light` counts it.
        with np.errstate(over="ignore"):
            np.divide(light, header.divisor, out=light, casting="same_kind")
    return light


def read_hdr(path: Path, limits: Limits = DEFAULT) -> Float[np.ndarray, "h w 3"]:
    """Linear radiance of a Radiance picture, row 0 on top whichever way its scanlines run.

    EXPOSURE and COLORCORR are divided out; primaries and the pixels' aspect are ignored. Bytes after the pixels are,
    too.
    """
    return decode_hdr(read_file(path, limits), os.fspath(path), limits)


def _codes(light: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 4"]:
    """Mantissas and exponents of light in [0, LARGEST]."""
    largest = light.max(axis=-1, keepdims=True)
    exponent = np.frexp(largest)[1]
    # Take the next exponent where the largest mantissa rounds up to 256.
    exponent += np.rint(np.ldexp(largest, 8 - exponent)) == 256
    rgbe = np.concatenate([np.rint(np.ldexp(light, 8 - exponent)), exponent + 128], axis=-1)
    return np.where((largest > 0) & (exponent > -128), rgbe, 0).astype(np.uint8)


def _runs(plane: UInt8[np.ndarray, " w"]) -> bytearray:
    """One plane of a scanline, where four or more equal values make a run."""
    coded, raw, at = bytearray(), plane.tobytes(), 0

    def literal(start: int, end: int) -> None:
        for first in range(start, end, 128):
            last = min(first + 128, end)
            coded.append(last - first)
            coded.extend(raw[first:last])

    bounds = np.flatnonzero(np.diff(plane, prepend=~plane[:1], append=~plane[-1:]))
    lengths = np.diff(bounds)
    for start, length in zip(bounds[:-1][lengths >= 4].tolist(), lengths[lengths >= 4].tolist()):
        literal(at, start)
        at = start + length
        for first in range(start, at, 127):
            coded += bytes((128 + min(127, at - first), raw[start]))
    literal(at, len(raw))
    return coded


def write_hdr(path: Path, light) -> None:
    """Write linear radiance `[h, w, 3]` as a Radiance picture, run-length encoded, in one step.

    A channel is off by at most 1/256 of its pixel's largest; a pixel below 2^-128 becomes black. Values that the
    format does not hold (NaN, infinite, negative, above 1.69e38) are a `ValueError` with their counts.
    """
    light = np.asarray(light)
    if light.ndim != 3 or light.shape[2] != 3 or 0 in light.shape:
        raise ValueError(f"light: expected [h, w, 3], got shape {list(light.shape)}")
    if light.dtype.kind in "iub":
        raise TypeError(f"light: expected linear floats, got {light.dtype}")
    with np.errstate(over="ignore"):
        light = light.astype(np.float32)
    counts = {"NaN": np.isnan(light), "negative": light < 0, f"above {LARGEST:.3g}": light > LARGEST}
    bad = [f"{mask.sum()} {what}" for what, mask in counts.items() if mask.any()]
    if bad:
        raise ValueError(f"light: of {light.size} values {', '.join(bad)}; mask them, or find out where they come from")

    height, width, _ = light.shape
    codes = _codes(light)
    parts = [f"#?RADIANCE\nSOFTWARE=jaxraster\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()]
    if 8 <= width < 2**15:
        for line in np.ascontiguousarray(codes.swapaxes(1, 2)):
            parts += [b"\2\2", width.to_bytes(2, "big"), *map(_runs, line)]
    else:
        parts.append(codes.tobytes())
    write_file(path, b"".join(parts))
