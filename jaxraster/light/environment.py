"""What a surface receives of an environment map, and what it mirrors of it: radiance in cd/m², without shadows.

Gradient: exact in the map, its rotation and α; in directions that of the interpolation.
Source: `math/harmonics`, `environment/prefilter`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..environment import octahedral, prefilter
from ..environment.equirect import turned
from ..environment.irradiance import CELLS
from ..math.harmonics import irradiance
from ..math.table import once
from ..scene import EnvironmentMap


def received(surroundings: EnvironmentMap, normal: Float[Array, "*b 3"], diffuse: str) -> Float[Array, "*b 3"]:
    """Irradiance over π, by "harmonics" or by the "map" of it."""
    direction = turned(normal, -surroundings.rotation)
    # Once, or where paths of light are added up a polynomial or three rows would be evaluated for each channel.
    if diffuse == "harmonics":
        return once(lambda normal, light: irradiance(light, normal), direction, surroundings.harmonics)
    return once(lambda normal, light: octahedral.lookup(light, normal, CELLS), direction, surroundings.irradiance)


def mirrored(
    surroundings: EnvironmentMap, direction: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b 3"]:
    """The mean radiance about a direction, weighed by a lobe of width α seen head on."""
    there = turned(direction, -surroundings.rotation)
    found = prefilter.mirrored(surroundings.specular, surroundings.texels.shape[0], there, alpha)
    # A blurred sun that was not cut out rings below zero; not a maximum, which would halve the gradient of darkness.
    return jnp.where(found < 0, 0.0, found)
