"""Ambient light that reaches a pixel over its surroundings, where these have its own colour.

What occludes a pixel reflects light too. For an albedo ρ and the visibility V, the light is
V max(1, (a V + b) V + c), at most 1, with a = 2.0404 ρ - 0.3324, b = -4.7951 ρ + 0.6417 and c = 2.7552 ρ + 0.6903: V
for ρ = 0, to 2e-6, and 1 at V = 1.

Gradient: exact; at V = 0 and 1 that of the side within [0, 1].
Source: Jimenez, Wu, Pesce & Jarabo 2016, "Practical Real-Time Strategies for Accurate Indirect Occlusion", a fit to
path-traced scenes.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def bounced(visibility: Float[Array, "*b"], albedo: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """The share in [0, 1] of ambient light of each colour, at least the visibility.

    Example:
        >>> [round(float(light), 4) for light in bounced(jnp.array(0.5), jnp.array([0.0, 0.5, 0.8]))]
        [0.5, 0.681, 0.8111]
    """
    v = visibility[..., None]
    a, b, c = 2.0404 * albedo - 0.3324, -4.7951 * albedo + 0.6417, 2.7552 * albedo + 0.6903
    # Choose, for the slope of a maximum halves where both are the same: 1 is where nothing is occluded.
    gain = (a * v + b) * v + c
    light = jnp.where(gain > 1.0, gain, 1.0) * v
    return jnp.where(light > 1.0, 1.0, light)
