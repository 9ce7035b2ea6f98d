"""What the stages hand on, from visibility to the finished frame.

After visibility every field is per pixel with any leading shape `*b`: image, layer, sample and batch axes alike.
"""

from jaxtyping import Array, Bool, Float, Int

from .record import record


@record
class Stats:
    """What the rasterizer left out: triangles with a non-finite vertex, without any area, or with no such vertex.

    `beyond_layers` counts blended fragments in front of what is solid that found no layer free, in all samples of the
    picture; None where nothing is drawn in layers.
    """

    non_finite: Int[Array, "*b"]
    degenerate: Int[Array, "*b"]
    out_of_range: Int[Array, "*b"]
    beyond_layers: Int[Array, "*b"] | None = None


@record
class Visibility:
    """Which triangle each pixel sees: `face` (-1 for none), perspective-correct `barycentric`, reversed `depth`.

    Depth is z/w in (0, 1], 1 at the near plane, and 0 where there is nothing. `nearness` is what was compared to find
    the nearest: the bits of the snapped triangle's depth, greater is nearer, 0 for nothing.
    """

    face: Int[Array, "*b h w"]
    barycentric: Float[Array, "*b h w 3"]
    depth: Float[Array, "*b h w"]
    nearness: Int[Array, "*b h w"]
    stats: Stats


@record
class Coat:
    """A clear coat at each pixel: its `weight` in [0, 1], microfacet width, and normal, without the bumps below it."""

    weight: Float[Array, "*b"]
    alpha: Float[Array, "*b"]
    normal: Float[Array, "*b 3"]


@record
class Surface:
    """What shading needs at each pixel, in world space; where `mask` is false the values are finite and unused.

    `normal` and `geometric_normal` are unit and face the viewer, `view` is unit towards it. `f0` and `f90` are what is
    mirrored head on and at grazing angles, `alpha` is the microfacet width, roughness². `occlusion` in [0, 1] applies
    to ambient light alone. `uv` may be whole periods away from the mesh's, where its textures repeat. `opacity` in
    [0, 1] is the share of the light from behind that is kept away; None where all is drawn opaque. `coat` and
    `sheen`, linear RGB and alpha, are None where no material has them.
    """

    mask: Bool[Array, "*b"]
    position: Float[Array, "*b 3"]
    normal: Float[Array, "*b 3"]
    geometric_normal: Float[Array, "*b 3"]
    view: Float[Array, "*b 3"]
    uv: Float[Array, "*b 2"]
    diffuse_color: Float[Array, "*b 3"]
    f0: Float[Array, "*b 3"]
    f90: Float[Array, "*b"]
    alpha: Float[Array, "*b"]
    emissive: Float[Array, "*b 3"]
    occlusion: Float[Array, "*b"]
    opacity: Float[Array, "*b"] | None = None
    coat: Coat | None = None
    sheen: Float[Array, "*b 4"] | None = None


@record
class Occlusion:
    """How much of the ambient light reaches each pixel, in [0, 1], and the mean direction that it comes from.

    `bent_normal` is unit, in world space. Where there is no surface these are 1 and the surface's normal.
    """

    visibility: Float[Array, "*b"]
    bent_normal: Float[Array, "*b 3"]


@record
class Radiance:
    """Light towards the viewer, kept apart by its path until `resolve`: linear, in cd/m²."""

    direct_diffuse: Float[Array, "*b 3"]
    direct_specular: Float[Array, "*b 3"]
    indirect_diffuse: Float[Array, "*b 3"]
    indirect_specular: Float[Array, "*b 3"]
    emitted: Float[Array, "*b 3"]


@record
class Frame:
    """A finished picture and everything it was made of.

    `image` is display-encoded in [0, 1], `hdr` linear. With `Plan.supersample` above 1 these two have the plan's size
    and the others that many samples per pixel and axis. With `Plan.layers` these two show all layers and the others the
    foremost one alone: a lens, not the eye behind it, with its own light, not yet weighed by its opacity.
    """

    image: Float[Array, "*b h w 3"]
    hdr: Float[Array, "*b h w 3"]
    radiance: Radiance
    surface: Surface
    visibility: Visibility

    @property
    def stats(self) -> Stats:
        """What the rasterizer left out."""
        return self.visibility.stats
