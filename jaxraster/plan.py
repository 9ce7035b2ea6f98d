"""What is compiled, and the knobs of what is compiled, in one value.

A Plan's treedef (sizes, names, which effects there are) keys compilation; its leaves (exposure, biases, gains) are
traced. Turning a knob compiles nothing; an effect that is None leaves nothing in the program.
"""

from typing import get_args

import jax
import jax.numpy as jnp

from .check import fit_knobs
from .display.dither import Dither
from .display.tonemap import TONEMAPS
from .light.ambient import Ambient
from .light.area import Area
from .light.background import Background
from .light.emission import Emission
from .light.shadow_map import ShadowMap
from .record import Scalar, record, static
from .scene import LIGHT_KINDS, TEXTURE_SLOTS, Camera, Scene, check_scene
from .screen.horizon import HorizonAO
from .screen.ssao import SSAO
from .visibility.layers import Layers

SHADINGS = ("standard", "gltf", "local")
EFFECTS = {
    "layers": Layers,
    "shadow_map": ShadowMap,
    "area": Area,
    "occlusion": HorizonAO | SSAO,
    "ambient": Ambient,
    "emission": Emission,
    "background": Background,
    "dither": Dither,
}


@record
class Plan:
    """How a scene is drawn.

    `supersample` takes its square of samples per pixel. `shading` is "standard" (microfacets and all bounces
    between them), "gltf" (the specification's plain formula, as other viewers show it) or "local" (Blinn–Phong and no
    visibility of lights: no shadow). `light_kinds` and `texture_slots` name what is evaluated and fetched;
    `cull` drops the back faces of materials that are not double-sided. `layers` cuts out masked materials and lets
    what is behind blended ones show through; None draws both opaque. `occlusion` darkens the ambient light where what
    is on the screen is in its way. `exposure` in EV, each doubling the light.
    """

    width: int = static(default=640)
    height: int = static(default=480)
    supersample: int = static(default=1)
    shading: str = static(default="standard")
    cull: bool = static(default=True)
    texture_slots: tuple = static(default=TEXTURE_SLOTS)
    light_kinds: tuple = static(default=LIGHT_KINDS)
    layers: Layers | None = None
    shadow_map: ShadowMap | None = None
    area: Area | None = None
    occlusion: HorizonAO | SSAO | None = None
    ambient: Ambient | None = Ambient()
    emission: Emission | None = Emission()
    background: Background | None = Background()
    exposure: Scalar = 0.0
    tonemap: str = static(default="pbr_neutral")
    dither: Dither | None = None

    def validate(self):
        """Raise one clear line for a size, name or combination that means nothing."""
        for name in ("width", "height", "supersample"):
            value = getattr(self, name)
            if type(value) is not int or value < 1:
                raise ValueError(f"Plan.{name} must be a whole number of at least 1, got {value!r}")
        if type(self.cull) is not bool:
            raise ValueError(f"Plan.cull must be True or False, got {self.cull!r}")
        for name, kind in EFFECTS.items():
            if not isinstance(getattr(self, name), kind | None):
                names = " or ".join(f"{one.__name__}(...)" for one in get_args(kind) or (kind,))
                raise ValueError(f"Plan.{name} must be None or {names}, got {getattr(self, name)!r}")
        for name, known in (("shading", SHADINGS), ("tonemap", tuple(TONEMAPS))):
            if getattr(self, name) not in known:
                raise ValueError(f"Plan.{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")
        for name, known in (("texture_slots", TEXTURE_SLOTS), ("light_kinds", LIGHT_KINDS)):
            names = getattr(self, name)
            if not isinstance(names, tuple):
                raise ValueError(f"Plan.{name} must be a tuple of names, got {names!r}")
            if unknown := set(names) - set(known):
                raise ValueError(f"Plan.{name} may hold {', '.join(known)}, got {', '.join(sorted(map(str, unknown)))}")
            if twice := {one for one in names if names.count(one) > 1}:
                raise ValueError(f"Plan.{name} names {', '.join(sorted(twice))} twice, got {names}")
        for name in ("shadow_map", "area", "occlusion"):
            if self.shading == "local" and getattr(self, name) is not None:
                raise ValueError(f'Plan.{name} must be None where Plan.shading is "local", which knows lights alone')


def as_arrays(scene: Scene, camera: Camera, plan: Plan) -> tuple[Scene, Camera]:
    """Scene and camera as JAX arrays, the camera in the precision of the mesh; or one line for what has no picture."""
    check_scene(scene, camera)
    fit_knobs("plan", plan, Plan)
    scene = jax.tree.map(jnp.asarray, scene)
    return scene, jax.tree.map(lambda matrix: jnp.asarray(matrix, scene.mesh.vertices.dtype), camera)
