"""glTF textures: images, how they are sampled, and where on the surface.

Source: Khronos Group, "glTF 2.0 Specification", 2021, section 3.8; KHR_texture_transform, EXT_texture_webp.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from ..scene import CLAMP, FIRST, LINEAR, MIRROR, NEAREST, REPEAT, Textures
from ..stack import UNMAPPED, pack_textures
from .gltf_accessor import read_view
from .gltf_container import Document, read_uri
from .image import read_image, srgb_to_linear
from .pointer import Json, fail, integer, member, number, numbers, reference, rows, table
from .reading import OR_REPAIR

TRANSFORM, WEBP = "KHR_texture_transform", "EXT_texture_webp"
ENCODED = ("base_color", "emissive")  # the slots whose images are sRGB; the others hold plain numbers
_WRAP = {33071: CLAMP, 33648: MIRROR, 10497: REPEAT}
_MAGNIFIED = {9728: NEAREST, 9729: LINEAR}
_MINIFIED = {  # texels, levels
    9728: (NEAREST, FIRST),
    9729: (LINEAR, FIRST),
    9984: (NEAREST, NEAREST),
    9985: (LINEAR, NEAREST),
    9986: (NEAREST, LINEAR),
    9987: (LINEAR, LINEAR),
}


class Row(NamedTuple):
    """What makes a row of `Textures`: the image, how it is wrapped and filtered, and whether it is sRGB."""

    image: int
    wrap: tuple[int, int]
    filters: tuple[int, int, int]
    encoded: bool


class Lookup(NamedTuple):
    """A material's use of a texture: its row or -1, the set of uvs, and the affine map that they go through first."""

    row: int = -1
    uv_set: int = 0
    transform: tuple[tuple[float, float, float], ...] = UNMAPPED


def _choice(at: Json, key: str, known: dict, default: int):
    code = integer(at, key, default)
    if code not in known:
        fail(at, f"{key} {code} is not one of {', '.join(map(str, known))}")
    return known[code]


def _read_sampler(texture: Json, samplers: list[Json]) -> tuple[tuple[int, int], tuple[int, int, int]]:
    sampler = reference(texture, "sampler", samplers) or texture._replace(value={})
    wrap = _choice(sampler, "wrapS", _WRAP, 10497), _choice(sampler, "wrapT", _WRAP, 10497)
    magnified = _choice(sampler, "magFilter", _MAGNIFIED, 9729)
    return wrap, (magnified, *_choice(sampler, "minFilter", _MINIFIED, 9987))


def _read_transform(at: Json) -> tuple[tuple[float, float, float], ...]:
    """Offset · rotation · scale as two rows; the rotation is counter-clockwise to the eye, with v downwards.

    So the extension's words, its test model and three.js have it; the GLSL in its text turns the other way.
    """
    (x, y), (width, height) = numbers(at, "offset", (0.0, 0.0)), numbers(at, "scale", (1.0, 1.0))
    angle = number(at, "rotation", 0.0)
    sin, cos = math.sin(angle), math.cos(angle)
    return (cos * width, sin * height, x), (-sin * width, cos * height, y)


class TextureTable:
    """The rows of `Textures` that a file's materials ask for, each once."""

    def __init__(self, document: Document):
        self._document, root = document, document.root
        self._textures, self._images = rows(root, "textures"), rows(root, "images")
        self._samplers = rows(root, "samplers")
        self._rows: dict[Row, int] = {}
        self._pictures: dict[int, Float[np.ndarray, "h w 4"] | None] = {}

    def lookup(self, info: Json, slot: str) -> Lookup:
        """How a material looks up the texture of a slot, which gets a new row if nothing equal has one."""
        if not info.value:
            return Lookup()
        reading = self._document.reading
        texture = reference(info, "index", self._textures) or fail(info, "index is missing")
        webp = table(texture, "extensions", WEBP)
        source = webp if "source" in webp.value else texture
        if reference(source, "source", self._images) is None:
            reading.ignore("textures without a PNG, JPEG or WebP are left out", texture.where)
            return Lookup()
        image = integer(source, "source")
        if (picture := self._read(image)) is None:
            return Lookup()
        transform = table(info, "extensions", TRANSFORM)
        uv_set = integer(transform, "texCoord", integer(info, "texCoord", 0))
        if uv_set > 1:
            reading.ignore("texture coordinates beyond the second are replaced by the first", info.where)
            uv_set = 0
        row = Row(image, *_read_sampler(texture, self._samplers), slot in ENCODED)
        if row not in self._rows:
            self._count(picture, texture)
        return Lookup(self._rows.setdefault(row, len(self._rows)), uv_set, _read_transform(transform))

    def _read(self, index: int) -> Float[np.ndarray, "h w 4"] | None:
        """The decoded RGBA of an image, read once; None if it is broken and dropped."""
        if index not in self._pictures:
            image = self._images[index]
            picture = self._pictures[index] = self._decode(image)
            if picture is not None:
                self._count(picture, image)
        return self._pictures[index]

    def _count(self, picture: Float[np.ndarray, "h w 4"], at: Json) -> None:
        """Count what a decoded picture, and what each row made of it, will hold."""
        size = picture[..., 0].size
        self._document.reading.count("texels", size, at.file, at.where, "the texels, decoded and packed,")

    def _decode(self, image: Json) -> Float[np.ndarray, "h w 4"] | None:
        if ("uri" in image.value) == ("bufferView" in image.value):
            fail(image, "needs either a uri or a bufferView; export it again")
        limits, name = self._document.reading.limits, ""
        try:
            if "uri" in image.value:
                uri = member(image, "uri", str)
                data = read_uri(uri, self._document.folder, limits)
                name = "" if uri.value.startswith("data:") else f" ({uri.value})"
            else:
                data = bytes(read_view(self._document, image)[0])
            return read_image(data, name=f"{image.file}: {image.where}{name}", limits=limits)
        except InputError as error:
            told = error.message.rsplit("; ", 1)[0]
            if not self._document.reading.repair:
                raise InputError(error.file, error.where, f"{told}; {OR_REPAIR}") from error
            self._document.reading.drop(image.file, image.where, told, "a texture")
            return None

    def pack(self) -> Textures:
        """All rows with their mip levels. Base colour and emission become linear here, before any filtering."""
        read = [(row, picture) for row in self._rows if (picture := self._pictures[row.image]) is not None]
        texels = [srgb_to_linear(picture) if row.encoded else picture for row, picture in read]
        return pack_textures(texels, [row.wrap for row, _ in read], [row.filters for row, _ in read])
