"""All light paths together: Radiance + background -> linear HDR.

Gradient: exact in every part; the mask has none.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .buffers import Radiance


def resolve(
    radiance: Radiance, mask: Bool[Array, "*b h w"], background: Float[Array, "*b h w 3"] | None, supersample: int
) -> Float[Array, "*b H W 3"]:
    """The sum of all paths where there is a surface, the background elsewhere (black for None), averaged per pixel.

    Samples are averaged as light, before any curve: a pixel half covered by white is half as bright as white.
    """
    direct = radiance.direct_diffuse + radiance.direct_specular
    total = direct + radiance.indirect_diffuse + radiance.indirect_specular + radiance.emitted
    behind = jnp.zeros_like(total) if background is None else background
    hdr = jnp.where(mask[..., None], total, behind)
    if supersample == 1:
        return hdr
    *batch, height, width, channels = hdr.shape
    samples = hdr.reshape(*batch, height // supersample, supersample, width // supersample, supersample, channels)
    return jnp.mean(samples, axis=(-4, -2))
