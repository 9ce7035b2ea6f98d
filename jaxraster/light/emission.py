"""Light that surfaces give off themselves.

Radiance in cd/m², the same in all directions; it lights nothing else. Unlit materials show their base colour this way,
so without the effect they are black. Does not affect: direct and ambient light.

Gradient: exact.
Source: glTF 2.0 specification, 3.9.3; KHR_materials_emissive_strength.
"""

from jaxtyping import Array, Float

from ..buffers import Surface
from ..record import Scalar, record


@record
class Emission:
    """`gain` multiplies what materials emit."""

    gain: Scalar = 1.0


def emission(surface: Surface, settings: Emission) -> Float[Array, "*b 3"]:
    """Emitted radiance."""
    return settings.gain * surface.emissive
