"""The mean over a tile of 4 × 4 pixels along the surface: what a pattern of that size leaves, without blurred edges.

Along lines and then along columns, with the weights ½, 1, 1, 1, ½, which cancel any pattern of four pixels. A neighbour
counts as far as the surface continues: times Π e over the steps to it, where e falls from 1 to 0 as the normals of two
pixels come to differ by 30°, and as the direction from one to the other leaves either one's tangent plane, also by 30°.
The pixel itself always counts in full, and what is no surface never does.

Gradient: exact; 0 through an edge that is wholly there or not.
"""

from collections.abc import Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from ..math import safe
from .height_field import HeightField, Plane, places

SINE = 0.25  # sin² 30°: a plane turned by so much sees (1 + cos 30°)/2 of what it saw, 7 % less


def _product(a: Sequence[Array], b: Sequence[Array]) -> Array:
    """a · b of vectors in planes."""
    return sum(x * y for x, y in zip(a[1:], b[1:], strict=True)) + a[0] * b[0]


def _continues(field: HeightField, axis: int) -> Array:
    """e between each pixel and the next one along the axis, one less than there are pixels."""
    parts, last = (field.mask, *places(field), *field.normal), field.mask.shape[axis] - 1
    here, there = ([lax.slice_in_dim(part, k, k + last, axis=axis) for part in parts] for k in (0, 1))
    step = [b - a for a, b in zip(here[1:4], there[1:4])]
    leaves = jnp.maximum(_product(here[4:], step) ** 2, _product(there[4:], step) ** 2)
    alike = jnp.maximum(_product(here[4:], there[4:]), 0.0)
    plane = jnp.maximum(1.0 - safe.divide(leaves, SINE * _product(step, step)), 0.0)
    turn = jnp.maximum(1.0 - (1.0 - alike * alike) / SINE, 0.0)
    return jnp.where(here[0] & there[0], plane * turn, 0.0)


def _mean_along(axis: int, planes: Sequence[Plane], edge: Array) -> list[Array]:
    """Weighted means over five pixels along an axis."""
    count = planes[0].shape[axis]
    around = [(2, 2) if k == axis else (0, 0) for k in (0, 1)]
    # Write down what is shifted: a border computed in passing keeps the arithmetic from vectors.
    edge, planes = lax.optimization_barrier((jnp.pad(edge, around), [jnp.pad(plane, around) for plane in planes]))

    def shifted(plane, by):
        return lax.slice_in_dim(plane, 2 + by, 2 + by + count, axis=axis)

    weights = {1: shifted(edge, 0), -1: shifted(edge, -1)}
    weights |= {2: 0.5 * weights[1] * shifted(edge, 1), -2: 0.5 * weights[-1] * shifted(edge, -2)}
    share = 1.0 / (1.0 + sum(weights.values()))
    return [
        share * (shifted(plane, 0) + sum(weight * shifted(plane, by) for by, weight in weights.items()))
        for plane in planes
    ]


def denoise(field: HeightField, planes: tuple[Plane, ...]) -> tuple[Float[Array, "h w"], ...]:
    """The means of some planes."""
    for axis in (1, 0):
        edge = lax.optimization_barrier(_continues(field, axis))
        planes = lax.optimization_barrier(_mean_along(axis, planes, edge))
    return tuple(planes)
