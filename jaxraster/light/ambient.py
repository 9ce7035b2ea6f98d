"""Ambient light from a two-tone environment, unoccluded but for the material's own occlusion.

Diffuse: irradiance over π is ground + (sky - ground)·(1 + n·up)/2, exact for two half spaces. Specular: the tone a lobe
of width alpha about the mirror direction r gathers, times the directional albedo of all bounces, which leaves the rest
to the diffuse: in uniform surroundings what is white cannot be told from them. The sky's share of that lobe
is ½ + ½ r·up / √((r·up)² + w² (1 - (r·up)²)) with w = 2α/(1 + α), for mirroring doubles a half vector's tilt: a step
for a mirror and the cosine's (1 + r·up)/2 at alpha = 1, both exact, and between them off the GGX lobe seen head on by
at most 0.01 (measured by the tests). Radiance in cd/m². Does not affect: direct light.

Gradient: exact in tones, normal, view and material.
Source: hemisphere lighting as in Baker & Boyd 2001; the blend between its two exact ends is ours.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..brdf.clearcoat import clearcoat_share
from ..brdf.compensation import compensated_albedo
from ..brdf.sheen import sheen_albedo
from ..buffers import Surface
from ..math import safe
from ..record import Scalar, record
from ..scene import Environment


@record
class Ambient:
    """`gain` multiplies both tones."""

    gain: Scalar = 1.0


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


def ambient(
    surface: Surface, environment: Environment, settings: Ambient
) -> tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]:
    """Diffuse and specular radiance."""
    n, v = surface.normal, surface.view
    n_dot_v = safe.dot(n, v)
    mirror = 2.0 * n_dot_v[..., None] * n - v
    albedo = compensated_albedo(surface.f0, n_dot_v, surface.alpha, surface.f90)
    gain = (settings.gain * surface.occlusion)[..., None]
    diffuse = surface.diffuse_color * (1.0 - albedo) * tones(environment, n, jnp.ones_like(n_dot_v))
    specular = albedo * tones(environment, mirror, surface.alpha)
    if surface.sheen is not None:
        color, share = surface.sheen[..., :3], sheen_albedo(jnp.clip(n_dot_v, 0.0, 1.0), surface.sheen[..., 3])
        under = 1.0 - (jnp.max(color, axis=-1) * share)[..., None]
        glow = color * share[..., None] * tones(environment, n, jnp.ones_like(n_dot_v))
        diffuse, specular = under * diffuse, under * specular + glow
    if surface.coat is not None:
        n_dot_v = safe.dot(surface.coat.normal, v)
        share = clearcoat_share(n_dot_v, surface.coat.weight)[..., None]
        mirror = 2.0 * n_dot_v[..., None] * surface.coat.normal - v
        mirrored = share * tones(environment, mirror, surface.coat.alpha)
        diffuse, specular = (1.0 - share) * diffuse, (1.0 - share) * specular + mirrored
    return gain * diffuse, gain * specular
