"""The rules by which a scene needs an effect, each with its reason in words.

A rule looks at concrete values on the host and errs towards "on": the picture under the plan equals the picture with
everything on. Under `wrt` no rule drops an effect for the *value* of a leaf that will be differentiated, because a
factor of zero still has a gradient. Gradient: none; plans are made outside of `jit`.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from ..light.ambient import Ambient
from ..light.area import Area
from ..light.background import Background
from ..light.emission import Emission
from ..light.shadow_frame import NARROW, WIDE
from ..light.shadow_map import ShadowMap
from ..light.sunlit import sunlit
from ..parameters import matches, parameters
from ..plan import Plan
from ..scene import AREA_KINDS, BLEND, LIGHT_KINDS, MASK, OPAQUE, TEXTURE_SLOTS, Camera, Scene, check_scene
from ..screen.horizon import HorizonAO
from ..surface.opacity import CUTOFF
from ..visibility.layers import Layers
from .occluders import may_darken
from .shadow import Light, View, members, plan_shadows, views
from .transparent import cut_out, shows_through

MAP = ("texels", "harmonics", "irradiance", "specular")  # what an environment's map lights surfaces with
ROUGH = 0.98  # from here on a lobe gathers linear light within 1 % of what the cosine does: 0.673 against 2/3
STRENGTH = {"directional": "irradiance", "point": "intensity", "spot": "intensity"}


class Reason(NamedTuple):
    """Whether an effect is on, and why."""

    on: bool
    why: str


class _Facts:
    """Concrete values of a scene, and whether they can matter: not zero, or differentiated."""

    def __init__(self, scene: Scene, camera: Camera, wrt: Sequence[str], asked: Plan):
        scene = replace(scene, lights=sunlit(scene.lights, scene.environment))
        self.scene, self.camera, self.wrt = jax.tree.map(np.asarray, scene), camera, wrt
        self.size, self.cull = {"height": asked.height, "width": asked.width}, asked.cull
        self.used = np.unique(self.scene.mesh.material)

    def differentiated(self, name: str) -> bool:
        return any(matches(f"scene.{name}", pattern) for pattern in self.wrt)

    def material(self, name: str) -> np.ndarray:
        """A material's factor `[..., used]`, as 0 or 1 where it cannot or can matter."""
        axis = 1 if name in ("base_color", "emissive") else 0
        values = getattr(self.scene.materials, name)
        if name == "base_color":
            # The alpha of what is drawn opaque says nothing.
            means = np.array([True, True, True, False]) | (self.modes() != OPAQUE)[:, None]
            values = np.where(means, values, 0)
        matter = (values != 0).any(axis=-1) if axis else values != 0
        return matter[..., self.used] | self.differentiated(f"materials.{name}")

    def modes(self) -> np.ndarray:
        """The alpha mode of every material."""
        materials = self.scene.materials
        modes = materials.alpha_mode
        return np.full_like(materials.base_color_texture, OPAQUE) if modes is None else modes

    def textured(self, slot: str) -> np.ndarray:
        return getattr(self.scene.materials, f"{slot}_texture")[self.used] >= 0

    def light(self, kind: str) -> np.ndarray:
        """Which lights of a kind can shine."""
        name = STRENGTH[kind]
        values = getattr(getattr(self.scene.lights, kind), name)
        suns = kind == "directional" and self.differentiated("environment.map.suns.irradiance")
        return (values != 0).any(axis=-1) | self.differentiated(f"lights.{kind}.{name}") | suns

    def area_kinds(self) -> tuple[str, ...]:
        """The kinds of lights with an area that can shine."""
        kinds = []
        for kind in AREA_KINDS:
            lights = getattr(self.scene.lights, kind)
            if lights is not None and ((lights.radiance != 0).any() or self.differentiated(f"lights.{kind}.radiance")):
                kinds.append(kind)
        return tuple(kinds)

    def view_moves(self) -> bool:
        """Whether a surface or the camera is differentiated."""
        names = ("scene.mesh.vertices", "camera.world_from_view", "camera.clip_from_view")
        return any(matches(name, pattern) for name in names for pattern in self.wrt)

    def moves(self) -> bool:
        """Whether these, or a light's place or direction, are."""
        names = ("lights.directional.direction", "lights.point.position", "lights.spot.position")
        names += ("lights.spot.direction", "environment.map.suns.direction", "environment.map.rotation")
        return self.view_moves() or any(self.differentiated(name) for name in names)

    def surroundings(self) -> bool:
        """Whether light comes from all around."""
        around = self.scene.environment
        values = {"sky": around.sky, "ground": around.ground}
        if around.map is not None:
            values |= {f"map.{name}": getattr(around.map, name) for name in MAP}
        return any((value != 0).any() or self.differentiated(f"environment.{n}") for n, value in values.items())

    def suns(self) -> bool:
        """Whether any sun of the surroundings shines."""
        around = self.scene.environment.map
        if around is None or around.suns.irradiance.size == 0:
            return False
        return bool((around.suns.irradiance != 0).any()) or self.differentiated("environment.map.suns.irradiance")

    def smooth(self) -> bool:
        """Whether a material in view mirrors more sharply than the widest lobe."""
        materials, rows = self.scene.materials, self.used
        if not self.view_moves():
            faces = [v.faces[face] for v in self.views for face, _ in v.receivers]
            rows = np.unique(self.scene.mesh.material[faces])
        textured = materials.metallic_roughness_texture[rows] >= 0
        sharp = (textured | (materials.roughness[..., rows] < ROUGH)).any()
        coated = materials.clearcoat is not None and (materials.clearcoat[..., rows, 0] != 0).any()
        names = ("materials.roughness", "materials.clearcoat")
        return bool(sharp or coated) or any(self.differentiated(name) for name in names)

    @functools.cached_property
    def views(self) -> list[View]:
        """What each camera sees."""
        mesh = self.scene.mesh
        culled = self.cull & ~self.scene.materials.double_sided[mesh.material]
        return views(mesh.vertices, mesh.faces, culled, self.camera, self.size)


def _layers(facts: _Facts) -> tuple[Layers | None, Reason]:
    scene, modes = facts.scene, facts.modes()
    masked, blended = (facts.used[modes[facts.used] == mode].tolist() for mode in (MASK, BLEND))
    if len(masked) + len(blended) == 0:
        return None, Reason(False, "no material in use is masked or blended")
    cutoffs = np.full(modes.shape, CUTOFF) if scene.materials.alpha_cutoff is None else scene.materials.alpha_cutoff
    alphas = ("materials.base_color", "materials.alpha_cutoff", "textures.texels", "mesh.colors")
    moves = any(facts.differentiated(name) for name in alphas)
    holes = sum(moves or cut_out(scene, row, float(np.max(cutoffs[..., row]))) for row in masked)
    clear = sum(moves or shows_through(scene, row) for row in blended)
    if holes + clear == 0:
        return None, Reason(False, "every masked or blended material in use is opaque wherever it is")
    # At most as many blended triangles lie in front of each other as there are.
    depth = min(Layers().blended, int(np.isin(scene.mesh.material, blended).sum()))
    words = [f"materials with holes: {holes}"] if holes else []
    words += [f"blended ones: {len(blended)}, of which {depth} layers are kept"] if len(blended) else []
    return Layers(blended=depth, masked=bool(holes)), Reason(True, ", ".join(words))


def _texture_slot(facts: _Facts, slot: str, ambient: bool) -> Reason:
    factors = {
        "base_color": ("base_color",),
        "metallic_roughness": ("metallic", "roughness"),
        "normal": (),
        "occlusion": ("occlusion_strength",),
        "emissive": ("emissive",),
    }[slot]
    textured = facts.textured(slot)
    if not textured.any():
        return Reason(False, "no material in use has such a texture")
    # Keep any normal map: flattened by a scale of 0 it still turns normals where its blue is below one half.
    matter = functools.reduce(np.logical_or, (facts.material(name) for name in factors)) if factors else textured
    if not (matter & textured).any():
        return Reason(False, f"every such texture is multiplied by {' and '.join(factors)} of zero")
    if slot == "occlusion" and not ambient:
        return Reason(False, "it darkens ambient light alone, and there is none")
    count = int((matter & textured).reshape(-1, textured.size).any(axis=0).sum())
    return Reason(True, f"fetched by {count} material{'s' if count > 1 else ''}")


def _shadow(facts: _Facts, shading: str) -> tuple[ShadowMap | None, Reason]:
    if shading == "local":
        return None, Reason(False, "local shading has no visibility of lights")
    lights = []
    for kind in STRENGTH:
        every, shining = getattr(facts.scene.lights, kind), facts.light(kind)
        places = every.position if kind != "directional" else every.direction
        # Light without a direction shines on nothing.
        shining = shining & ((places != 0).any(axis=-1) | (kind != "directional"))
        shining = np.atleast_1d(shining.any(axis=tuple(range(shining.ndim - 1))))
        for row in np.flatnonzero(shining).tolist():
            tangent = float(np.tan(np.clip(np.max(every.outer[..., row]), NARROW, WIDE))) if kind == "spot" else 1.0
            lights.append(Light(kind, row, members(places, 2)[:, row], tangent))
    if not lights:
        return None, Reason(False, "no light that throws shadows shines")
    moves = facts.moves()
    settings, why = plan_shadows(lights, [] if moves else facts.views, moves)
    return settings, Reason(settings is not None, why)


def _occlusion(facts: _Facts, lit: bool, shading: str) -> Reason:
    if shading == "local":
        return Reason(False, "local shading has no visibility of lights")
    if not lit:
        return Reason(False, "it darkens ambient light alone, and there is none")
    if facts.view_moves():
        return Reason(True, "what is differentiated may move something before the sky of a surface in view")
    reach = float(HorizonAO().radius)
    verdicts = {may_darken(v.triangles, v.receivers, v.culled, v.eye, v.size, reach) for v in facts.views}
    if True in verdicts:
        return Reason(True, f"what rises within {reach} m of a surface in view hides some of its sky")
    if None in verdicts:
        return Reason(True, "too many faces to prove that none rises above a surface in view")
    return Reason(False, f"nothing rises within {reach} m of any surface in view")


def _specular(facts: _Facts, lit: bool) -> Reason:
    if not lit:
        return Reason(False, "there is no ambient light")
    if facts.scene.environment.map is None:
        return Reason(False, "the environment has no map to mirror")
    smooth = facts.smooth()
    return Reason(smooth, f"{'a' if smooth else 'no'} material in view is smoother than a roughness of {ROUGH}")


def plan_for(
    scene: Scene, camera: Camera, *, width: int = 640, height: int = 480, wrt: Sequence[str] = (), **settings: Any
) -> tuple[Plan, dict[str, Reason]]:
    """The least plan that draws `scene` as the fullest one would, and the reason for every effect in it or not.

    Batches (leading axes of scene or camera) get the union of what their members need. `wrt` names the leaves, as in
    `parameters`, in which the picture will be differentiated: without it an effect whose factor is 0 is left out, and
    its gradient with it. A plan holds for the cameras it was made for. Any other field of `Plan` may be given and is
    taken as it is.

    Example:
        >>> from jaxraster import scenes
        >>> plan, reasons = plan_for(*scenes.cornell_box(), width=64, height=64)
        >>> reasons["ambient"]
        Reason(on=False, why='the environment is black')
    """
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((scene, camera))):
        raise TypeError(
            "plan_for looks at concrete values: call it outside of jit, vmap and grad, and pass the plan in"
        )
    check_scene(scene, camera, batched=True)
    wrt = (wrt,) if isinstance(wrt, str) else tuple(wrt)
    parameters({"scene": scene, "camera": camera}, wrt)
    asked = Plan(height=height, width=width, **settings)
    facts = _Facts(scene, camera, wrt, asked)
    reasons: dict[str, Reason] = {}

    # Decide on light first: what it reaches decides the rest.
    single_sided = (~facts.scene.materials.double_sided[facts.used]).any()
    some = "some" if single_sided else "no"
    reasons["cull"] = Reason(bool(single_sided), f"{some} material in use is single-sided")
    lit = facts.surroundings()
    tones = "has light" if lit else "is black"
    seen_through, reasons["layers"] = _layers(facts)
    for slot in TEXTURE_SLOTS:
        reasons[f"texture {slot}"] = _texture_slot(facts, slot, lit)
    for kind in LIGHT_KINDS:
        count, shining = facts.light(kind).shape[-1], facts.light(kind).any()
        reasons[f"light {kind}"] = Reason(
            bool(shining), f"{count} in the scene" + ("" if shining or not count else ", all black")
        )
    shadow, reasons["shadow_map"] = _shadow(facts, asked.shading)
    unlit = facts.scene.materials.unlit
    emits = facts.material("emissive").any() or (unlit is not None and unlit[facts.used].any())
    kinds = () if asked.shading == "local" else facts.area_kinds()
    glowing = f"lights with an area: {', '.join(kinds)}" if kinds else "no light with an area shines"
    reasons["area"] = Reason(bool(kinds), glowing)
    reasons["emission"] = Reason(bool(emits), f"{'a' if emits else 'no'} material in use emits light")
    reasons["occlusion"] = _occlusion(facts, lit and asked.ambient is not None, asked.shading)
    reasons["ambient"] = Reason(lit, f"the environment {tones}")
    reasons["ambient specular"] = _specular(facts, lit and asked.ambient is not None)
    shown = lit or facts.suns()
    reasons["background"] = Reason(shown, f"the environment {tones if lit or not shown else 'has a sun'}")
    reasons["dither"] = Reason(False, "only on request")

    chosen: dict[str, Any] = {
        "cull": reasons["cull"].on,
        "texture_slots": tuple(slot for slot in TEXTURE_SLOTS if reasons[f"texture {slot}"].on),
        "light_kinds": tuple(kind for kind in LIGHT_KINDS if reasons[f"light {kind}"].on),
        "layers": seen_through,
        "shadow_map": shadow,
        "area": Area(kinds=kinds) if kinds else None,
        "emission": Emission() if emits else None,
        "occlusion": HorizonAO() if reasons["occlusion"].on else None,
        "ambient": Ambient(specular=reasons["ambient specular"].on) if lit else None,
        "background": Background() if shown else None,
    }
    plan = replace(asked, **{name: value for name, value in chosen.items() if name not in settings})
    for name in settings.keys() & reasons.keys():
        reasons[name] = Reason(settings[name] not in (None, False), "as asked for")
    if isinstance(asked.ambient, Ambient) and "ambient" in settings:
        reasons["ambient specular"] = Reason(asked.ambient.specular, "as asked for")
    for name, word, known in (("texture_slots", "texture", TEXTURE_SLOTS), ("light_kinds", "light", LIGHT_KINDS)):
        if name in settings:
            reasons |= {f"{word} {member}": Reason(member in settings[name], "as asked for") for member in known}
    return plan, reasons
