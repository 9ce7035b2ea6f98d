"""Normals and tangents of triangles, and of vertices as means over their triangles.

A vertex takes the mean of its triangles weighed by the angle each of them spans there: unlike a plain or an
area-weighted mean, this one does not depend on how a flat region was cut into triangles, so that a cube's corner
points along its diagonal whichever way the sides were split.

Lengths may lie anywhere from 1e-30 to 1e38: edges are differences, divided by the triangle's largest before any
product is formed. A triangle with a non-finite vertex counts as degenerate and spoils neither values nor gradients of
its neighbours. Source of the weights: Thürmer and Wüthrich 1998, "Computing Vertex Normals from Polygonal Facets".
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..math.safe import TINY, dot, length, normalize
from ..math.transform import frame


def _edges(points: Float[Array, "*b v n"], faces: Int[Array, "f 3"]) -> Float[Array, "*b f 3 n"]:
    """Each triangle's edges, from corner i to i + 1, over the largest component; all 0 if that is 0 or not finite."""
    corners = points[..., faces, :]
    edges = jnp.roll(corners, -1, axis=-2) - corners
    scale = jax.lax.stop_gradient(jnp.max(jnp.abs(edges), axis=(-2, -1), keepdims=True))
    usable = (scale > TINY) & (scale < jnp.inf)
    return jnp.where(usable, edges, 0.0) / jnp.where(usable, scale, 1.0)


def _cross(edges: Float[Array, "*b f 3 3"]) -> Float[Array, "*b f 3"]:
    """Twice the triangle's vector area in the edges' scale, and 0 where rounding alone could have made it.

    A component is a difference of two products, each with a rounding error of half an eps; over three components and
    the final rounding that stays below 2 eps |a| |b|. Fused multiply-adds leave such residues even for equal edges.
    """
    a, b = edges[..., 0, :], edges[..., 1, :]
    cross = jnp.cross(a, b)
    noise = 2.0 * jnp.finfo(edges.dtype).eps
    solid = dot(cross, cross) > noise * noise * dot(a, a) * dot(b, b)
    return jnp.where(solid[..., None], cross, 0.0)


def _angles(edges: Float[Array, "*b f 3 3"], cross: Float[Array, "*b f 3"]) -> Float[Array, "*b f 3"]:
    """The angle at each corner, and 0 for degenerate triangles: atan2(|a × b|, a · b) is exact for slivers too."""
    sine = length(cross)[..., None]
    cosine = -dot(edges, jnp.roll(edges, 1, axis=-2))
    solid = sine > 0.0
    return jnp.where(solid, jnp.arctan2(sine, jnp.where(solid, cosine, 1.0)), 0.0)


def _lay(v: Float[Array, "*b 3"], n: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """v laid into the plane perpendicular to unit n: v - n (n · v)."""
    return v - n * dot(n, v)[..., None]


def _sum_corners(values: Float[Array, "*b f 3 n"], faces: Int[Array, "f 3"], num: int) -> Float[Array, "*b num n"]:
    """At each vertex, the sum over the corners that meet there."""
    total = jnp.zeros((*values.shape[:-3], num, values.shape[-1]), values.dtype)
    return total.at[..., faces, :].add(values)


def face_normals(vertices: Float[Array, "*b v 3"], faces: Int[Array, "f 3"]) -> Float[Array, "*b f 3"]:
    """Unit normals towards the side from which the corners run counter-clockwise; 0 for degenerate triangles.

    Degenerate: an angle's sine below 2 eps, a non-finite vertex, or no edge above 1e-30.
    Gradient: exact; 0 for degenerate triangles.
    """
    return normalize(_cross(_edges(vertices, faces)))


def vertex_normals(vertices: Float[Array, "*b v 3"], faces: Int[Array, "f 3"]) -> Float[Array, "*b v 3"]:
    """Unit angle-weighted means of the normals around; +Y where no triangle with an area is.

    n ∝ Σ angle · face normal.
    Gradient: exact, through angles and normals; 0 where +Y was put.
    """
    edges = _edges(vertices, faces)
    cross = _cross(edges)
    weighted = _angles(edges, cross)[..., None] * normalize(cross)[..., None, :]
    total = _sum_corners(weighted, faces, vertices.shape[-2])
    up = jnp.broadcast_to(jnp.array([0.0, 1.0, 0.0], total.dtype), total.shape)
    return normalize(jnp.where(dot(total, total)[..., None] > 0.0, total, up))


def vertex_tangents(
    vertices: Float[Array, "*b v 3"],
    normals: Float[Array, "*b v 3"],
    uvs: Float[Array, "*b v 2"],
    faces: Int[Array, "f 3"],
) -> Float[Array, "*b v 4"]:
    """Unit tangents perpendicular to the unit `normals`, and in w the sign of the bitangent w · n × t.

    In each triangle position is linear in uv, and t = ∂p/∂u points to the image's right. The bitangent, along which a
    normal map's green points, is the image's up: -∂p/∂v, since v counts down from the top. So w = 1 where the image
    is seen upright and -1 where it is mirrored. A vertex takes the angle-weighted mean of the directions, each first
    laid into its tangent plane. Where uvs give none, t is `transform.frame(n)`'s and w = 1.

    Vertices must be split where uvs change their orientation: one shared by both gets the mean of contrary frames.
    Gradient: exact in vertices, normals and uvs; 0 in vertices and uvs where these have no area; none through w.
    Source: Lengyel 2001, "Computing Tangent Space Basis Vectors for an Arbitrary Mesh"; weights and sign follow
    MikkTSpace (Mikkelsen 2008), which also splits vertices.
    """
    edges, slopes = _edges(vertices, faces), _edges(uvs, faces)
    (du1, dv1), (du2, dv2) = (jnp.moveaxis(slopes[..., i, :], -1, 0) for i in (0, 1))
    area = du1 * dv2 - du2 * dv1
    # Drop a triangle whose uv area is within rounding of 0, by the same bound as `_cross`.
    noise = 2.0 * jnp.finfo(uvs.dtype).eps
    solid = area * area > noise * noise * (du1 * du1 + dv1 * dv1) * (du2 * du2 + dv2 * dv2)
    sign = jnp.where(solid, jnp.sign(area), 0.0)[..., None]
    right = sign * (dv2[..., None] * edges[..., 0, :] - dv1[..., None] * edges[..., 1, :])

    # Average directions and orientations over the corners that meet at a vertex.
    n = normals[..., faces, :]
    right = normalize(_lay(jnp.broadcast_to(right[..., None, :], n.shape), n))
    upright = jnp.broadcast_to(-sign[..., None, :], (*n.shape[:-1], 1))
    weights = _angles(edges, _cross(edges))[..., None]
    total = _sum_corners(weights * jnp.concatenate([right, upright], axis=-1), faces, vertices.shape[-2])
    tangent, upright = total[..., :3], total[..., 3:]
    found = dot(tangent, tangent)[..., None] > 0.0
    tangent = normalize(_lay(jnp.where(found, tangent, frame(normals)[0]), normals))
    return jnp.concatenate([tangent, jnp.where(upright < 0.0, -1.0, 1.0).astype(tangent.dtype)], axis=-1)
