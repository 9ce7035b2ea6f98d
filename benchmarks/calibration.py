"""A computation that never changes, timed beside every other, so that times of other machines and days compare.

x <- 1 - 1.9 x², 1,000 times, on 2¹⁵ numbers: arithmetic in the caches. Then 2¹⁶ scrambled int32 are sorted: branches,
and memory. The parts are near equal, five milliseconds in all on one core of a server of 2021. A time over this one's
is a ratio that a machine twice as fast, or half as busy, leaves where it was, as far as the work is of the same kind.
"""

import jax
import jax.numpy as jnp
import numpy as np

STEPS, NUMBERS, KEYS = 1000, 2**15, 2**16
_index = np.arange(KEYS, dtype=np.uint32)
# Squares times an odd number, modulo 2³²: all different, in no order, and the same whatever library makes them.
INPUTS = np.linspace(-0.9, 0.9, NUMBERS, dtype=np.float32), (_index * _index * np.uint32(2654435769)).view(np.int32)


@jax.jit
def calibration(numbers, keys):
    """The chain's end and the sorted keys."""
    return jax.lax.fori_loop(0, STEPS, lambda _, x: 1.0 - 1.9 * x * x, numbers), jnp.sort(keys)
