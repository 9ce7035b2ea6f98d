"""A clear varnish over any other material: a second, colourless highlight, and the rest darker by what it mirrors.

coated = (1 - share) base + share · lobe, both times n·l, and emission (1 - share). n is the coat's own normal, which
may be smoother than the base's, and alpha the square of its authored roughness. The coat is infinitely thin: nothing is
refracted, absorbed or mirrored back and forth between the layers.

The share is that of n·v, not of v·h: so no more is taken from the base than the coat returns, and a white base under a
white sky stays at most white. Light and viewer therefore do not exchange their parts; the lobe alone is reciprocal.

Source: glTF 2.0, KHR_materials_clearcoat, `fresnel_coat`.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe
from ..surface.material import DIELECTRIC_F0, MIN_N_DOT_V
from .distribution import ggx
from .masking import smith_correlated


def clearcoat_share(n_dot_v: Float[Array, "*b"], weight: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """weight · (0.04 + 0.96 (1 - n·v)⁵), Schlick's F of an index of 1.5: 0 without a coat, to 1 at grazing angles.

    Gradient: exact; halved in n·v at 0 and 1, where it is clamped.
    """
    x = 1.0 - jnp.clip(n_dot_v, 0.0, 1.0)
    x2 = x * x
    return weight * (DIELECTRIC_F0 + (1.0 - DIELECTRIC_F0) * x2 * x2 * x)


def clearcoat_lobe(
    n: Float[Array, "*b 3"], v: Float[Array, "*b 3"], l: Float[Array, "*b 3"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """D V (n·l) of GGX, without F; 0 where n·l is not above 0. n·v is raised to 0.001, as the normals of `render` are.

    Gradient: exact where n·l > 0 and n·v > 0.001, else 0 in the clamped cosine.

    Example:
        >>> n = jnp.array([0.0, 0.0, 1.0])
        >>> share, lobe = clearcoat_share(jnp.array(1.0), jnp.array(1.0)), clearcoat_lobe(n, n, n, jnp.array(0.1))
        >>> f"{share:.3f} of {lobe:.3f}"
        '0.040 of 7.958'
    """
    n_dot_v, n_dot_l = safe.dot(n, v), safe.dot(n, l)
    lit = n_dot_l > 0
    n_dot_l = jnp.where(lit, n_dot_l, 0.0)
    n_dot_v = jnp.where(n_dot_v < MIN_N_DOT_V, MIN_N_DOT_V, n_dot_v)
    lobe = ggx(n, safe.unit(v + l), alpha) * smith_correlated(n_dot_v, n_dot_l, alpha) * n_dot_l
    return jnp.where(lit, lobe, 0.0)
