"""Six metals, measured: what each mirrors head on (f0) and before grazing angles (tint), for `schlick_f82`.

Linear Rec.709 of light like D65, in [0, 1]. Derived from published n and k, interpolated linearly to every 5 nm from
380 to 780 nm: `conductor` at cosines 1 and 1/7, weighed by D65 and the CIE 1931 2° observer, to Rec.709 and clipped to
[0, 1]; f0 is the first, tint the second over Schlick's F of f0 there. The tests hold n and k and derive them again.

Gold alone is clipped: it is more saturated than Rec.709 can show, and its red is 1.038. n and k are those of clean
evaporated films; others of the same metal differ in purity, grain and oxide, iron most: its published f0 run from 0.53
to 0.90.
`schlick_f82` of these is off the exact F, derived as above, by at most 0.025 in any channel and at any angle.

Source: gold, silver, copper: Johnson and Christy 1972, "Optical Constants of the Noble Metals", Phys. Rev. B 6, 4370.
Iron, chromium: Johnson and Christy 1974, "Optical Constants of Transition Metals", Phys. Rev. B 9, 5056. Aluminium:
Rakić 1995, "Algorithm for the determination of intrinsic optical constants of metal films", Appl. Opt. 34, 4755.
All three as tabulated by Polyanskiy, refractiveindex.info.

Example:
    >>> import jax.numpy as jnp
    >>> from jaxraster.brdf.fresnel import schlick_f82
    >>> f0, tint = (jnp.array(x) for x in METALS["copper"])
    >>> [f"{x:.3f}" for x in schlick_f82(f0, tint, jnp.array(1 / 7)).tolist()]
    ['0.946', '0.755', '0.702']
"""

from typing import NamedTuple


class Metal(NamedTuple):
    """Two colours for `schlick_f82`."""

    f0: tuple[float, float, float]
    tint: tuple[float, float, float]


METALS = {
    "gold": Metal((1.0000, 0.7283, 0.3646), (0.9909, 1.0037, 0.9814)),
    "silver": Metal((0.9894, 0.9840, 0.9778), (0.9932, 0.9946, 0.9989)),
    "copper": Metal((0.9317, 0.6227, 0.5223), (0.9819, 0.9469, 0.9449)),
    "aluminium": Metal((0.9073, 0.9159, 0.9223), (0.8737, 0.9030, 0.9327)),
    "iron": Metal((0.5297, 0.5132, 0.4942), (0.7649, 0.7673, 0.8016)),
    "chromium": Metal((0.5496, 0.5560, 0.5542), (0.7407, 0.7488, 0.8139)),
}
