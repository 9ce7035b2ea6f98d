"""The geometry under each pixel: one row of its face's corner attributes, combined by the barycentrics.

World space. Gradient: exact in vertices, attributes and camera, for the faces that are visible.
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ..buffers import Visibility
from ..geometry.normals import face_normals
from ..math import safe
from ..math.table import fetch
from ..record import record
from ..scene import CLAMP, TEXTURE_SLOTS, Camera, Scene
from ..visibility.barycentric import combine, corners_at, rows, spread


@record
class Fragment:
    """Interpolated geometry per pixel; vectors are unit but for the tangent, which `normal_map` straightens.

    `footprint` is ∂uv/∂(pixel right, down). What the mesh does not have is None.
    """

    mask: Bool[Array, "*b"]
    material: Int[Array, "*b"]
    position: Float[Array, "*b 3"]
    normal: Float[Array, "*b 3"]
    geometric_normal: Float[Array, "*b 3"]
    tangent: Float[Array, "*b 4"]
    view: Float[Array, "*b 3"]
    uv: Float[Array, "*b 2"]
    footprint: Float[Array, "*b 2 2"]
    second_uv: Float[Array, "*b 2"] | None
    second_footprint: Float[Array, "*b 2 2"] | None
    color: Float[Array, "*b 4"] | None


def _uvs_near_origin(uvs: Float[Array, "v 2"], scene: Scene) -> Float[Array, "f 6"]:
    """Corner uvs per face, less an even whole number where the material's textures all repeat or mirror there.

    Far from the origin float32 has no bits left between texels; the shift changes no texel that is fetched. Uvs that
    may be mapped before they are looked up stay: whole numbers need not be whole then, and the map has a gradient.
    """
    materials, corners = scene.materials, uvs[scene.mesh.faces]
    if materials.uv_transforms is not None:
        return corners.reshape(-1, 6)
    slots = [getattr(materials, f"{slot}_texture") for slot in TEXTURE_SLOTS]
    clamps = [(scene.textures.wrap[jnp.maximum(slot, 0)] == CLAMP) & (slot >= 0)[:, None] for slot in slots]
    clamped = jnp.any(jnp.stack(clamps), axis=0)[scene.mesh.material]
    shift = 2.0 * jnp.floor(0.5 * jnp.min(lax.stop_gradient(corners), axis=1))
    shift = jnp.where(clamped | ~jnp.isfinite(shift), 0.0, shift)
    return (corners - shift[:, None, :]).reshape(-1, 6)


def _unless_zero(vectors, otherwise):
    return jnp.where(safe.dot(vectors, vectors)[..., None] > 0, vectors, otherwise)


def view_direction(position: Float[Array, "*b 3"], camera: Camera) -> Float[Array, "*b 3"]:
    """Unit vectors towards the viewer: to the eye, or backwards for a parallel projection."""
    eye, back = (jnp.broadcast_to(camera.world_from_view[:3, i], position.shape) for i in (3, 2))
    perspective = camera.clip_from_view[3, 2] != 0
    return _unless_zero(safe.unit(jnp.where(perspective, eye - position, back)), back)


def gather(scene: Scene, visibility: Visibility, clip: Float[Array, "v 4"], camera: Camera) -> Fragment:
    """Fetch and interpolate; normals are turned to face the viewer. Under `jit`, what is not read is not computed."""
    mesh, face = scene.mesh, visibility.face
    mask = face >= 0

    def finite(attributes):
        # Mask what is not finite before it is weighed: behind a zero cotangent it would still make NaN.
        return jnp.where(jnp.isfinite(attributes), attributes, 0.0)

    def weigh(attributes):
        # `interpolate` without its checks: the scene has passed them.
        return combine(corners_at(attributes, mesh.faces, face), visibility.barycentric)

    position = weigh(mesh.vertices)
    view = view_direction(position, camera)
    # Where there is no surface, or none with a direction, face the viewer: nothing downstream meets a zero vector.
    flat = _unless_zero(rows(face_normals(mesh.vertices, mesh.faces), face, jnp.zeros(3, view.dtype)), view)
    normal = _unless_zero(safe.unit(weigh(finite(mesh.normals))), flat)
    turn = jnp.where(safe.dot(flat, view) < 0, -1.0, 1.0).astype(normal.dtype)[..., None]

    def place(uvs):
        corners = rows(finite(_uvs_near_origin(uvs, scene)), face, jnp.zeros(6, uvs.dtype))
        return combine(corners, visibility.barycentric), spread(corners, clip, mesh.faces, visibility)

    uv, footprint = place(mesh.uvs)
    second_uv, second_footprint = (None, None) if mesh.second_uvs is None else place(mesh.second_uvs)
    # Seen from behind, the mapped normal is the opposite of the front's: turn all axes, and the sign with them.
    tangent = turn * weigh(finite(mesh.tangents))
    # Append a row for pixels without a face, also where the mesh has none at all.
    material = jnp.concatenate([mesh.material, jnp.zeros(1, mesh.material.dtype)])
    return Fragment(
        mask=mask,
        material=fetch(material, jnp.where(mask, face, mesh.material.shape[0])),
        position=position,
        normal=turn * normal,
        geometric_normal=turn * flat,
        tangent=tangent,
        view=view,
        uv=uv,
        footprint=footprint,
        second_uv=second_uv,
        second_footprint=second_footprint,
        color=None if mesh.colors is None else weigh(finite(mesh.colors)),
    )
