"""OpenEXR pictures: named channels of half and single floats, through the optional package OpenEXR.

A picture covers its display window: stored pixels beyond are cut off, missing ones are 0. Channel names follow the
format's habit: R, G, B or Y for the picture itself, `layer.channel` for the rest (`depth.Z`, `normal.X`).

Source: Academy Software Foundation, "Technical Introduction to OpenEXR" and "OpenEXR File Layout".
"""

import contextlib
import importlib
import io
import os
import threading
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from ..errors import Error, InputError, OutputError
from .disk import Path, check_file, read_file, write_file
from .png import AGAIN, check_size
from .reading import DEFAULT, Limits

MOST_NAME = 255  # characters of a channel's name
_PRINTING = threading.Lock()
REC_709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)  # x and y of red, green, blue and white


def _package(path: Path, error: type[Error]) -> ModuleType:
    """The package OpenEXR, or one line that says how to get it."""
    try:
        return importlib.import_module("OpenEXR")
    except ImportError:
        raise error(path, "", "EXR needs the package OpenEXR; pip install OpenEXR") from None


@contextlib.contextmanager
def _printed() -> Iterator[io.StringIO]:
    """What is printed inside through Python; what OpenEXR's library itself prints on the standard error stream is lost.

    Its API has no switch for that, so the stream is turned away for the whole process: lines of other threads get lost
    as well, and two that read at once wait for each other, lest one restores what the other has turned away.
    """
    with _PRINTING, contextlib.ExitStack() as undo:
        # Without such a stream nothing can be printed there.
        with contextlib.suppress(OSError):
            kept = os.dup(2)
            undo.callback(os.close, kept)
            undo.callback(os.dup2, kept, 2)
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), 2)
        yield undo.enter_context(contextlib.redirect_stdout(io.StringIO()))


def _window(header: Mapping[str, Any], name: str) -> tuple[slice, slice]:
    """The rows and columns of a window, whose bounds are inclusive in the file."""
    (left, top), (right, bottom) = header[name]
    return slice(int(top), int(bottom) + 1), slice(int(left), int(right) + 1)


def _check_header(
    package: ModuleType, header: Mapping[str, Any], num_parts: int, size: int, name: str, limits: Limits
) -> None:
    """Refuse what is not a plain picture, or larger than is read, before its pixels are decoded."""
    if header.get("type") in (package.deepscanline, package.deeptile):
        raise InputError(name, "", "holds deep pixels, which are not supported; flatten the picture")
    for channel in header["channels"]:
        if (channel.xSampling, channel.ySampling) != (1, 1):
            raise InputError(
                name, f"{channel.name!r:.40}", "is stored at a lower resolution, which is not supported; export RGB"
            )
    sizes = [tuple(axis.stop - axis.start for axis in _window(header, w)) for w in ("dataWindow", "displayWindow")]
    # Bound the tiles as well: one that is far larger than the picture would be decoded whole.
    if "tiles" in header:
        sizes.append((header["tiles"].ySize, header["tiles"].xSize))
    # Count two bytes a value, as the header does not say whether it holds halves or floats, and of no fewer than four
    # channels, since one becomes three of light. All parts are decoded.
    each = 2 * max(4, len(header["channels"])) * num_parts
    for height, width in sizes:
        check_size(width, height, size, name, limits, each=each, kind="light")


def _place(pixels: Shaped[np.ndarray, "a b"], header: Mapping[str, Any]) -> Shaped[np.ndarray, "h w"]:
    """Pixels of the data window as seen through the display window."""
    stored, shown = _window(header, "dataWindow"), _window(header, "displayWindow")
    if stored == shown:
        return pixels
    canvas = np.zeros([axis.stop - axis.start for axis in shown], pixels.dtype)
    both = [(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(stored, shown)]
    if all(start < stop for start, stop in both):
        target, source = (
            tuple(slice(start - axis.start, stop - axis.start) for axis, (start, stop) in zip(window, both))
            for window in (shown, stored)
        )
        canvas[target] = pixels[source]
    return canvas


def _decode(data: bytes, name: str, limits: Limits) -> tuple[dict[str, np.ndarray], Mapping[str, Any], int]:
    """The channels and the header of a file's first part, and how many parts there are."""
    package = _package(name, InputError)
    if data[:4] != b"\x76\x2f\x31\x01":
        raise InputError(name, "", "is not an OpenEXR picture; export the picture again")
    # Keep what the package prints about broken pixels, which it then leaves out without raising.
    try:
        with _printed() as printed:
            parts = package.File(io.BytesIO(data), header_only=True).parts
            for part in parts:
                _check_header(package, part.header, len(parts), len(data), name, limits)
            read = package.File(io.BytesIO(data), separate_channels=True).parts
            if len(read) < len(parts):
                raise ValueError(printed.getvalue().split(" - ")[-1])
            channels = {key: _place(channel.pixels, read[0].header) for key, channel in read[0].channels.items()}
    except Error:
        raise
    # The package raises RuntimeError, ValueError, IndexError, UnicodeDecodeError and more for broken files.
    except Exception as error:
        raise InputError(name, "", f"is broken: {' '.join(str(error).split())}{AGAIN}") from error
    return channels, read[0].header, len(parts)


def read_exr(path: Path, limits: Limits = DEFAULT) -> dict[str, Shaped[np.ndarray, "h w"]]:
    """The channels of an EXR file's first part by name: float16, float32 or uint32 as they are stored."""
    return _decode(read_file(path, limits), os.fspath(path), limits)[0]


def decode_exr_light(
    data: bytes, name: str, limits: Limits = DEFAULT
) -> tuple[Float[np.ndarray, "h w 3"], tuple[str, ...]]:
    """What `read_exr_light` returns, from the bytes of a file; `name` is for errors."""
    channels, header, num_parts = _decode(data, name, limits)
    if "RY" in channels or "BY" in channels:
        raise InputError(name, "", "stores luminance and chroma, which is not supported; export RGB")
    layers = [key[:-1] for key in channels if key == "R" or key.endswith(".R")]
    layers = [layer for layer in layers if {f"{layer}G", f"{layer}B"} <= channels.keys()]
    if "" in layers or len(layers) == 1:
        layer = "" if "" in layers else layers[0]
        chosen = [f"{layer}{color}" for color in "RGB"]
    elif not layers and "Y" in channels:
        chosen = ["Y", "Y", "Y"]
    else:
        found = ", ".join(f"{key!r:.40}" for key in [*channels][:10]) or "none"
        raise InputError(name, "", f"needs channels R, G and B, or Y, or one layer with these; it has {found}")
    for key in chosen:
        if channels[key].dtype == np.uint32:
            raise InputError(name, f"{key!r:.40}", "holds integers, not light; export floats")

    notes = []
    primaries = header.get("chromaticities")
    # Accept the rounding of usual writers, a unit of the third digit.
    if primaries is not None and not np.allclose(np.ravel(primaries), REC_709, rtol=0, atol=1e-3):
        notes.append("its primaries are not those of Rec. 709; its colours are taken as if they were")
    if num_parts > 1:
        notes.append(f"{num_parts - 1} further parts are ignored")
    return np.stack([channels[key].astype(np.float32) for key in chosen], axis=-1), tuple(notes)


def read_exr_light(path: Path, limits: Limits = DEFAULT) -> tuple[Float[np.ndarray, "h w 3"], tuple[str, ...]]:
    """Linear light of an EXR file, and notes on what was left out: R, G and B, or Y, or those of its only layer."""
    return decode_exr_light(read_file(path, limits), os.fspath(path), limits)


def _channel(name: str, pixels) -> Shaped[np.ndarray, "h w"]:
    """A channel as it will be stored."""
    if not 0 < len(name.encode()) <= MOST_NAME or not name.isprintable():
        raise ValueError(f"channels: expected names of 1 to {MOST_NAME} printable characters, got {name!r:.40}")
    pixels = np.asarray(pixels)
    if pixels.ndim != 2 or 0 in pixels.shape:
        raise ValueError(f"channels: expected [h, w] for {name!r}, got shape {list(pixels.shape)}")
    if pixels.dtype not in (np.float16, np.uint32):
        if not jnp.issubdtype(pixels.dtype, jnp.floating):
            raise TypeError(f"channels: expected floats or uint32 for {name!r}, got {pixels.dtype}")
        pixels = pixels.astype(np.float32)
    return np.ascontiguousarray(pixels)


def check_exr(path: Path) -> None:
    """Raise the `OutputError` that `write_exr` would end in, as far as it can be known before rendering."""
    _package(path, OutputError)
    check_file(path)


def write_exr(path: Path, channels: Mapping[str, Any]) -> None:
    """Write named channels `[h, w]` of one size as an EXR file without loss, in one step.

    float16 and uint32 are stored as they are, other floats as float32; NaN and infinity are stored, too.

    Example:
        >>> import numpy as np, tempfile
        >>> from jaxraster.io.exr import read_exr, write_exr
        >>> path = tempfile.mkdtemp() + "/a.exr"
        >>> write_exr(path, {"R": np.ones((2, 3)), "depth.Z": np.ones((2, 3), np.float16)})
        >>> {name: pixels.dtype.name for name, pixels in read_exr(path).items()}
        {'R': 'float32', 'depth.Z': 'float16'}
    """
    package = _package(path, OutputError)
    planes = {name: _channel(name, pixels) for name, pixels in channels.items()}
    if len(shapes := {plane.shape for plane in planes.values()}) != 1:
        raise ValueError(f"channels: expected at least one, all of one size, got the sizes {sorted(shapes)}")
    stream = io.BytesIO()
    package.File({"compression": package.ZIP_COMPRESSION, "type": package.scanlineimage}, planes).write(stream)
    write_file(path, stream.getvalue())
