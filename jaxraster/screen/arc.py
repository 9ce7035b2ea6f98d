"""What is seen between two horizons of a slice: cosine-weighted arcs, and the mean direction of what is seen.

A slice is a half plane on either side of the direction v to the viewer. On a side, all is seen from v to the horizon,
at the angle h with the cosine c and the sine s. With (n·v, n·d) the normal's parts in the slice, d to that side,
∫₀ʰ (n·ω) sin θ dθ = ½ (n·v s² + n·d (h - s c)), which is Jimenez' ¼ (-cos(2h - γ) + cos γ + 2h sin γ) times the length
of the projected normal, without its angle γ. Likewise ∫₀ʰ (n·ω) ω sin θ dθ has the parts ⅓ (n·v (1 - c³) + n·d s³)
along v and ⅓ (n·v s³ + n·d (1 - c)² (2 + c)) along d.

Gradient: exact; 0 for `arccos` at ±1, where it is not finite.
Source: Jimenez, Wu, Pesce & Jarabo 2016, "Practical Real-Time Strategies for Accurate Indirect Occlusion", eq. 7; the
forms without γ are ours.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math import safe

Value = Float[Array, "*b"]
# Source: Abramowitz & Stegun 1964, 4.4.46: off by at most 2e-8 before float32 rounds it.
COEFFICIENTS = (
    1.5707963050,
    -0.2145988016,
    0.0889789874,
    -0.0501743046,
    0.0308918810,
    -0.0170881256,
    0.0066700901,
    -0.0012624911,
)


def arccos(cosine: Value) -> Value:
    """The angle of a cosine in [-1, 1], to 3e-7: a polynomial, for XLA's own takes ten times as long."""
    size = jnp.abs(cosine)
    total = jnp.zeros_like(size)
    for coefficient in COEFFICIENTS[::-1]:
        total = total * size + coefficient
    angle = safe.sqrt(1.0 - size) * total
    return jnp.where(cosine < 0, np.pi - angle, angle)


def arc(n_dot_v: Value, n_dot_d: Value, cosine: Value) -> Value:
    """∫ (n·ω) sin θ dθ from v to the horizon of this cosine, towards d."""
    square = jnp.maximum(1.0 - cosine * cosine, 0.0)
    return 0.5 * (n_dot_v * square + n_dot_d * (arccos(cosine) - safe.sqrt(square) * cosine))


def mean_direction(n_dot_v: Value, n_dot_d: Value, cosine: Value) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """∫ (n·ω) ω sin θ dθ over the same arc, its parts along v and d."""
    square = jnp.maximum(1.0 - cosine * cosine, 0.0)
    sine3 = square * safe.sqrt(square)
    along_v = n_dot_v * (1.0 - cosine * cosine * cosine) + n_dot_d * sine3
    along_d = n_dot_v * sine3 + n_dot_d * (1.0 - cosine) ** 2 * (2.0 + cosine)
    return along_v / 3.0, along_d / 3.0
