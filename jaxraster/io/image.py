"""8-bit and 16-bit pictures: PNG, JPEG and WebP in, PNG and JPEG out."""

import io
import os
import warnings

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt

from ..errors import Error, InputError, LimitError, OutputError
from . import png
from .disk import Path, check_file, read_file, suffix_of, write_file
from .reading import DEFAULT, Limits

JPEG, SCAN = b"\xff\xd8\xff", b"\xff\xda"
MOST_SCANS = 64  # of a JPEG; usual ones have 1 to 12, and each of 33 bytes takes 17 ms for 4096 x 4096 pixels


def _webp_size(data: bytes) -> tuple[int, int]:
    """Width and height of a WebP, by its first chunk. Source: Google, "WebP Container Specification", RFC 9649."""
    if data[12:16] == b"VP8X":
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    if data[12:16] == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    return int.from_bytes(data[26:28], "little") & 0x3FFF, int.from_bytes(data[28:30], "little") & 0x3FFF


def _decode(data: bytes, name: str, limits: Limits) -> UInt[np.ndarray, "h w 4"]:
    """The RGBA codes of a PNG, JPEG or WebP, of 16 bits where the file has these."""
    from PIL.JpegImagePlugin import JpegImageFile
    from PIL.PngImagePlugin import PngImageFile
    from PIL.WebPImagePlugin import WebPImageFile

    header = png.read_header(data, name, limits) if data.startswith(png.MAGIC) else None
    if header and header.depth == 16:
        return png.read_16_bits(data, header)
    # Name the decoder: where Pillow is left to find it, it has a limit of its own that only a global can raise.
    decoder = PngImageFile if header else JpegImageFile if data.startswith(JPEG) else WebPImageFile
    if decoder is JpegImageFile and (scans := data.count(SCAN)) > MOST_SCANS:
        raise LimitError(name, "", f"has {scans} scans; at most {MOST_SCANS} are allowed{png.AGAIN}")
    if decoder is WebPImageFile:
        # This one makes room for all pixels before it tells their number.
        png.check_size(*_webp_size(data), len(data), name, limits)
    with decoder(io.BytesIO(data)) as picture:
        png.check_size(*picture.size, len(data), name, limits)
        codes = np.array(picture.convert("RGBA"))
    if header and header.kind == png.GREY and header.depth in (2, 4):
        codes[codes[..., 0] == png.transparent_grey(data, header), 3] = 0
    return codes


def read_image(source: Path | bytes, *, name: str = "", limits: Limits = DEFAULT) -> Float[np.ndarray, "h w 4"]:
    """RGBA in [0, 1] of a PNG, JPEG or WebP, still encoded as in the file: grey is repeated, absent alpha is 1.

    16-bit PNG keeps all its bits. Of an animated PNG comes the first frame. Profiles, gamma and orientation tags are
    ignored, as glTF demands. `name` is what errors call a picture given as bytes.
    """
    data, name = (source, name) if isinstance(source, bytes) else (read_file(source, limits), name or os.fspath(source))
    if not data.startswith((png.MAGIC, JPEG)) and (data[:4], data[8:12]) != (b"RIFF", b"WEBP"):
        raise InputError(name, "", "is not a PNG, JPEG or WebP; export the picture again")
    # A damaged animation of 200 bytes can keep its decoder busy for half a minute.
    if data[12:16] == b"VP8X" and data[20:21] and data[20] & 2:
        raise InputError(name, "", "is an animation; export a single picture")
    try:
        with warnings.catch_warnings():
            # Let no warning about broken tags, which are ignored, refuse the pixels.
            warnings.simplefilter("ignore")
            codes = _decode(data, name, limits)
    except Error:
        raise
    # The decoder reports broken files by SyntaxError, OSError, ValueError, struct.error, even AttributeError.
    except Exception as error:
        root = error
        while root.__cause__ is not None:
            root = root.__cause__
        # WebP's decoder keeps to that limit nevertheless.
        if "DecompressionBomb" in type(root).__name__:
            raise LimitError(name, "", f"is too large: {str(root).rstrip('.')}; scale it down") from error
        # Quote what was meant for people; the rest names objects and buffers of the decoder.
        told = isinstance(root, OSError | SyntaxError | ValueError) and "<_io" not in str(root)
        reason = " ".join(str(root).split()).rstrip(".") if told else "its data are damaged"
        raise InputError(name, "", f"is broken: {reason}; export the picture again") from error
    return np.true_divide(codes, np.float32(np.iinfo(codes.dtype).max), dtype=np.float32)


def srgb_to_linear(image: Float[np.ndarray, "*b c"]) -> Float[np.ndarray, "*b c"]:
    """Linear light of display-encoded RGB or RGBA in [0, 1]; a fourth channel is alpha and stays.

    c / 12.92 up to 0.04045, ((c + 0.055) / 1.055)^2.4 above.
    Source: IEC 61966-2-1:1999.
    """
    color = image[..., :3]
    linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    return np.concatenate([linear, image[..., 3:]], axis=-1).astype(image.dtype)


def _codes(image, bits: int) -> UInt[np.ndarray, "..."]:
    """The integer codes of an image: floats clipped to [0, 1] and rounded to even, integers as they are."""
    image = np.asarray(image)
    if image.ndim not in (2, 3) or 0 in image.shape or image.shape[2:] not in ((), (3,), (4,)):
        raise ValueError(f"image: expected [h, w], [h, w, 3] or [h, w, 4], got shape {list(image.shape)}")
    if bits not in (8, 16):
        raise ValueError(f"bits: expected 8 or 16, got {bits}")
    if image.dtype in (np.uint8, np.uint16):
        return image
    if not jnp.issubdtype(image.dtype, jnp.floating):
        raise TypeError(f"image: expected floats in [0, 1], uint8 or uint16, got {image.dtype}")
    image = image.astype(np.float32)
    if bad := int(np.isnan(image).sum()):
        raise ValueError(f"image: {bad} of {image.size} values are NaN; mask them, or find out where they come from")
    return np.rint((2**bits - 1) * np.clip(image, 0, 1)).astype(f"uint{bits}")


def _png(codes: UInt[np.ndarray, "h w *c"]) -> bytes:
    """A PNG file of 8 or 16 bits a channel, as the codes have."""
    import imageio.v3 as iio

    if codes.dtype == np.uint16:
        return png.encode_16_bits(codes.reshape(*codes.shape[:2], -1))
    return iio.imwrite("<bytes>", codes, plugin="pillow", extension=".png")


def _jpeg(codes: UInt[np.ndarray, "h w *c"]) -> bytes:
    """A JPEG file of high quality, with colour as sharp as brightness."""
    import imageio.v3 as iio

    if codes.dtype != np.uint8 or codes.shape[2:] == (4,):
        raise ValueError(f"image: JPEG holds 8-bit grey or RGB, got {codes.dtype} {list(codes.shape)}; write a .png")
    return iio.imwrite("<bytes>", codes, plugin="pillow", extension=".jpg", quality=95, subsampling=0)


_ENCODERS = {".png": _png, ".jpg": _jpeg, ".jpeg": _jpeg}


def _encoder(path: Path):
    suffix = suffix_of(path)
    if suffix not in _ENCODERS:
        found = f"unknown picture format {suffix!r}" if suffix else "no suffix to tell the picture's format"
        raise OutputError(
            path, "", f"{found}; end the name with {', '.join(_ENCODERS)}, or with .hdr or .exr for light"
        )
    return _ENCODERS[suffix]


def check_writable(path: Path) -> None:
    """Raise the `OutputError` that `write_image` would end in, as far as it can be known before rendering."""
    _encoder(path)
    check_file(path)


def write_image(path: Path, image, *, bits: int = 8) -> None:
    """Write display-encoded `[h, w]`, `[h, w, 3]` or `[h, w, 4]` as PNG or JPEG, whichever the suffix says.

    Floats are clipped to [0, 1] and rounded to 8 or (PNG only) 16 `bits`; uint8 and uint16 are written as they are.
    NaN is a `ValueError`. The file is replaced in one step: whatever fails, an old picture of that name stays.
    """
    encode = _encoder(path)
    write_file(path, encode(_codes(image, bits)))
