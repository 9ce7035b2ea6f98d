"""The linear map that turns GGX reflection into a cosine, at every pixel, from the table of `area_fit`.

In world space, with the mirror direction r = 2c n - v, c = n·v, and X = c v - (2c² - 1) n, which lies in the plane of
incidence, is perpendicular to r and of length s = √(1 - c²): a direction l becomes

w = l - r (r·l) - δ X (X·l) + k X (r·l) + r α (a r·l + b n·l).

Nothing here divides by s, so that the gradient is finite where the viewer looks straight down. The table is
interpolated linearly in roughness and √c; its ends hold beyond them.
Gradient: exact of the interpolation, and so stepwise constant in roughness and n·v as far as they choose the lobe.
Source: Heitz, Dupuy, Hill & Neubelt 2016, "Real-Time Polygonal-Light Shading with Linearly Transformed Cosines".
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..buffers import Surface
from ..math import safe
from ..math.table import fetch
from ..record import record
from .area_fit import NODES, ROOT, ROUGHNESS, table


@record
class Lobe:
    """What `bend` needs at every pixel; the share of the lobe a light takes is `gain` times its form factor, bent."""

    mirror: Float[Array, "*b 3"]
    across: Float[Array, "*b 3"]
    entries: Float[Array, "*b 4"]
    gain: Float[Array, "*b"]


def _node(x: Float[Array, "*b"], ends: tuple[float, float]):
    """The node below x, and how far x is towards the next."""
    place = jnp.clip((x - ends[0]) * ((NODES - 1) / (ends[1] - ends[0])), 0.0, NODES - 1.0)
    below = jnp.clip(place.astype(jnp.int32), 0, NODES - 2)
    return below, (place - below.astype(place.dtype))[..., None]


def reflection(surface: Surface) -> Lobe:
    """The lobe at every pixel."""
    n, v = surface.normal, surface.view
    c = safe.dot(n, v)[..., None]
    (row, down), (column, right) = _node(safe.sqrt(surface.alpha), ROUGHNESS), _node(safe.sqrt(c[..., 0]), ROOT)
    values = jnp.asarray(table(), surface.alpha.dtype)
    index = row * NODES + column
    near, far = (
        fetch(values, index + step) * (1.0 - right) + fetch(values, index + step + 1) * right for step in (0, NODES)
    )
    found = near * (1.0 - down) + far * down
    entries = jnp.concatenate([found[..., :2], surface.alpha[..., None] * found[..., 2:4]], axis=-1)
    across = c * v - (2.0 * c * c - 1.0) * n
    return Lobe(mirror=2.0 * c * n - v, across=across, entries=entries, gain=found[..., 4])


def bend(lobe: Lobe, n: Float[Array, "*b 3"], l: Float[Array, "k *b 3"]) -> Float[Array, "k *b 3"]:
    """w of k directions or corners of a light at every pixel; the cosine is that with `lobe.mirror`."""
    r, x, n = (jnp.broadcast_to(vector, l.shape) for vector in (lobe.mirror, lobe.across, n))
    delta, k, a, b = (jnp.broadcast_to(lobe.entries[..., i], l.shape[:-1]) for i in range(4))
    along, aside = safe.dot(r, l), safe.dot(x, l)
    sideways, forward = k * along - delta * aside, a * along + b * safe.dot(n, l) - along
    return l + sideways[..., None] * x + forward[..., None] * r
