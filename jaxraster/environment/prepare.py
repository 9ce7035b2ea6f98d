"""A picture of surroundings made ready to light surfaces, once, by one compiled function.

Gradient: exact in the texels, of which all but the suns is linear.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..check import fit
from ..record import Scalar
from ..scene import Directional, EnvironmentMap
from .irradiance import coefficients, irradiance
from .prefilter import prefilter


@jax.jit
def prepare(texels: Float[Array, "h w 3"], suns: Directional | None = None, rotation: Scalar = 0.0) -> EnvironmentMap:
    """Radiance (cd/m²) in equirectangular projection, of any size, with all that is looked up of it.

    `suns` are directional lights that have been cut out of the texels; `rotation` (rad) turns both about +Y.
    `harmonics` are the nine coefficients of `math.harmonics`, `irradiance` a table of `octahedral` of irradiance over
    π, `specular` the tables of `prefilter`, one after the other. Texels are to be finite: one that is not spoils all.

    Example:
        >>> ready = prepare(jnp.ones((4, 8, 3)))
        >>> ready.specular.shape[0], ready.harmonics.shape
        (36864, (9, 3))
    """
    fit("prepare: texels", texels, Float[Array, "h w 3"], batched=False)
    if suns is None:
        suns = Directional(direction=jnp.zeros((0, 3), texels.dtype), irradiance=jnp.zeros((0, 3), texels.dtype))
    return EnvironmentMap(
        texels=texels,
        rotation=jnp.asarray(rotation, texels.dtype),
        suns=suns,
        harmonics=coefficients(texels),
        irradiance=irradiance(texels),
        specular=prefilter(texels),
    )
