"""What share of a map's texels about a place leave it lit: one texel, a box of them, or taps all over a disc.

    single  the texel that the place lies in: hard and jagged
    box     n × n texels about the exact position, those at the rim in part: a ramp n texels wide, not steps
    disc    taps spread evenly over a disc n texels wide and turned by a number of the pixel's own: noise for banding

Taps of a disc lie on a spiral in place of a Poisson pattern: as evenly, for any number of them, and without a table.

Gradient: none, on purpose: each tap is a comparison.
Source: Reeves, Salesin & Cook 1987 (box); Vogel 1979, "A better way to construct the sunflower head" (spiral).
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from ..math.hash import keyed, uniform
from ..math.table import fetch, fetch_run

Shares = Float[Array, "*b"]
GOLDEN = np.pi * (3.0 - 5.0**0.5)  # the angle between neighbours on the spiral
UNROLL = 4  # taps a step: each step reads and writes what was found at every pixel
# Whether the texel at (column, line), whole numbers, leaves the place lit: 0 or 1; and the same of a line of them.
Test = Callable[[Array, Array], Shares]
Tests = Callable[[Array, Array, int], list[Shares]]


def lookup(occluders: Float[Array, " n"], size: int, column: Array, line: Array) -> Float[Array, "*b"]:
    """The depth of the texel at whole coordinates, of the nearest one where they lie outside."""
    column, line = (jnp.clip(place, 0, size - 1).astype(jnp.int32) for place in (column, line))
    return fetch(occluders, line * size + column)


def lookup_line(
    occluders: Float[Array, " n"], size: int, column: Array, line: Array, count: int
) -> list[Float[Array, "*b"]]:
    """The depths of `count` texels of a line from whole coordinates on; of other texels where they lie outside."""
    column, line = jnp.clip(column, 0, size - count), jnp.clip(line, 0, size - 1)
    found = fetch_run(occluders, line.astype(jnp.int32) * size + column.astype(jnp.int32), count)
    return [found[..., i] for i in range(count)]


def single(x: Shares, y: Shares, test: Test) -> Shares:
    """The texel around the place."""
    return test(jnp.floor(x), jnp.floor(y))


def _taps(position, width):
    """The texels that an axis's box of so many reaches, and their weights: in 1/256, so that they add up exactly."""
    first = jnp.floor(position - 0.5 * width)
    fraction = jnp.round(256.0 * (position - 0.5 * width - first)) / 256.0
    one = jnp.ones_like(fraction)
    weights = [1.0 - fraction, *[one] * (width - 1), fraction]
    return [(first + offset, weight) for offset, weight in enumerate(weights)]


def box(x: Shares, y: Shares, tests: Tests, width: int) -> Shares:
    """The box of `width` texels on a side about the place."""
    lit = jnp.zeros_like(x)
    columns, lines = _taps(x, width), _taps(y, width)
    for line, line_weight in lines:
        found = tests(columns[0][0], line, width + 1)
        lit += line_weight * sum(weight * one for (_, weight), one in zip(columns, found))
    return lit / width**2


def turns(like: Shares) -> Shares:
    """A number in [0, 1) for each pixel, by its place in the array."""
    return uniform(keyed(jnp.arange(like.size, dtype=jnp.uint32), 0)).reshape(like.shape).astype(like.dtype)


def over_disc(add: Callable, total: Any, like: Shares, taps: int) -> Any:
    """`add(total, (across, along))` for so many offsets, evenly over the unit disc, turned at each pixel.

    In a loop: compiled as one expression, 64 taps would take half a minute.
    """
    angle = 2.0 * np.pi * turns(like)
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    radius, around = np.sqrt((np.arange(taps) + 0.5) / taps), GOLDEN * np.arange(taps)
    fixed = jnp.asarray(np.stack([radius * np.cos(around), radius * np.sin(around)], axis=-1), like.dtype)

    def step(tap, total):
        a, b = fixed[tap, 0], fixed[tap, 1]
        return add(total, (cosine * a - sine * b, sine * a + cosine * b))

    return lax.fori_loop(0, taps, step, total, unroll=UNROLL)


def disc(x: Shares, y: Shares, test: Test, radius_x: Any, radius_y: Any, taps: int) -> Shares:
    """The mean of taps over a disc about the place, of these radii in texels."""

    def add(lit, tap):
        return lit + test(jnp.floor(x + radius_x * tap[0]), jnp.floor(y + radius_y * tap[1]))

    return over_disc(add, jnp.zeros_like(x), x, taps) / taps
