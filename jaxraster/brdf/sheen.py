"""The sheen of cloth: fibres that stand upright glow where they are seen or lit from the side.

cloth = `sheen` + base · `sheen_scaling`, both times n·l. alpha is the square of the authored sheen roughness; below
SMOOTHEST it counts as that. Cosines below 0.001 count as that, as the normals of `render` are bent to it: V has no
bound towards 0. Reciprocal. Nearly black under n for small alpha; white sheen returns more light than it gets where
n·v and alpha are small, twice as much at 0.001 and 0.01: there nothing is left of the base.

Gradient: that of each formula; in alpha 0 below SMOOTHEST, and halved at it.
Source: Conty Estevez and Kulla 2017, "Production Friendly Microfacet Sheen BRDF" ("Charlie"), as in glTF 2.0,
KHR_materials_sheen. Its albedo is tabulated there; here it is a fit of our own.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..math import safe
from ..surface.material import MIN_N_DOT_V

# A roughness of 0.1. A rounding of sin²θ counts 1/(2α) times, 50: float32 keeps 5 digits. Lobes narrower than this glow
# on the last pixel before an edge alone, where their albedo passes 2.
SMOOTHEST = 0.01
# The least 1 - cos that Λ tells from 0: its slope there has no bound, and Λ(1) is below 1e-5 in any case.
LEAST = 1e-6
# a, b, c, d and e of L(x) = a/(1 + b xᶜ) + d x + e, at α = 1 and at α = 0; between them mixed by (1 - α)².
LAMBDA = ((21.5473, 3.82987, 0.19823, -1.97760, -4.32054), (25.3245, 3.32435, 0.16801, -1.27393, -4.85967))
# Rows: 1, √(n·v), n·v, (n·v)²; columns: 1/r, 1/√r, 1, r, with r the roughness. For `sheen_albedo`.
ALBEDO = (
    (-0.3197, 2.2633, -2.8096, 0.4113),
    (0.9299, -3.8286, 2.8317, -0.1470),
    (-2.7743, 5.6611, -2.4775, 0.4981),
    (2.7699, -12.0847, 11.4412, -3.1046),
)


def charlie(n: Float[Array, "*b 3"], h: Float[Array, "*b 3"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """D = (2 + 1/α) sin^(1/α) θ / (2π), θ the angle between n and h; 0 below the horizon. ∫ D (n·h) dh = 1.

    sin² is |n × h|² near n and 1 - (n·h)² near the horizon, whichever cancels none.
    Gradient: exact in n, h and α; 0 at h = n.
    """
    n_dot_h = safe.dot(n, h)
    above = n_dot_h > 0
    across = jnp.cross(n, h - n)
    sine2, cosine2 = safe.dot(across, across), n_dot_h * n_dot_h
    low = above & (cosine2 < 0.5)
    steep = above & ~low & (sine2 > safe.TINY)
    log_sine2 = jnp.where(low, jnp.log1p(-jnp.where(low, cosine2, 0.0)), jnp.log(jnp.where(steep, sine2, 1.0)))
    width = jnp.maximum(alpha, SMOOTHEST)
    lobe = (2.0 + 1.0 / width) / (2.0 * jnp.pi) * jnp.exp(0.5 / width * log_sine2)
    return jnp.where(low | steep, lobe, 0.0)


def _shadow(cosine: Float[Array, "*b"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Λ, the masked over the seen: e^L(x) for x below ½ and e^(2 L(½) - L(1 - x)) above, L the formula of LAMBDA."""
    t = (1.0 - jnp.maximum(alpha, SMOOTHEST)) ** 2
    a, b, c, d, e = (rough + (smooth - rough) * t for rough, smooth in zip(*LAMBDA))

    def exponent(x):
        return a / (1.0 + b * jnp.exp2(c * jnp.log2(x))) + d * x + e

    # Fold the upper half down: one power for both.
    low = cosine < 0.5
    folded = exponent(jnp.maximum(jnp.where(low, cosine, 1.0 - cosine), LEAST))
    return jnp.exp(jnp.where(low, folded, 2.0 * exponent(jnp.full_like(cosine, 0.5)) - folded))


def charlie_visibility(
    n_dot_v: Float[Array, "*b"], n_dot_l: Float[Array, "*b"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """V = 1 / (4 (n·v)(n·l) (1 + Λ(n·v) + Λ(n·l))), Λ a published fit of Smith's integral for `charlie`.

    What microfacets show of themselves is off n·v by up to 12 %, the weak white furnace (measured by the tests).
    Gradient: exact; 0 in cosines below 0.001.
    """
    x, y = (jnp.where(c < MIN_N_DOT_V, MIN_N_DOT_V, c) for c in (n_dot_v, n_dot_l))
    return 0.25 / (x * y * (1.0 + _shadow(x, alpha) + _shadow(y, alpha)))


def sheen(
    n: Float[Array, "*b 3"],
    v: Float[Array, "*b 3"],
    l: Float[Array, "*b 3"],
    color: Float[Array, "*b 3"],
    alpha: Float[Array, "*b"],
) -> Float[Array, "*b 3"]:
    """colour · D V (n·l), F being 1; 0 where n·l is not above 0.

    Gradient: exact where n·l > 0, else 0; 0 in cosines below 0.001 and at h = n.
    """
    n_dot_l = safe.dot(n, l)
    lobe = charlie(n, safe.unit(v + l), alpha) * charlie_visibility(safe.dot(n, v), n_dot_l, alpha)
    return color * jnp.where(n_dot_l > 0, lobe * n_dot_l, 0.0)[..., None]


def sheen_albedo(cosine: Float[Array, "*b"], alpha: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """E = ∫ D V (n·l) dl, at most 1: e^P / (cos (3 + Λ)), P a polynomial in powers of cos and roughness.

    Off the integral, where that is at most 1, by at most 0.008 (measured by the tests). Fitted to it at 23 roughnesses
    and 26 cosines by least squares, with weights that grow with the error until the largest stopped shrinking.
    Gradient: exact of the fit; 0 where E is clamped.
    """
    cosine = jnp.where(cosine < MIN_N_DOT_V, MIN_N_DOT_V, cosine)
    r = jnp.sqrt(jnp.maximum(alpha, SMOOTHEST))
    by_angle, by_roughness = (1.0, jnp.sqrt(cosine), cosine, cosine**2), (1.0 / r, 1.0 / jnp.sqrt(r), 1.0, r)
    power = sum(x * sum(c * y for c, y in zip(row, by_roughness)) for x, row in zip(by_angle, ALBEDO))
    return jnp.minimum(jnp.exp(power) / (cosine * (3.0 + _shadow(cosine, alpha))), 1.0)


def sheen_scaling(
    color: Float[Array, "*b 3"], n_dot_v: Float[Array, "*b"], n_dot_l: Float[Array, "*b"], alpha: Float[Array, "*b"]
) -> Float[Array, "*b"]:
    """1 - max(colour) · max(E(n·v), E(n·l)): what the sheen leaves for the base, from both sides; 1 without sheen.

    Gradient: exact, of the larger of three channels and of two E; shared where they tie.

    Example:
        >>> color, alpha, above = jnp.array([0.9, 0.3, 0.3]), jnp.array(0.25), jnp.array(1.0)
        >>> [f"{sheen_scaling(color, jnp.array(c), above, alpha):.2f}" for c in (0.1, 1.0)]
        ['0.49', '0.97']
    """
    most = jnp.maximum(sheen_albedo(n_dot_v, alpha), sheen_albedo(n_dot_l, alpha))
    return 1.0 - jnp.max(color, axis=-1) * most
