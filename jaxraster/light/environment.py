"""What a surface receives of an environment map, and what it mirrors of it: radiance in cd/m², without shadows.

Gradient: exact in the map, its rotation and α; in directions that of the interpolation.
Source: `math/harmonics`, `environment/prefilter`.
"""

from jaxtyping import Array, Float

from ..environment import octahedral, prefilter
from ..environment.equirect import turned
from ..environment.irradiance import CELLS
from ..math.harmonics import irradiance
from ..scene import EnvironmentMap


def received(surroundings: EnvironmentMap, normal: Float[Array, "*b 3"], diffuse: str) -> Float[Array, "*b 3"]:
    """Irradiance over π, by "harmonics" or by the "map" of it."""
    direction = turned(normal, -surroundings.rotation)
    if diffuse == "harmonics":
        return irradiance(surroundings.harmonics, direction)
    return octahedral.lookup(surroundings.irradiance, direction, CELLS)


def mirrored(
    surroundings: EnvironmentMap, direction: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b 3"]:
    """The mean radiance about a direction, weighed by a lobe of width α seen head on."""
    there = turned(direction, -surroundings.rotation)
    return prefilter.mirrored(surroundings.specular, surroundings.texels.shape[0], there, alpha)
