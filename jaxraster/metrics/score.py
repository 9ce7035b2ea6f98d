"""What a metric says, and the one way in which it treats pixels that are not finite."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..check import fit
from ..math import safe
from ..record import record

Picture = Float[Array, "h w c"]
RGB = Float[Array, "h w 3"]
Planes = Float[Array, "c h w"]
Map = Float[Array, "h w"]
Mask = Bool[Array, "h w"]


@record
class Score:
    """`value`: the metric of the whole picture, NaN where no pixel is finite. `map`: what it is made of, NaN at pixels
    that are not finite in either picture. `undefined`: how many those are; they are in no mean."""

    value: Float[Array, "*b"]
    map: Float[Array, "*b h w"]
    undefined: Int[Array, "*b"]


def pair(metric: str, image: Picture, reference: Picture, kind: Any = Picture) -> tuple[Planes, Planes, Mask]:
    """Both pictures as planes with every pixel finite, and which pixels were: what is missing in one is taken from the
    other, or is black in both. Raises for shapes and dtypes that do not fit. Gradient: 0 into what was replaced."""
    sizes: dict[str, int] = {}
    fit(f"{metric}: image", image, kind, sizes, batched=False)
    fit(f"{metric}: reference", reference, kind, sizes, batched=False)
    image, reference = (jnp.moveaxis(jnp.asarray(x), -1, 0) for x in (image, reference))
    if image.dtype != reference.dtype:
        raise TypeError(f"{metric}: image is {image.dtype}, but reference {reference.dtype}; convert one")
    here, there = (jnp.all(jnp.isfinite(x), axis=0, keepdims=True) for x in (image, reference))
    known = jnp.where(here, image, jnp.where(there, reference, 0.0))
    return known, jnp.where(there, reference, known), (here & there)[0]


def mean(values: Map, sound: Mask) -> Float[Array, ""]:
    """Σ values / n over the n sound pixels, NaN for none. Gradient: 1/n at sound pixels, 0 at others."""
    total = jnp.sum(jnp.sum(jnp.where(sound, values, 0.0), axis=-1))
    return safe.divide(total, jnp.sum(sound).astype(values.dtype), jnp.nan)


def score(value: Float[Array, ""], values: Map, sound: Mask) -> Score:
    """The value, and the map with its undefined pixels marked."""
    undefined = jnp.sum(~sound, dtype=jnp.int32)
    return Score(value=value, map=jnp.where(sound, values, jnp.nan), undefined=undefined)
