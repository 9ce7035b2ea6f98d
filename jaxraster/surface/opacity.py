"""Opacity: the share of the light from behind that a surface keeps away.

The base colour's alpha, as factor times texture times vertex colour, in [0, 1]. Masked materials are solid where it
reaches their cutoff and not there elsewhere, blended ones cover what is behind them in this proportion, opaque ones are
solid whatever it is.

Gradient: exact in factor, texels and vertex colours for what is blended; none through the test of a cutoff.
Source: glTF 2.0 specification, 3.9.4.
"""

from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..buffers import Visibility
from ..math.table import fetch
from ..record import record, static
from ..scene import BLEND, OPAQUE, Camera, Materials, Mesh, Scene
from .gather import Fragment, gather
from .slots import fetch_textures

CUTOFF = 0.5  # of masked materials that name none; glTF's


def alpha_modes(scene: Scene) -> Int[Array, " f"]:
    """OPAQUE, MASK or BLEND of every face."""
    modes = scene.materials.alpha_mode
    return jnp.full_like(scene.mesh.material, OPAQUE) if modes is None else modes[scene.mesh.material]


def casters(mesh: Mesh, modes: Int[Array, " f"]) -> Mesh:
    """The mesh with blended faces drawn in to a point: light that shines through them casts no shadow of them."""
    return replace(mesh, faces=jnp.where((modes == BLEND)[:, None], mesh.faces[:, :1], mesh.faces))


def opacity(fragment: Fragment, materials: Materials, fetched: dict[str, Float[Array, "*b 4"]]) -> Float[Array, "*b"]:
    """The product of the three alphas, in [0, 1]; `fetched` may hold the base colour's texture."""
    alpha = fetch(materials.base_color[:, 3], fragment.material)
    if fragment.color is not None:
        alpha = alpha * fragment.color[..., 3]
    alpha = alpha * fetched["base_color"][..., 3] if "base_color" in fetched else alpha
    return jnp.clip(alpha, 0.0, 1.0)


def blended_opacity(
    fragment: Fragment, materials: Materials, fetched: dict[str, Float[Array, "*b 4"]]
) -> Float[Array, "*b"]:
    """The opacity of blended materials, 1 for others."""
    if materials.alpha_mode is None:
        return jnp.ones_like(fragment.position[..., 0])
    blended = fetch(materials.alpha_mode, fragment.material) == BLEND
    return jnp.where(blended, opacity(fragment, materials, fetched), 1.0)


@record
class Holes:
    """Where masked materials are cut out of what is visible: their opacity is below their cutoff.

    A record, so that the loop in which it is asked is compiled once for all scenes of a size.
    """

    scene: Scene
    camera: Camera
    clip: Float[Array, "*b v 4"]
    slots: tuple = static()

    def __call__(self, visibility: Visibility) -> Bool[Array, "h w"]:
        materials, textures = self.scene.materials, self.scene.textures
        fragment = gather(self.scene, visibility, self.clip, self.camera)
        slots = tuple(slot for slot in self.slots if slot == "base_color")
        alpha = opacity(fragment, materials, fetch_textures(fragment, materials, textures, slots))
        cutoff = materials.alpha_cutoff
        return alpha < (CUTOFF if cutoff is None else fetch(cutoff, fragment.material))
