"""HDR-ꟻLIP: the largest ꟻLIP that two pictures of light have at any exposure one would look at them with.

Source: Andersson et al. 2021, "Visualizing Errors in Rendered High Dynamic Range Images"; the numbers are its own.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..display.exposure import exposure
from ..display.tonemap import tonemap
from .flip import PIXELS_PER_DEGREE, flip_of_linear, positive
from .score import RGB, Planes, Score, mean, pair, score

BRIGHTNESS = 0.6  # brings the curve's overexposed white, as published, back to where ACES has it
SHOWN = 0.85  # of the display's white: what the brightest and the median pixel are brought to
# Luminance below which a median counts as that, or a picture that is mostly black would have no longest exposure.
DARKEST = 2.0**-23
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec.709


def _light_shown_as(share: float) -> float:
    """The light that the tone curve shows as this share of white: the root of its quadratic, for ev = 0.

    x (2.51 x + 0.03) = share (x (2.43 x + 0.59) + 0.14), the curve of `tonemap`'s "aces_narkowicz".
    """
    a, b, c = 2.51 - share * 2.43, 0.03 - share * 0.59, -share * 0.14
    return (-b + (b * b - 4.0 * a * c) ** 0.5) / (2.0 * a) / BRIGHTNESS


def exposures(reference: RGB) -> Float[np.ndarray, " n"]:
    """The exposures in EV at which `hdr_flip` compares: from that which shows the brightest pixel at 85 % of white to
    that which shows the median one so, as many as there are stops between, at least 2. Of pixels that are finite; 0 EV
    twice if all of them are black.

    Looks at values, so `reference` may not be traced. Gradient: none.

    Example:
        >>> light = jnp.broadcast_to(jnp.array([0.5, 1.0, 2.0, 4.0, 8.0])[:, None, None], (5, 1, 3))
        >>> exposures(light).round(3).tolist()
        [-1.917, 0.083]
    """
    if isinstance(reference, jax.core.Tracer):
        raise ValueError(
            "hdr_flip: reference is traced, but its values choose the exposures; "
            "call exposures(reference) outside of jit and pass the result, or close over the reference"
        )
    pixels = np.asarray(reference, np.float64).reshape(-1, 3)
    light = pixels[np.isfinite(pixels).all(axis=1)] @ LUMINANCE
    if not (light > 0).any():
        return np.zeros(2)
    white = _light_shown_as(SHOWN)
    # Of two pixels in the middle take the brighter one, as the authors' program does.
    middle = np.partition(light, len(light) // 2)[len(light) // 2]
    start, stop = np.log2(white / np.maximum([light.max(), middle], DARKEST))
    return np.linspace(start, stop, max(2, int(np.ceil(stop - start))))


def _shown(light: Planes, ev: Float[Array, ""]) -> Planes:
    """Light at an exposure through the tone curve."""
    rgb = jnp.moveaxis(BRIGHTNESS * light, 0, -1)
    return jnp.moveaxis(tonemap(exposure(rgb, ev), "aces_narkowicz"), -1, 0)


@functools.partial(jax.jit, static_argnums=3)
def _hdr_flip(image: RGB, reference: RGB, evs: Float[Array, " n"], pixels_per_degree: float) -> Score:
    """`hdr_flip`, compiled."""
    image, reference, sound = pair("hdr_flip", image, reference, RGB)

    # Keep none of an exposure's planes for the gradient: there may be thirty exposures.
    @jax.checkpoint
    def at(ev):
        return flip_of_linear(_shown(image, ev), _shown(reference, ev), pixels_per_degree)

    def step(worst, ev):
        return jnp.maximum(worst, at(ev)), None

    values, _ = lax.scan(step, jnp.zeros_like(image[0]), evs.astype(image.dtype))
    return score(mean(values, sound), values, sound)


def hdr_flip(
    image: RGB, reference: RGB, *, evs: Float[Array, " n"] | None = None, pixels_per_degree: float = PIXELS_PER_DEGREE
) -> Score:
    """Mean over the pixels of the largest ꟻLIP at any of the exposures, through a curve like ACES. From 0 to 1, for
    linear RGB light; negative light counts as none.

    `evs` in stops are `exposures(reference)` unless given: give them where the reference is traced, and for a batch,
    in which they are as many for each pair. Another number of them compiles anew.

    Gradient: as that of `flip`, at each pixel's worst exposure; shared where two are equally bad. None into the
    exposures that are computed here.

    Example:
        >>> light = jnp.full((8, 8, 3), 3.0)
        >>> float(hdr_flip(light, light).value), f"{hdr_flip(1.1 * light, light).value:.3f}"
        (0.0, '0.044')
    """
    evs = jnp.asarray(exposures(reference), jnp.result_type(float)) if evs is None else jnp.asarray(evs)
    if evs.ndim != 1 or evs.size == 0:
        raise ValueError(f"hdr_flip: evs must be one or more numbers [n], got {list(evs.shape)}")
    return _hdr_flip(image, reference, evs, positive("hdr_flip: pixels_per_degree", pixels_per_degree))
