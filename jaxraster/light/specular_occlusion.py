"""How much of what a lobe mirrors of its surroundings is not occluded, told from how much of the diffuse light is.

For visibility V, clip((n·v + V)^p - 1 + V, 0, 1) with p = 2^(-16 α - 1): V itself for rough matter, and nearly 1 for
smooth matter seen from above, whose narrow lobe mostly misses what is near. 1 for V = 1.

It knows how much is hidden, not where. At the foot of a wall, in corners and pits it is off the share of the lobe that
is open, over all views, by 0.33 in the mean at roughness 0.1, 0.29 at 0.3 and 0.18 at 0.5, where V itself is off by
0.41, 0.32 and 0.18 (measured by the tests).

Gradient: exact but where the clip holds; 0 in n·v and V where their sum is 0.
Source: Lagarde & de Rousiers 2014, "Moving Frostbite to Physically Based Rendering", listing 26.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe

Value = Float[Array, "*b"]


def specular_occlusion(n_dot_v: Value, visibility: Value, alpha: Value) -> Value:
    """The share in [0, 1] of mirrored ambient light; α is the microfacet width, roughness².

    Example:
        >>> found = specular_occlusion(jnp.ones(2), jnp.full(2, 0.5), jnp.array([0.0, 0.25]))
        >>> [round(float(share), 4) for share in found]
        [0.7247, 0.5128]
    """
    power = jnp.exp2(-16.0 * alpha - 1.0)
    seen = jnp.clip(n_dot_v, 0.0, 1.0) + visibility
    # The power of 0 is 0; its slope is not finite.
    lit = seen > safe.TINY
    raised = jnp.where(lit, jnp.exp2(power * jnp.log2(jnp.where(lit, seen, 1.0))), 0.0)
    return jnp.clip(raised - 1.0 + visibility, 0.0, 1.0)
