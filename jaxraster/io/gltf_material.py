"""glTF materials with their textures and samplers.

Source: Khronos Group, "glTF 2.0 Specification", 2021, sections 3.8 and 3.9; "KHR_materials_emissive_strength".
"""

from ..scene import CLAMP, MIRROR, REPEAT, TEXTURE_SLOTS, Materials, Textures, pack_textures
from .asset import LARGEST, stack_materials
from .gltf_accessor import read_view
from .gltf_container import Document, read_uri
from .image import read_image, srgb_to_linear
from .pointer import Json, Notes, fail, integer, member, note, number, numbers, reference, rows, table

_WRAP = {33071: CLAMP, 33648: MIRROR, 10497: REPEAT}
_PBR = "pbrMetallicRoughness"
_MEMBERS = {
    "base_color": (_PBR, "baseColorTexture"),
    "metallic_roughness": (_PBR, "metallicRoughnessTexture"),
    "normal": ("normalTexture",),
    "occlusion": ("occlusionTexture",),
    "emissive": ("emissiveTexture",),
}
_ENCODED = ("base_color", "emissive")  # the slots whose images are sRGB; the others hold plain numbers

# What makes a row of `Textures`: the image, its wrap modes, and whether it is sRGB -> the row.
Rows = dict[tuple[int, tuple[int, int], bool], int]


def _clamped(at: Json, key: str, default: tuple, high: float, notes: Notes) -> tuple[float, ...]:
    """Factors put into [0, high], with a note where they were not."""
    found = numbers(at, key, default)
    clamped = tuple(min(max(x, 0.0), high) for x in found)
    if clamped != found:
        note(notes, f"{key} is clamped to [0, {high:g}]", at.where)
    return clamped


def _clamped_number(at: Json, key: str, notes: Notes) -> float:
    found = number(at, key, 1.0)
    if not 0.0 <= found <= 1.0:
        note(notes, f"{key} is clamped to [0, 1]", at.where)
    return min(max(found, 0.0), 1.0)


def _wrap(texture: Json, samplers: list[Json]) -> tuple[int, int]:
    sampler = reference(texture, "sampler", samplers) or texture._replace(value={})
    modes = [integer(sampler, key, 10497) for key in ("wrapS", "wrapT")]
    for mode in modes:
        if mode not in _WRAP:
            fail(sampler, f"wrap mode {mode} is not one of {', '.join(map(str, _WRAP))}")
    return _WRAP[modes[0]], _WRAP[modes[1]]


def _texture_row(info: Json, slot: str, document: Document, found: Rows, notes: Notes) -> int:
    """The row of `Textures` that a material's texture gets, a new one if nothing equal has one; -1 if it has none."""
    if not info.value:
        return -1
    if integer(info, "texCoord", 0) != 0:
        note(notes, "the first texture coordinates replace others", info.where)
    textures, images = rows(document.root, "textures"), rows(document.root, "images")
    texture = reference(info, "index", textures) or fail(info, "index is missing")
    if reference(texture, "source", images) is None:
        note(notes, "textures without a PNG or JPEG are left out", texture.where)
        return -1
    wrap = _wrap(texture, rows(document.root, "samplers"))
    return found.setdefault((integer(texture, "source"), wrap, slot in _ENCODED), len(found))


def _read_material(material: Json, document: Document, found: Rows, notes: Notes) -> dict:
    pbr = table(material, _PBR)
    infos = {slot: table(material, *_MEMBERS[slot]) for slot in TEXTURE_SLOTS}
    emission = table(material, "extensions", "KHR_materials_emissive_strength")
    strength = number(emission, "emissiveStrength", 1.0, 0.0, LARGEST)
    factor = _clamped(material, "emissiveFactor", (0.0, 0.0, 0.0), LARGEST, notes)
    mode = member(material, "alphaMode", str, "OPAQUE").value
    if mode != "OPAQUE":
        note(notes, "transparent materials are drawn opaque", member(material, "name", str, material.where).value)
    return {
        "base_color": _clamped(pbr, "baseColorFactor", (1.0, 1.0, 1.0, 1.0), 1.0, notes),
        "metallic": _clamped_number(pbr, "metallicFactor", notes),
        "roughness": _clamped_number(pbr, "roughnessFactor", notes),
        "emissive": tuple(strength * x for x in factor),
        "normal_scale": number(infos["normal"], "scale", 1.0),
        "occlusion_strength": _clamped_number(infos["occlusion"], "strength", notes),
        "double_sided": member(material, "doubleSided", bool, False).value,
        **{f"{slot}_texture": _texture_row(infos[slot], slot, document, found, notes) for slot in TEXTURE_SLOTS},
    }


def _read_picture(image: Json, document: Document):
    """The decoded RGBA of an image, in a file, in place or in a buffer view."""
    if ("uri" in image.value) == ("bufferView" in image.value):
        fail(image, "needs either a uri or a bufferView; export it again")
    if "uri" in image.value:
        uri = member(image, "uri", str)
        data, name = read_uri(uri, document.folder), "" if uri.value.startswith("data:") else f" ({uri.value})"
    else:
        data, name = bytes(read_view(document, image)[0]), ""
    return read_image(data, name=f"{image.file}: {image.where}{name}")


def read_materials(document: Document, default: bool, notes: Notes) -> tuple[Materials, Textures]:
    """All materials in the order of the file, and the textures they use; `default` adds a row of glTF's defaults.

    Base colour and emission become linear here, before any filtering.
    """
    materials = rows(document.root, "materials")
    if default:
        materials = [*materials, Json({}, document.root.file)]
    found: Rows = {}
    table_rows = [_read_material(material, document, found, notes) for material in materials]
    # Decode every image once, however many rows it fills.
    images = rows(document.root, "images")
    pictures = {source: _read_picture(images[source], document) for source in {source: None for source, _, _ in found}}
    texels = [srgb_to_linear(pictures[s]) if encoded else pictures[s] for s, _, encoded in found]
    return stack_materials(table_rows), pack_textures(texels, [wrap for _, wrap, _ in found])
