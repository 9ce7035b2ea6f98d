"""How much nearer to the light a texel must be to shadow a receiver.

A map holds its casters' depths at the texels' centres alone, and a plane that light grazes rises by tan θ texels from
one to the next. Each cure is a knob, and the biases add up, in units of depth:

    constant_bias · a texel's width  +  slope_bias · (|rise in x| + |rise in y|) per texel
    +  receiver_plane · max(0, the receiver's own plane at the texel's centre - at the receiver)

The last one is exact for a plane: at a centre its map holds just what its plane says, but for the snapping of corners
to 1/256 texel. It is never negative: at the foot of a wall that light grazes, the wall's plane goes on below the floor,
which must not shadow the wall.
`normal_offset` moves the receiver off its surface instead, by so many texels times sin θ.

Gradient: of these formulas; `shadow_map` stops it.
Source: slope bias as in Direct3D 11's "Depth Bias"; receiver plane: Isidoro 2006, "Shadow Mapping: GPU-based Tips and
Techniques" (here from the triangle, not from screen differences); normal offset: Holbert 2011, "Saying Goodbye to
Shadow Acne".
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe
from .shadow_frame import Knob, LightView, Receiver, local


def offset_along_normal(
    view: LightView, position: Float[Array, "*b 3"], normal: Float[Array, "*b 3"], amount: Knob
) -> Float[Array, "*b 3"]:
    """Positions moved to the light's side of their surface by `amount` texels times the sine of its incidence."""
    towards = jnp.broadcast_to(view.axes[2], position.shape)
    if view.central:
        towards = safe.unit(jnp.broadcast_to(view.origin, position.shape) - position)
    cosine = safe.dot(normal, towards)
    sine = safe.sqrt(1.0 - jnp.minimum(cosine * cosine, 1.0))
    texel = jnp.max(view.texel) * jnp.maximum(local(view, position)[1], 0.0)
    return position + (jnp.where(cosine < 0, -amount, amount) * texel * sine)[..., None] * normal


def base_bias(place: Receiver, constant_bias: Knob, slope_bias: Knob) -> Float[Array, "*b"]:
    """The bias that all texels share, in depth."""
    return constant_bias * place.unit + slope_bias * (jnp.abs(place.slope_x) + jnp.abs(place.slope_y))


def plane_bias(
    place: Receiver, x: Float[Array, "*b"], y: Float[Array, "*b"], receiver_plane: Knob
) -> Float[Array, "*b"]:
    """What the receiver's plane rises up to a place (x, y) of the map, in depth, and at least 0."""
    rise = place.slope_x * (x - place.x) + place.slope_y * (y - place.y)
    return receiver_plane * jnp.maximum(rise, 0.0)
