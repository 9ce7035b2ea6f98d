"""All light paths together: Radiance + background -> linear HDR.

Layers are laid over each other in linear light: front to back Σ T_k α_k L_k, with the opacity α_k of each, and what
those in front of it let through, T_k = Π_{i<k} (1 - α_i); the background comes last.

Gradient: exact in every part and in the opacities; the mask has none.
Source: Porter & Duff 1984, "Compositing Digital Images", the operator "over", for colours not multiplied by alpha.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from .buffers import Radiance


def _over(total, mask, opacity, behind):
    """Layers laid over what is behind them, the last one first."""

    def lay(behind, layer):
        light, seen, alpha = layer
        return jnp.where(seen, alpha * light + (1.0 - alpha) * behind, behind), None

    return lax.scan(lay, behind, (total, mask[..., None], opacity[..., None]), reverse=True)[0]


def resolve(
    radiance: Radiance,
    mask: Bool[Array, "*l h w"],
    background: Float[Array, "*b h w 3"] | None,
    supersample: int,
    opacity: Float[Array, "l h w"] | None = None,
) -> Float[Array, "*b H W 3"]:
    """The sum of all paths where there is a surface, the background elsewhere (black for None), averaged per pixel.

    With `opacity`, surfaces have a leading axis of layers, the foremost first. Samples are averaged as light, before
    any curve: a pixel half covered by white is half as bright as white.
    """
    direct = radiance.direct_diffuse + radiance.direct_specular
    total = direct + radiance.indirect_diffuse + radiance.indirect_specular + radiance.emitted
    behind = jnp.zeros_like(total if opacity is None else total[0]) if background is None else background
    hdr = jnp.where(mask[..., None], total, behind) if opacity is None else _over(total, mask, opacity, behind)
    if supersample == 1:
        return hdr
    *batch, height, width, channels = hdr.shape
    samples = hdr.reshape(*batch, height // supersample, supersample, width // supersample, supersample, channels)
    return jnp.mean(samples, axis=(-4, -2))
