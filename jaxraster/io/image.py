"""8-bit and 16-bit pictures: PNG and JPEG in, PNG and JPEG out."""

import os
import warnings

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt

from ..errors import InputError, LimitError, OutputError
from .disk import Path, check_file, read_file, write_file


def read_image(source: Path | bytes, *, name: str = "") -> Float[np.ndarray, "h w 4"]:
    """RGBA in [0, 1] of a PNG or JPEG, still encoded as in the file: grey is repeated, absent alpha is 1.

    Grey keeps its 16 bits; 16-bit colour comes with its upper 8. Profiles and orientation tags are ignored, as glTF
    demands. `name` is what errors call a picture given as bytes.
    """
    import imageio.v3 as iio

    data, name = (source, name) if isinstance(source, bytes) else (read_file(source), name or os.fspath(source))
    if not data.startswith((b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff")):
        raise InputError(name, "", "is not a PNG or JPEG; export the picture again")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if iio.immeta(data, plugin="pillow")["mode"].startswith("I"):
                grey = iio.imread(data, plugin="pillow")[..., None].astype(np.float32) / np.float32(65535)
                return np.concatenate([grey, grey, grey, np.ones_like(grey)], axis=-1)
            return iio.imread(data, plugin="pillow", mode="RGBA").astype(np.float32) / np.float32(255)
    # The decoder reports broken files by SyntaxError, OSError, ValueError, struct.error, even AttributeError.
    except Exception as error:
        root = error
        while root.__cause__ is not None:
            root = root.__cause__
        if "DecompressionBomb" in type(root).__name__:
            raise LimitError(name, "", f"is too large: {str(root).rstrip('.')}; scale it down") from error
        raise InputError(name, "", f"is broken: {root}; export the picture again") from error


def srgb_to_linear(image: Float[np.ndarray, "*b c"]) -> Float[np.ndarray, "*b c"]:
    """Linear light of display-encoded RGB or RGBA in [0, 1]; a fourth channel is alpha and stays.

    c / 12.92 up to 0.04045, ((c + 0.055) / 1.055)^2.4 above.
    Source: IEC 61966-2-1:1999.
    """
    color = image[..., :3]
    linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    return np.concatenate([linear, image[..., 3:]], axis=-1).astype(image.dtype)


def _codes(image) -> UInt[np.ndarray, "..."]:
    """The integer codes of an image: floats clipped to [0, 1] and rounded to even 8-bit codes, integers as they are."""
    image = np.asarray(image)
    if image.ndim not in (2, 3) or 0 in image.shape or image.shape[2:] not in ((), (3,), (4,)):
        raise ValueError(f"image: expected [h, w], [h, w, 3] or [h, w, 4], got shape {list(image.shape)}")
    if image.dtype in (np.uint8, np.uint16):
        return image
    if not jnp.issubdtype(image.dtype, jnp.floating):
        raise TypeError(f"image: expected floats in [0, 1], uint8 or uint16, got {image.dtype}")
    image = image.astype(np.float32)
    if bad := int(np.isnan(image).sum()):
        raise ValueError(f"image: {bad} of {image.size} values are NaN; mask them, or find out where they come from")
    return np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)


def _png(codes: UInt[np.ndarray, "h w *c"]) -> bytes:
    """A PNG file of 8 bits a channel, or of 16 bits of grey."""
    import imageio.v3 as iio

    if codes.dtype == np.uint16 and codes.ndim == 3:
        raise ValueError(f"image: PNG holds 8 bits or 16-bit grey, got uint16 {list(codes.shape)}; write 8 bits")
    return iio.imwrite("<bytes>", codes, plugin="pillow", extension=".png")


def _jpeg(codes: UInt[np.ndarray, "h w *c"]) -> bytes:
    """A JPEG file of high quality, with colour as sharp as brightness."""
    import imageio.v3 as iio

    if codes.dtype != np.uint8 or codes.shape[2:] == (4,):
        raise ValueError(f"image: JPEG holds 8-bit grey or RGB, got {codes.dtype} {list(codes.shape)}; write a .png")
    return iio.imwrite("<bytes>", codes, plugin="pillow", extension=".jpg", quality=95, subsampling=0)


_ENCODERS = {".png": _png, ".jpg": _jpeg, ".jpeg": _jpeg}


def _encoder(path: Path):
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in _ENCODERS:
        found = f"unknown picture format {suffix!r}" if suffix else "no suffix to tell the picture's format"
        raise OutputError(path, "", f"{found}; end the name with {', '.join(_ENCODERS)}")
    return _ENCODERS[suffix]


def check_writable(path: Path) -> None:
    """Raise the `OutputError` that `write_image` would end in, as far as it can be known before rendering."""
    _encoder(path)
    check_file(path)


def write_image(path: Path, image) -> None:
    """Write display-encoded `[h, w]`, `[h, w, 3]` or `[h, w, 4]` as PNG or JPEG, whichever the suffix says.

    Floats are clipped to [0, 1] and rounded to 8 bits; uint8 and uint16 (PNG only) are written as they are. NaN is a
    `ValueError`. The file is replaced in one step: whatever fails, an old picture of that name stays.
    """
    encode = _encoder(path)
    write_file(path, encode(_codes(image)))
