"""glTF materials: factors, and the textures that they name.

Source: Khronos Group, "glTF 2.0 Specification", 2021, section 3.9; the extensions KHR_materials_emissive_strength,
_ior, _unlit, _specular, _clearcoat and _sheen.
"""

from ..scene import BLEND, MASK, OPAQUE, TEXTURE_SLOTS, Materials, Textures
from ..stack import stack_materials
from .asset import LARGEST
from .gltf_container import Document
from .gltf_texture import TextureTable
from .pointer import Json, fail, member, number, numbers, rows, table
from .reading import Reading

PREFIX = "KHR_materials_"
EXTENSIONS = frozenset(PREFIX + n for n in ("emissive_strength", "ior", "unlit", "specular", "clearcoat", "sheen"))
_ALPHA_MODES = {"OPAQUE": OPAQUE, "MASK": MASK, "BLEND": BLEND}
_PBR = "pbrMetallicRoughness"
_MEMBERS = {
    "base_color": (_PBR, "baseColorTexture"),
    "metallic_roughness": (_PBR, "metallicRoughnessTexture"),
    "normal": ("normalTexture",),
    "occlusion": ("occlusionTexture",),
    "emissive": ("emissiveTexture",),
}


def _clamped(at: Json, key: str, default: tuple, high: float, reading: Reading) -> tuple[float, ...]:
    """Factors put into [0, high], with a note where they were not."""
    found = numbers(at, key, default)
    clamped = tuple(min(max(x, 0.0), high) for x in found)
    if clamped != found:
        reading.mend(at.file, at.where, f"{key} is clamped to [0, {high:g}]")
    return clamped


def _clamped_number(at: Json, key: str, default: float, reading: Reading) -> float:
    found = number(at, key, default)
    if not 0.0 <= found <= 1.0:
        reading.mend(at.file, at.where, f"{key} is clamped to [0, 1]")
    return min(max(found, 0.0), 1.0)


def _read_alpha(material: Json) -> dict:
    mode = member(material, "alphaMode", str, "OPAQUE")
    if mode.value not in _ALPHA_MODES:
        fail(mode, f"is {mode.value[:20]!r}, not one of {', '.join(_ALPHA_MODES)}")
    cutoff = number(material, "alphaCutoff", 0.5, 0.0, LARGEST)
    return {"alpha_mode": _ALPHA_MODES[mode.value], "alpha_cutoff": cutoff}


def _read_extensions(material: Json, reading: Reading) -> dict:
    """What the extensions say beyond the metallic-roughness model."""
    at = {name: table(material, "extensions", PREFIX + name) for name in ("ior", "specular", "clearcoat", "sheen")}
    for extension in at.values():
        for key in extension.value:
            if key.endswith("Texture"):
                reading.ignore(f"{key} is ignored", extension.where)
    weight = _clamped_number(at["specular"], "specularFactor", 1.0, reading)
    color = _clamped(at["specular"], "specularColorFactor", (1.0, 1.0, 1.0), LARGEST, reading)
    coat = _clamped_number(at["clearcoat"], "clearcoatFactor", 0.0, reading)
    sheen = _clamped(at["sheen"], "sheenColorFactor", (0.0, 0.0, 0.0), 1.0, reading)
    return {
        "ior": _read_ior(at["ior"]),
        "specular": (*color, weight),
        "unlit": f"{PREFIX}unlit" in table(material, "extensions").value,
        "clearcoat": (coat, _clamped_number(at["clearcoat"], "clearcoatRoughnessFactor", 0.0, reading)),
        "sheen": (*sheen, _clamped_number(at["sheen"], "sheenRoughnessFactor", 0.0, reading)),
    }


def _read_ior(at: Json) -> float:
    """An index of refraction of at least 1, or 0 for a surface that mirrors all light."""
    ior = number(at, "ior", 1.5, 0.0, LARGEST)
    if 0 < ior < 1:
        fail(at, f"ior is {ior:g}, but 0 or at least 1 is needed; export the material again")
    return ior


def _read_material(material: Json, textures: TextureTable, reading: Reading) -> dict:
    pbr = table(material, _PBR)
    infos = {slot: table(material, *_MEMBERS[slot]) for slot in TEXTURE_SLOTS}
    emission = table(material, "extensions", "KHR_materials_emissive_strength")
    strength = number(emission, "emissiveStrength", 1.0, 0.0, LARGEST)
    factor = _clamped(material, "emissiveFactor", (0.0, 0.0, 0.0), LARGEST, reading)
    lookups = {slot: textures.lookup(infos[slot], slot) for slot in TEXTURE_SLOTS}
    return {
        "base_color": _clamped(pbr, "baseColorFactor", (1.0, 1.0, 1.0, 1.0), 1.0, reading),
        "metallic": _clamped_number(pbr, "metallicFactor", 1.0, reading),
        "roughness": _clamped_number(pbr, "roughnessFactor", 1.0, reading),
        "emissive": tuple(min(strength * x, LARGEST) for x in factor),
        "normal_scale": number(infos["normal"], "scale", 1.0),
        "occlusion_strength": _clamped_number(infos["occlusion"], "strength", 1.0, reading),
        "double_sided": member(material, "doubleSided", bool, False).value,
        **{f"{slot}_texture": lookup.row for slot, lookup in lookups.items()},
        "uv_sets": tuple(lookup.uv_set for lookup in lookups.values()),
        "uv_transforms": tuple(lookup.transform for lookup in lookups.values()),
        **_read_alpha(material),
        **_read_extensions(material, reading),
    }


def read_materials(document: Document, default: bool) -> tuple[Materials, Textures]:
    """All materials in the order of the file, and the textures they use; `default` adds a row of glTF's defaults."""
    materials = rows(document.root, "materials")
    if default:
        materials = [*materials, Json({}, document.root.file)]
    textures = TextureTable(document)
    table_rows = [_read_material(material, textures, document.reading) for material in materials]
    return stack_materials(table_rows), textures.pack()
