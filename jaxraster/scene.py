"""What the user gives: a mesh, its materials and textures, lights, an environment, and a camera.

Everything is a struct of arrays, so that a scene of any content is one pytree with one compiled shape per size.
World space: right-handed, +Y up, metres. Colours and light: linear Rec.709.
"""

from jaxtyping import Array, Bool, Float, Int

from .camera import Camera
from .check import below, fit_record
from .record import record


@record
class Mesh:
    """All triangles of a scene, in world space.

    `normals` are unit shading normals, `tangents` unit with the bitangent's sign in w (glTF: b = w · n × t), `uvs`
    have their origin at the top left of the image. Front faces are counter-clockwise; `material` is one row of
    `Materials` per face. A mesh may have a second set of uvs, and `colors`, linear RGBA by which the base
    colour is multiplied.
    """

    vertices: Float[Array, "*b v 3"]
    normals: Float[Array, "*b v 3"]
    tangents: Float[Array, "*b v 4"]
    uvs: Float[Array, "*b v 2"]
    faces: Int[Array, "f 3"]
    material: Int[Array, " f"]
    second_uvs: Float[Array, "*b v 2"] | None = None
    colors: Float[Array, "*b v 4"] | None = None


@record
class Materials:
    """glTF metallic-roughness materials, one row each.

    A `*_texture` is a row of `Textures`, or -1 for none, and multiplies its factor: `base_color` (linear RGB and
    alpha), `metallic` by the texture's blue, `roughness` (perceptual, alpha = roughness²) by its green, `emissive`
    (radiance, cd/m² up to exposure), `occlusion_strength` weighs the texture's red, `normal_scale` its slopes.

    What few materials have is None where none of them does:
    `uv_sets` and `uv_transforms` say per slot of `TEXTURE_SLOTS` which uvs it looks up (0, or 1 for the second ones)
    and by which affine map they go first; `ior` is the dielectric's index of refraction (1.5); `specular` multiplies
    its f0, by colour and by a weight that scales f90 too; `unlit` ones show their base colour whatever the light.
    `alpha_mode` says what a base colour's alpha means: nothing (OPAQUE), a hole where it is below `alpha_cutoff` (MASK,
    0.5), or how much it hides of what is behind (BLEND); a plan without `Layers` draws all of them opaque.
    Carried along for what is not drawn yet: `clearcoat` (strength, roughness) and `sheen` (linear RGB, roughness).
    """

    base_color: Float[Array, "*b m 4"]
    metallic: Float[Array, "*b m"]
    roughness: Float[Array, "*b m"]
    emissive: Float[Array, "*b m 3"]
    normal_scale: Float[Array, "*b m"]
    occlusion_strength: Float[Array, "*b m"]
    base_color_texture: Int[Array, " m"]
    metallic_roughness_texture: Int[Array, " m"]
    normal_texture: Int[Array, " m"]
    occlusion_texture: Int[Array, " m"]
    emissive_texture: Int[Array, " m"]
    double_sided: Bool[Array, " m"]
    uv_sets: Int[Array, "m 5"] | None = None
    uv_transforms: Float[Array, "*b m 5 2 3"] | None = None
    ior: Float[Array, "*b m"] | None = None
    specular: Float[Array, "*b m 4"] | None = None
    unlit: Bool[Array, " m"] | None = None
    alpha_mode: Int[Array, " m"] | None = None
    alpha_cutoff: Float[Array, "*b m"] | None = None
    clearcoat: Float[Array, "*b m 2"] | None = None
    sheen: Float[Array, "*b m 4"] | None = None


@record
class Textures:
    """All textures and all their mip levels in one buffer of linear texels.

    Level l of texture t is `width × height` texels, row 0 on top, from `offset` on: `levels[t, l]` holds (offset,
    width, height). Textures with fewer levels repeat their last one. `wrap[t]` says how u and v leave [0, 1]:
    0 repeat, 1 clamp to edge, 2 mirrored repeat. `filters[t]` says how texels are taken where they are magnified, where
    they are minified, and between levels: 0 the nearest, 1 weighed linearly, and of levels 2 for the first one alone.
    None is (1, 1, 1) for all: trilinear.
    """

    texels: Float[Array, "*b n 4"]
    levels: Int[Array, "t l 3"]
    wrap: Int[Array, "t 2"]
    filters: Int[Array, "t 3"] | None = None


@record
class Directional:
    """Parallel light: unit `direction` in which it travels, `irradiance` (lx) on a surface facing it."""

    direction: Float[Array, "*b d 3"]
    irradiance: Float[Array, "*b d 3"]


@record
class Point:
    """Light from a point: `position` (m), `intensity` (cd), faded to nothing at `range` (m, inf for never)."""

    position: Float[Array, "*b p 3"]
    intensity: Float[Array, "*b p 3"]
    range: Float[Array, "*b p"]


@record
class Spot:
    """A point light shining along unit `direction`, from full at the `inner` half angle (rad) to none at `outer`."""

    position: Float[Array, "*b s 3"]
    direction: Float[Array, "*b s 3"]
    intensity: Float[Array, "*b s 3"]
    range: Float[Array, "*b s"]
    inner: Float[Array, "*b s"]
    outer: Float[Array, "*b s"]


@record
class Sphere:
    """A glowing ball: centre `position` and `radius` (m), the same `radiance` (cd/m²) from everywhere on it."""

    position: Float[Array, "*b k 3"]
    radius: Float[Array, "*b k"]
    radiance: Float[Array, "*b k 3"]


@record
class Disc:
    """A glowing disc: centre `position` and `radius` (m), `radiance` (cd/m²) to where its unit `direction` points.

    Where `two_sided` it shines to both sides. An array, so that one light may and another not, as with materials.
    """

    position: Float[Array, "*b o 3"]
    direction: Float[Array, "*b o 3"]
    radius: Float[Array, "*b o"]
    radiance: Float[Array, "*b o 3"]
    two_sided: Bool[Array, " o"]


@record
class Rectangle:
    """A glowing rectangle: its middle `position`, and `right` and `up` from there to the middle of a side (m).

    Its `radiance` (cd/m²) goes where `right` × `up` points, or to both sides where `two_sided`. Where these are not
    perpendicular it is a parallelogram.
    """

    position: Float[Array, "*b r 3"]
    right: Float[Array, "*b r 3"]
    up: Float[Array, "*b r 3"]
    radiance: Float[Array, "*b r 3"]
    two_sided: Bool[Array, " r"]


@record
class Lights:
    """All lights of a scene by kind, each kind with a leading count that may be 0; None for no light with an area."""

    directional: Directional
    point: Point
    spot: Spot
    sphere: Sphere | None = None
    disc: Disc | None = None
    rectangle: Rectangle | None = None


@record
class EnvironmentMap:
    """Light from infinitely far away as a picture of all directions, and what matter of each roughness sees of it.

    `texels` hold radiance (cd/m²) in equirectangular projection: row 0 around +Y, the middle column towards +X, columns
    onwards turning to +Z, as in Blender, three.js and Khronos's viewers. `rotation` (rad) turns all of it about +Y,
    counter-clockwise seen from above. `suns` is what was too strong and small to be blurred and has been cut out of
    the texels; they turn with it. `harmonics`, `irradiance` and `specular` are made of the texels by
    `environment.prepare`: see there for what they hold. Their rows are held against the texels by `check_map`.
    """

    texels: Float[Array, "*b h w 3"]
    rotation: Float[Array, "*b"]
    suns: Directional
    harmonics: Float[Array, "*b 9 3"]
    irradiance: Float[Array, "*b i j"]
    specular: Float[Array, "*b s k"]


@record
class Environment:
    """Surroundings: radiance `sky` from the half space around `up`, `ground` from the other, and a `map` on top.

    Equal tones are a constant environment; zeros are none.
    """

    up: Float[Array, "*b 3"]
    sky: Float[Array, "*b 3"]
    ground: Float[Array, "*b 3"]
    map: EnvironmentMap | None = None


@record
class Scene:
    """Everything but the camera."""

    mesh: Mesh
    materials: Materials
    textures: Textures
    lights: Lights
    environment: Environment


def check_map(where: str, surroundings: EnvironmentMap, *, batched: bool = False) -> None:
    """Raise one line for what is no map, or for tables that cannot have been made of its texels."""
    fit_record(where, surroundings, EnvironmentMap, batched=batched)
    texels = list(surroundings.texels.shape)
    if 0 in texels[-3:]:
        raise ValueError(f"{where}.texels has none, its shape is {texels}")
    specular = next(rows for most, rows in SPECULAR_ROWS.items() if texels[-3] <= most)
    for name, rows in {"irradiance": IRRADIANCE_ROWS, "specular": specular}.items():
        shape = list(getattr(surroundings, name).shape)
        if shape[-2:] != [rows, CORNERS]:
            wanted = f"{where}.{name} must be [{rows}, {CORNERS}] for texels {texels}, got {shape}"
            raise ValueError(f"{wanted}; call environment.prepare.prepare(texels, suns)")


def check_scene(scene: Scene, camera: Camera, *, batched: bool = False) -> None:
    """Raise one line for what is no scene or no camera, or an index that names nothing, or an unexpected batch.

    Indices are looked at where they are known: outside of `jit`, or closed over.
    """
    fit_record("scene", scene, Scene, batched=batched)
    fit_record("camera", camera, Camera, batched=batched)
    if scene.environment.map is not None:
        check_map("scene.environment.map", scene.environment.map, batched=batched)
    below("scene.mesh.faces", scene.mesh.faces, scene.mesh.vertices.shape[-2], "vertices")
    below("scene.mesh.material", scene.mesh.material, scene.materials.double_sided.shape[0], "materials")
    if scene.materials.uv_sets is not None:
        below("scene.materials.uv_sets", scene.materials.uv_sets, 2, "sets of uvs")
        if scene.mesh.second_uvs is None:
            raise ValueError("scene.materials.uv_sets needs scene.mesh.second_uvs, which is None")
    for slot in TEXTURE_SLOTS:
        rows, count = getattr(scene.materials, f"{slot}_texture"), scene.textures.levels.shape[0]
        below(f"scene.materials.{slot}_texture", rows, count, "textures", least=-1)


LIGHT_KINDS = ("directional", "point", "spot")
AREA_KINDS = ("sphere", "disc", "rectangle")
TEXTURE_SLOTS = ("base_color", "metallic_roughness", "normal", "occlusion", "emissive")
REPEAT, CLAMP, MIRROR = 0, 1, 2
NEAREST, LINEAR, FIRST = 0, 1, 2
OPAQUE, MASK, BLEND = 0, 1, 2
# How `environment.irradiance` and `environment.prefilter` lay their tables out: three channels at each of a cell's four
# corners, and as many cells as fit the texels, of which there may be so many rows.
CORNERS, IRRADIANCE_ROWS = 12, 4096
SPECULAR_ROWS = {64: 36_864, 128: 86_016, 256: 233_472, float("inf"): 626_688}
