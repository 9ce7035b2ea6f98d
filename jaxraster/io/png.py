"""What Pillow leaves out of PNG: 16 bits of colour, transparent greys of 2 and 4 bits, and a guard against bombs,
which holds for the other formats, too.

Pillow unpacks 16-bit colour to 8 bits, and no other package required here reads it. Yet its decoder
can be asked for either byte of a sample, the first by "RGB;16B" and the second by "RGB;16L": two passes of it give
all bits, with its inflating, unfiltering and interlacing. Writing 16 bits takes no decoder, only zlib.

Source: W3C, "Portable Network Graphics (PNG) Specification (Third Edition)".
"""

import io
import struct
import zlib
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt16

from ..errors import InputError, LimitError
from .reading import Limits, exceed

MAGIC = b"\x89PNG\r\n\x1a\n"
# Bytes of codes that any file may claim. Of RGBA in 8 bits these are 4096 x 4096 pixels, which take 0.7 s and 450 MB to
# read, and which flat masks of that size, of 1 to 70 kB, need.
FREE_CODES = 2**26
MOST_RATIO = 640  # bytes of codes from a byte of file, beyond these: so 100 kB claim no more, and flat JPEG needs 256
AGAIN = "; export the picture again"
GREY, GREY_ALPHA = 0, 4
CHANNELS = {GREY: 1, 2: 3, 3: 1, GREY_ALPHA: 2, 6: 4}


class Header(NamedTuple):
    """What a PNG says of itself: bits a sample, and the kind of its pixels (0, 2, 3, 4 or 6)."""

    width: int
    height: int
    depth: int
    kind: int


def check_size(
    width: int, height: int, size: int, name: str, limits: Limits, *, each: int = 4, kind: str = "image"
) -> None:
    """Refuse a picture before it is decoded, whatever its format: one whose codes, of `each` bytes a pixel, are out of
    all proportion to its file's `size` in bytes, or one larger than the limits for its `kind`, image or light."""
    if each * width * height > max(FREE_CODES, MOST_RATIO * size):
        raise LimitError(name, "", f"header claims {width * height} pixels from a {size} byte file{AGAIN}")
    most_side, most_pixels = getattr(limits, f"{kind}_side"), getattr(limits, f"{kind}_pixels")
    if (side := max(width, height)) > most_side:
        exceed(f"{kind}_side", most_side, name, "", f"has a side of {side} pixels")
    if width * height > most_pixels:
        exceed(f"{kind}_pixels", most_pixels, name, "", f"has {width} x {height} pixels")


def read_header(data: bytes, name: str, limits: Limits) -> Header:
    """The header of a PNG whose size may be decoded."""
    if data[12:16] != b"IHDR" or len(data) < 26:
        raise InputError(name, "", f"is broken: its header is missing{AGAIN}")
    header = Header(*struct.unpack(">IIBB", data[16:26]))
    check_size(header.width, header.height, len(data), name, limits, each=8 if header.depth == 16 else 4)
    return header


def _decode(data: bytes, rawmode: str | None = None) -> tuple[np.ndarray, dict]:
    """Pillow's pixels, unpacked as `rawmode` says instead of its own choice, and what it found beside them."""
    from PIL.PngImagePlugin import PngImageFile

    with PngImageFile(io.BytesIO(data)) as picture:
        if not picture.tile:
            raise OSError("it has no pixels")
        if rawmode:
            picture.tile = [picture.tile[0]._replace(args=rawmode)]
        return np.asarray(picture), picture.info


def read_16_bits(data: bytes, header: Header) -> UInt16[np.ndarray, "h w 4"]:
    """RGBA codes of a PNG of 16 bits a sample; a colour that it declares transparent gets alpha 0."""
    if header.kind == GREY:
        grey, info = _decode(data)
        codes = grey.astype(np.uint16)[..., None]
    elif header.kind == GREY_ALPHA:
        # Take the four bytes of grey and alpha as they stand.
        pairs, info = _decode(data, "RGBA")
        codes = np.ascontiguousarray(pairs).view(">u2").astype(np.uint16)
    else:
        mode = "RGBA" if CHANNELS[header.kind] == 4 else "RGB"
        (high, info), (low, _) = _decode(data, f"{mode};16B"), _decode(data, f"{mode};16L")
        codes = high.astype(np.uint16) << np.uint16(8) | low

    rgba = np.full((*codes.shape[:2], 4), 65535, np.uint16)
    if codes.shape[2] % 2:
        rgba[..., :3] = codes
        rgba[(codes == info.get("transparency", -1)).all(axis=-1), 3] = 0
    else:
        rgba[..., :3], rgba[..., 3] = codes[..., :-1], codes[..., -1]
    return rgba


def transparent_grey(data: bytes, header: Header) -> int:
    """The 8-bit code of the shade that a 2- or 4-bit grey declares transparent, or a negative number for none."""
    from PIL.PngImagePlugin import PngImageFile

    with PngImageFile(io.BytesIO(data)) as picture:
        return picture.info.get("transparency", -1) * (255 // (2**header.depth - 1))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def encode_16_bits(codes: UInt16[np.ndarray, "h w c"]) -> bytes:
    """A PNG file of 1, 3 or 4 channels of 16 bits."""
    height, width, channels = codes.shape
    rows = np.frombuffer(codes.astype(">u2").tobytes(), np.uint8).reshape(height, -1)
    # Store every row as its difference to the one above, which the format calls filter 2.
    filtered = np.full((height, 1 + rows.shape[1]), 2, np.uint8)
    filtered[:, 1:] = np.diff(rows, axis=0, prepend=np.zeros_like(rows[:1]))
    header = struct.pack(">IIBBBBB", width, height, 16, {1: 0, 3: 2, 4: 6}[channels], 0, 0, 0)
    body = zlib.compress(filtered.tobytes())
    return MAGIC + _chunk(b"IHDR", header) + _chunk(b"IDAT", body) + _chunk(b"IEND", b"")
