"""Filters of pictures: weighted sums over neighbours, along the columns and then along the rows."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

Weights = Float[np.ndarray, " k"]

# Terms that are added in one pass over memory. A pass for each takes three times as long; more in one pass is hardly
# faster, and the gradient slower.
AT_ONCE = 7


def correlate(planes: Float[Array, "*b h w"], weights: Weights, axis: int) -> Float[Array, "..."]:
    """Σᵢ weights[i] · planes[x + i] along one axis, which gets shorter by one less than there are weights.

    Gradient: exact; the sum is linear.

    Example:
        >>> correlate(jnp.array([[1.0, 2.0, 4.0]]), np.array([-1.0, 1.0]), -1).tolist()
        [[1.0, 2.0]]
    """
    count = planes.shape[axis] - len(weights) + 1
    # Take two turns at least, the last filled up with zeros: what a loop writes is in memory, but a loop of one turn is
    # dissolved, and the next filter would compute it anew for each of its terms.
    turns = max(2, -(-len(weights) // AT_ONCE))
    terms = -(-len(weights) // turns)
    factors = jnp.asarray(np.pad(weights, (0, turns * terms - len(weights))), planes.dtype)

    def add(turn, total):
        for i in range(terms):
            term = turn * terms + i
            total += factors[term] * lax.dynamic_slice_in_dim(planes, term, count, axis)
        return total

    return lax.fori_loop(0, turns, add, jnp.zeros_like(lax.slice_in_dim(planes, 0, count, axis=axis)))


def separable(
    planes: Float[Array, "*b h w"], vertical: Weights, horizontal: Weights, border: Literal["edge", "symmetric"]
) -> Float[Array, "*b h w"]:
    """Σ vertical[i] · horizontal[j] · planes[y + i - r, x + j - r], with an odd number 2 r + 1 of weights each way.

    Beyond the border stands its nearest pixel ("edge") or the picture's mirror image ("symmetric").
    Gradient: exact.
    """
    around = [(0, 0)] * (planes.ndim - 2) + [(len(vertical) // 2,) * 2, (len(horizontal) // 2,) * 2]
    return correlate(correlate(jnp.pad(planes, around, mode=border), vertical, -2), horizontal, -1)
