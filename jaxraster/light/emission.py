"""Light that surfaces give off themselves.

Radiance in cd/m², the same in all directions; it lights nothing else. Unlit materials show their base colour this way,
so without the effect they are black. A clear coat keeps its share inside. Does not affect: direct and ambient light.

Gradient: exact.
Source: glTF 2.0 specification, 3.9.3; KHR_materials_emissive_strength and _clearcoat.
"""

from jaxtyping import Array, Float

from ..brdf.clearcoat import clearcoat_share
from ..buffers import Surface
from ..math import safe
from ..record import Scalar, record


@record
class Emission:
    """`gain` multiplies what materials emit."""

    gain: Scalar = 1.0


def emission(surface: Surface, settings: Emission) -> Float[Array, "*b 3"]:
    """Emitted radiance."""
    emitted = settings.gain * surface.emissive
    if surface.coat is None:
        return emitted
    share = clearcoat_share(safe.dot(surface.coat.normal, surface.view), surface.coat.weight)
    return (1.0 - share)[..., None] * emitted
