"""Ambient light from the surroundings, two tones and a map, less what the material or the screen says is occluded.

Diffuse: irradiance over π. Of the tones it is ground + (sky - ground)·(1 + n·up)/2, exact for two half spaces; of the
map see `environment`. Specular: what a lobe of width alpha about the direction r of `reflection` gathers, times the
directional albedo of all bounces, which leaves the rest to the diffuse: in uniform surroundings what is white cannot be
told from them. The sky's share of that lobe is ½ + ½ r·up / √((r·up)² + w² (1 - (r·up)²)) with w = 2α/(1 + α), for
mirroring doubles a half vector's tilt: a step for a mirror and the cosine's (1 + r·up)/2 at alpha = 1, both exact, and
between them off the GGX lobe seen head on by at most 0.01 (measured by the tests). That lobe stands for those seen from
aside, which are longer. Of what the screen occludes, `bounced` gives back what bounces off the surface's own colour,
`specular_occlusion` what narrow lobes miss, and irradiance comes from the bent normal; a material's occlusion alone is
a plain factor, as glTF has it. Radiance in cd/m². Does not affect: direct light.

Gradient: exact in tones, map, normal, view and material, of these formulas.
Source: hemisphere lighting as in Baker & Boyd 2001; the blend between its two exact ends is ours. The split into what
a lobe gathers and its albedo: Karis 2013, "Real Shading in Unreal Engine 4".
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..brdf.clearcoat import clearcoat_share
from ..brdf.compensation import compensated_albedo
from ..brdf.sheen import sheen_albedo
from ..buffers import Occlusion, Surface
from ..math import safe
from ..math.table import once
from ..record import Scalar, record, static
from ..scene import Environment
from .bounced import bounced
from .environment import mirrored, received
from .reflection import reflection
from .specular_occlusion import specular_occlusion

Color = Float[Array, "*b 3"]
Number = Float[Array, "*b"]
DIFFUSE = "harmonics", "map"


@record
class Ambient:
    """`gain` multiplies all of it.

    Irradiance of a map comes from nine "harmonics", which leave out 1 % of natural light, more of a strong one from one
    side, or from a "map" of its own, exact but slower: `diffuse`. `specular` mirrors the map as sharply as the surface
    does; without it the map of irradiance stands in, as if all were rough: at a roughness of 0.98 1 % off under light
    that is linear in the direction, 5 % of its greatest under a window 10° wide.
    """

    gain: Scalar = 1.0
    diffuse: str = static(default="harmonics")
    specular: bool = static(default=True)

    def validate(self):
        """Raise one clear line for a name that means nothing."""
        if self.diffuse not in DIFFUSE:
            raise ValueError(f"Ambient.diffuse must be one of {', '.join(DIFFUSE)}, got {self.diffuse!r}")
        if type(self.specular) is not bool:
            raise ValueError(f"Ambient.specular must be True or False, got {self.specular!r}")


def sky_share(cosine: Float[Array, "*b"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """The sky's share of a lobe of width alpha whose axis makes `cosine` with up. Gradient: exact for alpha > 0."""
    width = 2.0 * alpha / (1.0 + alpha)
    w2 = width * width
    return 0.5 + 0.5 * safe.divide(cosine, safe.sqrt(cosine * cosine * (1.0 - w2) + w2))


def tones(environment: Environment, direction: Float[Array, "*b 3"], alpha: Float[Array, "*b"]) -> Float[Array, "*b 3"]:
    """The environment's radiance, blurred by a lobe of width alpha about each direction."""
    up, sky, ground = (
        jnp.broadcast_to(t, direction.shape)
        for t in (safe.normalize(environment.up), environment.sky, environment.ground)
    )
    return ground + (sky - ground) * sky_share(safe.dot(direction, up), alpha)[..., None]


def _gathered(environment: Environment, n: Color, settings: Ambient) -> Float[Array, "*b 3"]:
    """Irradiance over π."""
    light = tones(environment, n, jnp.ones_like(n[..., 0]))
    return light if environment.map is None else light + received(environment.map, n, settings.diffuse)


def _reflected(environment: Environment, n: Color, v: Color, alpha: Number, settings: Ambient) -> Float[Array, "*b 3"]:
    """What a surface of that alpha mirrors towards v."""
    direction = once(reflection, n, v, alpha)
    light = tones(environment, direction, alpha)
    if environment.map is None:
        return light
    if not settings.specular:
        return light + received(environment.map, direction, "map")
    return light + mirrored(environment.map, direction, alpha)


def _scattered(surface: Surface, occlusion: Occlusion | None) -> Float[Array, "*b 3"]:
    """The share of light from all around that reaches the surface to be scattered: the darker of what the material
    says and of what the screen says."""
    own = jnp.broadcast_to(surface.occlusion[..., None], surface.diffuse_color.shape)
    if occlusion is None:
        return own
    found = bounced(occlusion.visibility, surface.diffuse_color)
    return jnp.where(own <= found, own, found)


def _narrowed(surface: Surface, n_dot_v: Number, alpha: Number, occlusion: Occlusion | None) -> Float[Array, "*b 1"]:
    """The same of light to be mirrored by a lobe of that alpha."""
    own = surface.occlusion
    if occlusion is None:
        return own[..., None]
    found = specular_occlusion(n_dot_v, occlusion.visibility, alpha)
    return jnp.where(own <= found, own, found)[..., None]


@jax.jit
def ambient(
    surface: Surface, environment: Environment, settings: Ambient, *, occlusion: Occlusion | None = None
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular radiance."""
    n, v = surface.normal, surface.view
    n_dot_v = safe.dot(n, v)
    albedo = once(compensated_albedo, surface.f0, n_dot_v, surface.alpha, surface.f90)
    gathered = _gathered(environment, n if occlusion is None else occlusion.bent_normal, settings)
    arriving = settings.gain * _scattered(surface, occlusion) * gathered
    diffuse = surface.diffuse_color * (1.0 - albedo) * arriving
    seen = _narrowed(surface, n_dot_v, surface.alpha, occlusion)
    specular = settings.gain * seen * albedo * _reflected(environment, n, v, surface.alpha, settings)
    if surface.sheen is not None:
        color, share = surface.sheen[..., :3], sheen_albedo(jnp.clip(n_dot_v, 0.0, 1.0), surface.sheen[..., 3])
        under = 1.0 - (jnp.max(color, axis=-1) * share)[..., None]
        diffuse, specular = under * diffuse, under * specular + color * share[..., None] * arriving
    if surface.coat is not None:
        coat, coat_dot_v = surface.coat, safe.dot(surface.coat.normal, v)
        share = clearcoat_share(coat_dot_v, coat.weight)[..., None]
        seen = settings.gain * _narrowed(surface, coat_dot_v, coat.alpha, occlusion)
        mirrored_by_coat = seen * share * _reflected(environment, coat.normal, v, coat.alpha, settings)
        diffuse, specular = (1.0 - share) * diffuse, (1.0 - share) * specular + mirrored_by_coat
    return diffuse, specular
