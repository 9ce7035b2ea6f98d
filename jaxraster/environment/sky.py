"""A clear sky with its sun, from where the sun stands and how hazy the air is.

Sky: luminance and chromaticity of the zenith, spread over the sky by Perez' formula
F(θ, γ) = (1 + A exp(B / cos θ)) (1 + C exp(D γ) + E cos² γ), θ from the zenith and γ from the sun.
Ground: a matt plane in the light of both. Texels in cd/m², linear Rec.709; what the primaries cannot mix is cut at 0.

Where the sun is below the horizon the sky is that of sunset, a tenth as bright for every 2.5° that it is lower, as
twilight is measured to be, and the sun shines with that part of its disc that is above.

Gradient: exact in direction and turbidity; 0 in a channel that is cut. The sun at the zenith has no azimuth, the sky
about it none either.
Source: Preetham, Shirley & Smits 1999, "A Practical Analytic Model for Daylight", appendix A.2; `sunlight` is its A.1.
"""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..math import safe
from ..math.angle import turns
from ..math.rec709 import LINEAR_FROM_XYZ
from ..scene import Directional
from .equirect import directions, solid_angles
from .sunlight import sunlight

Number = float | Float[Array, ""]
Vector = Float[Array, "3"] | Float[np.ndarray, "3"] | Sequence[float]

LEAST, MOST = 2.0, 10.0  # turbidity: below 1.7 the fit turns negative at the zenith, above 11 at sunset
# Per channel of luminance and chromaticity x, y: what A, B, C, D and E gain per turbidity, and what they are at 0.
PEREZ = (
    ((0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)),
    ((-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)),
    ((-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)),
)
# Chromaticity x and y of the zenith: rows times turbidity's square, itself and 1, columns the sun's θ³, θ², θ and 1.
ZENITH = (
    (
        (0.00166, -0.00375, 0.00209, 0.0),
        (-0.02903, 0.06377, -0.03202, 0.00394),
        (0.11693, -0.21196, 0.06052, 0.25886),
    ),
    (
        (0.00275, -0.00610, 0.00317, 0.0),
        (-0.04214, 0.08970, -0.04153, 0.00516),
        (0.15346, -0.26756, 0.06670, 0.26688),
    ),
)
# Degrees below the horizon that make a tenth: 400 lx at sunset, 3.4 at 6°, 0.008 at 12° (Seidelmann 1992, §9).
TWILIGHT = 2.5
# The sine that directions below count as, for the formula is of the sky: 3 minutes of arc.
GRAZING = 1e-3
RADIUS = 0.00465  # rad, of the sun's disc
DIRECTION = "three numbers, not all zero"


def _angle(a, b):
    """Between unit vectors, in radians: to full precision, and with a finite slope, also where they are equal."""
    (ax, ay, az), (bx, by, bz) = (tuple(v[..., i] for i in range(3)) for v in (a, b))
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    # As planes: XLA takes minutes to compile a cross product as a stack of its components.
    return 2.0 * jnp.pi * turns(safe.sqrt(x * x + y * y + z * z), ax * bx + ay * by + az * bz)


def _perez(channel, turbidity, cosine, gamma):
    """F of luminance (0) or chromaticity x, y (1, 2)."""
    a, b, c, d, e = (slope * turbidity + start for slope, start in PEREZ[channel])
    return (1.0 + a * jnp.exp(b / cosine)) * (1.0 + c * jnp.exp(d * gamma) + e * jnp.cos(gamma) ** 2)


def _zenith(turbidity, theta):
    """Luminance in cd/m², and chromaticity x and y, straight above, for a sun `theta` from there."""
    chi = (4.0 / 9.0 - turbidity / 120.0) * (jnp.pi - 2.0 * theta)
    luminance = (4.0453 * turbidity - 4.9710) * jnp.tan(chi) - 0.2155 * turbidity + 2.4192
    rows = [[((a * theta + b) * theta + c) * theta + d for a, b, c, d in table] for table in ZENITH]
    return 1000.0 * luminance, *((a * turbidity + b) * turbidity + c for a, b, c in rows)


def _linear(luminance, x, y):
    """Linear Rec.709 of luminance and chromaticity, along a new last axis."""
    scale = luminance / y
    xyz = scale * x, luminance, scale * (1.0 - x - y)
    return jnp.stack([jnp.maximum(sum(m * c for m, c in zip(row, xyz)), 0.0) for row in LINEAR_FROM_XYZ.tolist()], -1)


def _known(name, value, holds, wanted):
    """The value as an array; one line where it is known and is not what is wanted."""
    kind = jnp.result_type(float)
    if not isinstance(value, jax.core.Tracer):
        with np.errstate(over="ignore"):
            number = np.asarray(value, float).astype(kind)
        if not holds(number):
            raise ValueError(f"sky: {name} must be {wanted}, got {number.tolist()}")
    return jnp.asarray(value, kind)


def _points(v):
    """Whether it is a direction: `safe.normalize` takes what is below TINY for 0."""
    return v.shape == (3,) and np.isfinite(v).all() and (np.abs(v) > safe.TINY).any()


@functools.partial(jax.jit, static_argnames=("height", "width"))
def _light(towards_sun, turbidity, ground, gain, height, width):
    """`sky` without its checks."""
    sun = safe.normalize(towards_sun)
    zenith = 2.0 * jnp.pi * turns(safe.sqrt(sun[0] * sun[0] + sun[2] * sun[2]), sun[1])
    theta, below = jnp.minimum(zenith, 0.5 * jnp.pi), jnp.maximum(zenith - 0.5 * jnp.pi, 0.0)
    dusk = 10.0 ** (-below * (180.0 / (jnp.pi * TWILIGHT)))
    risen = jnp.clip(0.5 + (0.5 * jnp.pi - zenith) / (2.0 * RADIUS), 0.0, 1.0)
    sunshine = risen * sunlight(zenith, turbidity)

    d = directions(height, width).astype(zenith.dtype)
    cosine = d[..., 1]
    gamma = _angle(d, sun)
    at_zenith = (value / _perez(i, turbidity, 1.0, theta) for i, value in enumerate(_zenith(turbidity, theta)))
    grazing = jnp.maximum(cosine, GRAZING)
    above = dusk * _linear(*(value * _perez(i, turbidity, grazing, gamma) for i, value in enumerate(at_zenith)))

    # Light the ground by what it sees of this picture, so that it is as bright as a white floor under it would be.
    bands = (solid_angles(height, width).astype(zenith.dtype) * jnp.maximum(cosine[:, 0], 0.0))[:, None, None]
    irradiance = jnp.sum(bands * above, axis=(0, 1)) + jnp.maximum(sun[1], 0.0) * sunshine
    share = 0.5 + 0.5 * jnp.sign(cosine)[..., None]
    texels = share * above + (1.0 - share) * (ground / jnp.pi * irradiance)[None, None]
    return gain * texels, Directional(direction=-sun[None], irradiance=gain * sunshine[None])


def sky(
    towards_sun: Vector,
    turbidity: Number = 3.0,
    *,
    height: int = 128,
    width: int = 256,
    ground: Vector = (0.2, 0.2, 0.2),
    gain: Number = 1.0,
) -> tuple[Float[Array, "h w 3"], Directional]:
    """Texels of the sky without its sun, and the sun as a directional light.

    `towards_sun` may be of any length but 0. `turbidity` is 2 for clear air, 10 for haze; `ground` is the albedo of
    what lies below the horizon, `gain` multiplies all light: 1 for cd/m² and lx, 1e-4 for what needs no exposure.
    `environment.prepare` makes surroundings of both.

    Example:
        >>> texels, sun = sky((0.0, 1.0, 0.0), 2.5, height=16, width=32)
        >>> texels.shape, sun.direction.tolist()
        ((16, 32, 3), [[-0.0, -1.0, -0.0]])
    """
    sun = _known("towards_sun", towards_sun, _points, DIRECTION)
    haze = _known("turbidity", turbidity, lambda t: t.shape == () and LEAST <= t <= MOST, f"{LEAST:g} to {MOST:g}")
    albedo = _known("ground", ground, lambda a: a.shape == (3,) and ((a >= 0) & (a <= 1)).all(), "an albedo [3]")
    gain = _known("gain", gain, lambda g: g.shape == () and np.isfinite(g), "one number")
    return _light(sun, haze, albedo, gain, height, width)
