"""The textures of a material's slots at every pixel, each at the uv that its slot asks for.

RGBA as stored, linear for colours. Gradient: exact in texels, and in uv and footprint what `texture` has.
Source: KHR_texture_transform.
"""

import functools

import jax
import jax.numpy as jnp
from jax import lax

from ..math.table import fetch
from ..scene import TEXTURE_SLOTS, Materials, Textures
from .gather import Fragment
from .texture import lookup


def _place(fragment: Fragment, materials: Materials, slot: str):
    """The uv at which a slot's texture is looked up, and its footprint: of the right set, under the map of the slot."""
    column, uv, footprint = TEXTURE_SLOTS.index(slot), fragment.uv, fragment.footprint
    if materials.uv_sets is not None and fragment.second_uv is not None and fragment.second_footprint is not None:
        second = (fetch(materials.uv_sets[:, column], fragment.material) == 1)[..., None]
        uv = jnp.where(second, fragment.second_uv, uv)
        footprint = jnp.where(second[..., None], fragment.second_footprint, footprint)
    if materials.uv_transforms is not None:
        rows = fetch(materials.uv_transforms[:, column].reshape(-1, 6), fragment.material)
        rows = rows.reshape(*rows.shape[:-1], 2, 3)
        # Written out as sums: a product of matrices would be rounded to TF32 on an accelerator.
        uv = jnp.sum(rows[..., :2] * uv[..., None, :], axis=-1) + rows[..., 2]
        footprint = jnp.sum(rows[..., :2, None] * footprint[..., None, :, :], axis=-2)
    return uv, footprint


@functools.partial(jax.jit, static_argnames="slots")
def fetch_textures(fragment: Fragment, materials: Materials, textures: Textures, slots: tuple[str, ...]) -> dict:
    """RGBA of each slot's texture at every pixel: one loop over the slots, so that the lookup is compiled once."""
    if not slots:
        return {}
    index = [fetch(getattr(materials, f"{slot}_texture"), fragment.material).astype(jnp.int32) for slot in slots]
    if materials.uv_sets is None and materials.uv_transforms is None:
        values = lax.map(lambda row: lookup(textures, row, fragment.uv, fragment.footprint), jnp.stack(index))
    else:
        uv, footprint = (jnp.stack(each) for each in zip(*(_place(fragment, materials, slot) for slot in slots)))
        values = lax.map(lambda place: lookup(textures, *place), (jnp.stack(index), uv, footprint))
    return dict(zip(slots, values))
