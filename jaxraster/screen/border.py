"""How much of what lies near the picture's border occludes: less, so that nothing vanishes at once as it leaves.

min(1, d / band)² for the distance d from the nearest side of the picture, in pixels; 0 outside. It weighs what
occludes, not what is occluded: what a camera's turn drives out of the picture lets go of all pixels little by little,
and pixels at the border still receive what the picture knows. Were occlusion itself faded there, pixels farther inside
would lose at once what leaves within their radius, and a bright frame would stay. A square, for horizons rise steeply
with the first of what counts.

Gradient: exact; `occlusion` stops it. Source: our own.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

# No pixel's centre is nearer to the border, so that a lesser band fades nothing; and 0 divides nothing.
LEAST = 0.5


def remaining(at: Float[Array, "*b"], size: int, band: float | Float[Array, ""]) -> Float[Array, "*b"]:
    """The share in [0, 1] of what lies at this column of so many, or line; of a pixel's two the lesser counts.

    Example:
        >>> remaining(jnp.array([-0.5, 0.0, 1.5, 2.0, 9.5]), 10, jnp.array(2.0)).tolist()
        [0.0, 0.0625, 1.0, 1.0, 0.0]
    """
    distance = 0.5 + jnp.minimum(at, size - 1.0 - at)
    return jnp.clip(distance / jnp.maximum(band, LEAST), 0.0, 1.0) ** 2
