"""ꟻLIP: the difference that is seen when two pictures are shown in turns at one place.

Two pictures on a display at a known distance are blurred as the eye does, their colours compared where equal steps look
equal, and the result is sharpened where one has an edge or a point that the other has not.

Source: Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images"; the numbers below are its own.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..display.transfer import srgb_decode
from ..math import safe
from ..math.filter import separable
from .opponent import Color, hunt_lab, hyab, linear_from_opponent, opponent_from_linear
from .score import RGB, Map, Picture, Planes, Score, mean, pair, score

# Pixels per degree of a display 0.7 m wide with 3840 pixels, seen from 0.7 m.
PIXELS_PER_DEGREE = 3840.0 * math.pi / 180.0
COLOR_EXPONENT, FEATURE_EXPONENT = 0.7, 0.5
# A colour difference of KNEE of the largest becomes an error of KNEE_ERROR; what is larger shares the rest.
KNEE, KNEE_ERROR = 0.4, 0.95
LARGEST = 203.304976  # HyAB of full green and full blue, the most that two colours differ by
EDGE_WIDTH = 0.082  # degrees from peak to trough of the eye's response to an edge
# The eye's contrast sensitivity: Gaussians a √(π/b) exp(-π²x²/b) in degrees, for brightness, red-green, blue-yellow.
SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))


def _blur(plane: Map, gaussians: tuple, pixels_per_degree: float) -> Map:
    """A sum of Gaussians over the window of the widest of all, its weights adding up to 1."""
    widest = max(b for each in SENSITIVITY for _, b in each)
    radius = math.ceil(3.0 * math.sqrt(widest / (2.0 * math.pi**2)) * pixels_per_degree)
    degrees = np.arange(-radius, radius + 1) / pixels_per_degree
    shapes = [np.exp(-((math.pi * degrees) ** 2) / b) for _, b in gaussians]
    shares = [a * math.sqrt(math.pi / b) * shape.sum() ** 2 for (a, b), shape in zip(gaussians, shapes)]
    total = jnp.zeros_like(plane)
    for shape, share in zip(shapes, shares):
        weights = shape / shape.sum()
        # Leave out what float32 would round away.
        kept = np.flatnonzero(weights > np.finfo(np.float32).eps * weights.max() / len(weights))
        weights = weights[kept[0] : kept[-1] + 1]
        total += share / sum(shares) * separable(plane, weights, weights, "edge")
    return total


def _signed(weights: np.ndarray) -> np.ndarray:
    """Weights whose positive ones add up to 1 and whose negative ones to -1."""
    return weights / np.where(weights > 0, weights[weights > 0].sum(), -weights[weights < 0].sum())


def _features(brightness: Map, pixels_per_degree: float) -> tuple[Map, Map]:
    """How strong edges and points are, each from 0 to √2: the lengths of the first and second Gaussian derivatives."""
    deviation = 0.5 * EDGE_WIDTH * pixels_per_degree
    x = np.arange(-math.ceil(3.0 * deviation), math.ceil(3.0 * deviation) + 1)
    gaussian = np.exp(-0.5 * (x / deviation) ** 2)
    smooth = gaussian / gaussian.sum()

    def strength(derivative):
        across = separable(brightness, smooth, derivative, "edge")
        down = separable(brightness, derivative, smooth, "edge")
        return safe.sqrt(across * across + down * down)

    return strength(_signed(-x * gaussian)), strength(_signed(((x / deviation) ** 2 - 1.0) * gaussian))


def _power(x: Map, exponent: float | Map) -> Map:
    """x^exponent, and 0 where x is at most TINY. Gradient: 0 there, where the plain one is infinite."""
    positive = x > safe.TINY
    return jnp.where(positive, jnp.exp2(exponent * jnp.log2(jnp.where(positive, x, 1.0))), 0.0)


def _color_difference(image: Color, reference: Color) -> Map:
    """HyAB of two colours to the power of COLOR_EXPONENT, as an error from 0 to 1."""
    share = _power(hyab(image, reference) / LARGEST, COLOR_EXPONENT)
    above = KNEE_ERROR + (share - KNEE) / (1.0 - KNEE) * (1.0 - KNEE_ERROR)
    return jnp.where(share < KNEE, KNEE_ERROR / KNEE * share, above)


def _seen(light: Planes, pixels_per_degree: float) -> tuple[Color, tuple[Map, Map]]:
    """What the eye makes of display-linear light: its blurred colour, and the strength of edges and points."""
    red, green, blue = light
    opponent = opponent_from_linear((red, green, blue))
    y, red_green, blue_yellow = (_blur(plane, each, pixels_per_degree) for plane, each in zip(opponent, SENSITIVITY))
    color = hunt_lab(linear_from_opponent((y, red_green, blue_yellow)))
    return color, _features(opponent[0], pixels_per_degree)


def flip_of_linear(image: Planes, reference: Planes, pixels_per_degree: float) -> Map:
    """ꟻLIP of two finite pictures of display-linear light in [0, 1]."""
    # Loop over the two: what one program writes to memory for each is the same to the bit where the pictures are.
    seen = lax.map(lambda light: _seen(light, pixels_per_degree), jnp.stack([image, reference]))
    (color, features), (other_color, other_features) = (jax.tree.map(lambda x, i=i: x[i], seen) for i in (0, 1))
    edges, points = (jnp.abs(one - other) for one, other in zip(features, other_features))
    feature = _power(math.sqrt(0.5) * jnp.maximum(edges, points), FEATURE_EXPONENT)
    return _power(_color_difference(color, other_color), 1.0 - feature)


def positive(name: str, number: float) -> float:
    """The number, if it is a plain one above 0: it sets sizes of filters."""
    if not isinstance(number, int | float) or not 0 < number < math.inf:
        raise ValueError(f"{name} must be a plain finite number above 0, got {number!r:.60} (close over it)")
    return float(number)


@functools.partial(jax.jit, static_argnums=2)
def _flip(image: Picture, reference: Picture, pixels_per_degree: float) -> Score:
    """`flip`, compiled."""
    image, reference, sound = pair("flip", image, reference, RGB)
    image, reference = (srgb_decode(jnp.clip(x, 0.0, 1.0)) for x in (image, reference))
    values = flip_of_linear(image, reference, pixels_per_degree)
    return score(mean(values, sound), values, sound)


def flip(image: Picture, reference: Picture, *, pixels_per_degree: float = PIXELS_PER_DEGREE) -> Score:
    """Mean of ꟻLIP over the pixels, from 0 for identical pictures to 1. For display-encoded RGB, clipped to [0, 1].

    `pixels_per_degree` of the viewer's field, a plain number: distance · pixels across / width · π/180. It sets the
    filters' sizes, so that each number compiles anew.

    Gradient: exact in both where they differ, and finite everywhere. The definition has the cusp of x^0.7: the slope
    grows without bound as a pixel's colours approach each other, and is taken to be 0 where they are the same.

    Example:
        >>> grey = jnp.full((8, 8, 3), 0.5)
        >>> float(flip(grey, grey).value), f"{flip(grey + 0.1, grey).value:.3f}"
        (0.0, '0.285')
    """
    return _flip(image, reference, positive("flip: pixels_per_degree", pixels_per_degree))
