"""Light that is mirrored several times between microfacets, given back to the lobe that leaves it out.

The lobe times 1 + f0 (1/E - 1), where E is the albedo at n·v of one that mirrors everything. With f0 = 1 all light
returns, at every angle and roughness; metals grow more saturated as they grow rough. Not reciprocal, as it depends on v
alone: `kulla_conty` is, and returns 3 % less of f0 = 0.5 at roughness 0.8.

Gradient: as of `energy`.
Source: Turquin 2019, "Practical multiple scattering compensation for microfacet models".
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .energy import Color, Value, directional_albedo, mean_split_sum, split_sum


def compensation(f0: Color, n_dot_v: Value, alpha: Value) -> Float[Array, "*b 3"]:
    """1 + f0 (1/E - 1), from 1 to 3.3."""
    a, b = split_sum(n_dot_v, alpha)
    return 1.0 + f0 * (1.0 / (a + b) - 1.0)[..., None]


def compensated_albedo(f0: Color, cosine: Value, alpha: Value, f90: float | Value = 1.0) -> Float[Array, "*b 3"]:
    """The directional albedo (f0·A + f90·B) (1 + f0 (1/E - 1)) of the compensated lobe: 1 for f0 = f90 = 1.

    At most 1 for f0 and f90 up to 1.
    """
    return directional_albedo(f0, cosine, alpha, f90) * compensation(f0, cosine, alpha)


def mean_compensated_albedo(f0: Color, alpha: Value, f90: float | Value = 1.0) -> Float[Array, "*b 3"]:
    """2 ∫ `compensated_albedo`(μ) μ dμ: what the compensated lobe mirrors of light from everywhere to everywhere."""
    a, b, a_lost, b_lost = (mean[..., None] for mean in mean_split_sum(alpha))
    f90 = jnp.broadcast_to(f90, alpha.shape)[..., None]
    return f0 * (a + f0 * a_lost) + f90 * (b + f0 * b_lost)
