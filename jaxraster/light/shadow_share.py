"""Direct light, each light times the share of it that arrives.

Σ over lights of share · (diffuse, specular); lights of a kind without shares arrive whole. Linear Rec.709, cd/m².
Does not affect: ambient light, emission.

Gradient: exact in the lights, the surface and the shares.
"""

import functools
from collections.abc import Callable
from dataclasses import replace

import jax
from jax import lax
from jaxtyping import Array, Float

from ..buffers import Surface
from ..scene import Lights
from .punctual import punctual

Parts = tuple[Float[Array, "*b 3"], Float[Array, "*b 3"]]


@functools.partial(jax.jit, static_argnames=("kind", "brdf"))
def _of_kind(surface: Surface, lights: Lights, kind: str, brdf: Callable, share: Float[Array, "n *b"], total: Parts):
    """The total and what all lights of a kind add to it, one after the other."""

    def add(total, one):
        light, lit = one
        alone = replace(lights, **{kind: jax.tree.map(lambda leaf: leaf[None], light)})
        parts = punctual(surface, alone, (kind,), brdf)
        return tuple(sum + lit[..., None] * part for sum, part in zip(total, parts, strict=True)), None

    return lax.scan(add, total, (getattr(lights, kind), share))[0]


def shadowed(
    surface: Surface,
    lights: Lights,
    kinds: tuple[str, ...],
    brdf: Callable,
    shares: dict[str, Float[Array, "n *b"]],
) -> Parts:
    """Diffuse and specular radiance from all lights of the given kinds; `shares` of some kinds, one for each light."""
    total = punctual(surface, lights, tuple(kind for kind in kinds if kind not in shares), brdf)
    for kind in kinds:
        if kind in shares:
            total = _of_kind(surface, lights, kind, brdf, shares[kind], total)
    return total
