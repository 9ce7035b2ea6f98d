"""Reflectance: published point values, the axioms (normalization, reciprocity, energy), accuracy, and ugly points.

The integrals that `standard` looks up are tested in `test_energy.py`."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.brdf import blinn_phong as blinn_phong_file
from jaxraster.brdf import gltf as gltf_file
from jaxraster.brdf import standard as standard_file
from jaxraster.brdf.compensation import compensation
from jaxraster.brdf.distribution import ggx
from jaxraster.brdf.energy import directional_albedo
from jaxraster.brdf.energy_table import integrate
from jaxraster.brdf.fresnel import schlick
from jaxraster.brdf.masking import smith_correlated
from jaxraster.buffers import Surface
from jaxraster.surface.material import metallic_roughness

PLAIN = {"standard": standard_file.standard, "gltf": gltf_file.gltf, "local": blinn_phong_file.blinn_phong}
standard, gltf, blinn_phong = (jax.jit(brdf) for brdf in PLAIN.values())
MODELS = dict(zip(PLAIN, (standard, gltf, blinn_phong)))
D, V, ALBEDO = jax.jit(ggx), jax.jit(smith_correlated), jax.jit(directional_albedo)
Z = np.array([0.0, 0.0, 1.0])
SIDE = 128  # samples per axis of a quadrature, the same everywhere: one compiled shape
SMOOTHEST = 0.045**2


def single(x) -> jax.Array:
    return jnp.asarray(np.asarray(x, np.float32))


def surface(view, *, normal=Z, diffuse=0.0, f0=0.04, alpha=0.25) -> Surface:
    """A surface at the origin seen along each of `view` `[*b 3]`; the other arguments broadcast against it."""
    view = single(view)

    def triple(x):
        x = np.asarray(x, np.float32)
        return single(np.broadcast_to(x[..., None] if x.ndim != view.ndim else x, view.shape))

    zero, one = jnp.zeros_like(view), jnp.ones(view.shape[:-1])
    normal = single(np.broadcast_to(normal, view.shape))
    return Surface(
        mask=one > 0,
        position=zero,
        normal=normal,
        geometric_normal=normal,
        view=view,
        uv=zero[..., :2],
        diffuse_color=triple(diffuse),
        f0=triple(f0),
        f90=one,
        alpha=single(np.broadcast_to(alpha, one.shape)),
        emissive=zero,
        occlusion=one,
    )


def towards(theta, phi=0.0) -> np.ndarray:
    """Unit vectors at angle theta from +Z, in radians."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


# Worked out in double precision for v 40° and l 25° from the normal, 120° apart.
VIEW, LIGHT = towards(np.radians(40)), towards(np.radians(25), np.radians(120))
HALF = (VIEW + LIGHT) / np.linalg.norm(VIEW + LIGHT)


@pytest.mark.parametrize(
    ("roughness", "d", "v"),
    [
        (0.1, 0.0030122184, 0.3600811),
        (0.3, 0.21317777, 0.35941948),
        (0.5, 0.78902858, 0.35502356),
        (1.0, 0.31830989, 0.29898008),
    ],
)
def test_point_values_of_distribution_and_masking(roughness, d, v):
    alpha = single([roughness**2])
    np.testing.assert_allclose(D(single([Z]), single([HALF]), alpha), [d], rtol=1e-5)
    np.testing.assert_allclose(V(single([VIEW[2]]), single([LIGHT[2]]), alpha), [v], rtol=1e-5)


@pytest.mark.parametrize(("metallic", "f"), [(0.0, 0.16399627), (1.0, 0.14006497), (0.25, 0.14428662)])
def test_point_values_of_gltf(metallic, f):
    """The specification's final form; the mix of a dielectric's and a metal's result would be 0.15801345 at 0.25."""
    base, metallic, roughness = single([[0.5] * 3]), single([metallic]), single([0.5])
    diffuse, f0, alpha, _ = (np.asarray(x) for x in metallic_roughness(base, metallic, roughness))
    parts = gltf(surface([VIEW], diffuse=diffuse, f0=f0, alpha=alpha), single([LIGHT]))
    np.testing.assert_allclose((parts[0] + parts[1]) / LIGHT[2], [[f] * 3], rtol=1e-5)


def test_the_peak_of_the_distribution():
    alpha = single([0.1, SMOOTHEST, 1.0])
    n = single([Z] * 3)
    np.testing.assert_allclose(D(n, n, alpha), 1 / (np.pi * np.array([0.1, SMOOTHEST, 1.0]) ** 2), rtol=1e-6)
    # At alpha = 1 it is the same everywhere above the horizon, and 0 below.
    h = single(towards([0.3, 1.5, 1.6]))
    np.testing.assert_allclose(D(n, h, jnp.ones(3)), [1 / np.pi, 1 / np.pi, 0], rtol=1e-6)


@pytest.mark.parametrize("alpha", [SMOOTHEST, 0.01, 0.0625, 0.25, 1.0])
def test_the_distribution_covers_the_surface_once(alpha):
    """∫ D (n·h) dh = 1, with tan θ = α s/(1 - s) and Gauss's points in s."""
    s, weight = np.polynomial.legendre.leggauss(SIDE)
    s, weight = 0.5 * (s + 1), 0.5 * weight
    x = s / (1 - s)
    theta, step = np.arctan(alpha * x), alpha / (1 + (alpha * x) ** 2) / (1 - s) ** 2
    d = np.asarray(D(single([Z] * SIDE), single(towards(theta)), single(np.full(SIDE, alpha))), np.float64)
    np.testing.assert_allclose((d * np.cos(theta) * np.sin(theta) * 2 * np.pi * step * weight).sum(), 1, atol=2e-6)


@pytest.mark.parametrize("alpha", [0.01, 0.0625, 0.25, 1.0])
@pytest.mark.parametrize("n_dot_v", [0.05, 0.3, 0.7, 1.0])
def test_weak_white_furnace(alpha, n_dot_v):
    """∫ G₁(v) D max(0, v·h) dh / n·v = 1: the microfacets seen from v cover v's view of the surface exactly once.

    Lit along the normal, nothing is shadowed, so that G₁(v) = 4 (n·v) V(n·v, 1).
    """
    s, weight = np.polynomial.legendre.leggauss(SIDE)
    s, weight = 0.5 * (s + 1), 0.5 * weight
    x = s / (1 - s)
    theta, step = np.arctan(alpha * x), alpha / (1 + (alpha * x) ** 2) / (1 - s) ** 2
    # v·h > 0 for |φ| below an angle of its own for every θ: Gauss's points up to there have no kink to straddle.
    sine = np.sqrt(1 - n_dot_v**2)
    limit = np.arccos(np.clip(-n_dot_v * np.cos(theta) / np.maximum(sine * np.sin(theta), 1e-300), -1, 1))
    phi = limit[:, None] * s[None, :]
    h = towards(theta[:, None], phi)
    d = np.asarray(D(single(np.broadcast_to(Z, h.shape)), single(h), single(np.full(h.shape[:2], alpha))), np.float64)
    v_dot_h = h @ np.array([sine, 0, n_dot_v])
    area = d * np.maximum(v_dot_h, 0) * (np.sin(theta) * step * weight)[:, None] * 2 * limit[:, None] * weight
    masking = float(V(single([n_dot_v]), single([1.0]), single([alpha]))[0])
    np.testing.assert_allclose(4 * masking * area.sum(), 1, atol=2e-5)


@pytest.mark.parametrize("model", MODELS)
def test_reciprocity(model):
    """f(l, v) = f(v, l); what is returned carries n·l besides, and the standard lobe its factor of v."""
    rng = np.random.default_rng(1)
    count = 1024
    a, b = (towards(np.arccos(rng.uniform(0.01, 1, count)), rng.uniform(0, 7, count)).astype(np.float32) for _ in "ab")
    alpha = rng.uniform(0.045, 1, count) ** 2
    diffuse, f0 = rng.uniform(0, 1, (2, count, 3))
    every = []
    for v, l in ((a, b), (b, a)):
        gain = np.ones((count, 3))
        if model == "standard":
            gain = np.asarray(compensation(single(f0), single(v[:, 2]), single(alpha)), np.float64)
        parts = MODELS[model](surface(v, diffuse=diffuse, f0=f0, alpha=alpha), single(l))
        diffuse_part, specular_part = (np.asarray(part, np.float64) / l[:, 2:] for part in parts)
        every.append((diffuse_part, specular_part / gain))
    for one, other in zip(*every):
        assert (one > 0).all() or model == "local"
        np.testing.assert_allclose(one, other, rtol=3e-6, atol=1e-30)


def test_rotating_everything_changes_nothing():
    rng = np.random.default_rng(2)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    there = standard(surface([VIEW], diffuse=0.5), single([LIGHT]))
    turned = standard(surface([q @ VIEW], normal=q @ Z, diffuse=0.5), single([q @ LIGHT]))
    for one, other in zip(there, turned):
        np.testing.assert_allclose(one, other, rtol=2e-6)


def test_schlick():
    f0 = single([[0.0, 0.04, 1.0]] * 4)
    cosine = single([1.0, 0.5, 0.0, 0.9])
    exact = np.float64(f0) + (1 - np.float64(f0)) * (1 - np.float64(cosine)[:, None]) ** 5
    np.testing.assert_allclose(schlick(f0, cosine), exact, rtol=2e-7)
    assert (schlick(f0, cosine)[2] == 1).all()
    # Ordered in the angle, and never outside [f0, 1].
    angles = single(np.cos(np.linspace(0, np.pi / 2, 1000)))
    f = np.asarray(schlick(jnp.full((1000, 3), 0.04), angles))
    assert (np.diff(f, axis=0) >= 0).all() and f.min() == np.float32(0.04) and f.max() <= 1


def test_f90_is_what_is_mirrored_at_grazing_angles():
    """F is f90 at 90°, the lobe's albedo is linear in it, and a surface without f0 and f90 mirrors nothing."""
    f0, f90 = single([[0.04, 0.1, 0.5]] * 2), single([0.5, 0.0])
    np.testing.assert_allclose(schlick(f0, single([0.0, 0.0]), f90), [[0.5] * 3, [0.0] * 3])
    np.testing.assert_allclose(schlick(f0, single([1.0, 1.0]), f90), f0)
    cosine, alpha = single([0.3, 0.3]), single([0.25, 0.25])
    half, none = np.asarray(directional_albedo(f0, cosine, alpha, f90), np.float64)
    whole = np.asarray(directional_albedo(f0, cosine, alpha), np.float64)[0]
    np.testing.assert_allclose(half - none, 0.5 * (whole - none), rtol=1e-5)
    assert (whole > half).all() and (half > none).all()
    here = dataclasses.replace(surface([VIEW], f0=0.0), f90=single([0.0]))
    assert (standard(here, single([LIGHT]))[1] == 0).all()
    lit = standard(surface([VIEW], f0=0.0), single([LIGHT]))[1]
    weighed = standard(dataclasses.replace(here, f90=single([0.25])), single([LIGHT]))[1]
    assert (lit > 0).all()
    np.testing.assert_allclose(weighed, 0.25 * lit, rtol=1e-6)


def test_a_cosine_beyond_one_counts_as_one():
    beyond = jnp.array([1.0 + 1.2e-7, -1.0, jnp.nextafter(jnp.float32(0), jnp.float32(-1))])
    assert (beyond[:1] > 1).all()
    f0 = jnp.zeros((3, 3))
    np.testing.assert_array_equal(schlick(f0, beyond), [[0.0] * 3, [1.0] * 3, [1.0] * 3])
    slopes = jax.vmap(jax.grad(lambda c: schlick(jnp.zeros(3), c)[0]))
    # Outside there is no slope; at the upper end the slope itself is 0, at the lower the clamp halves its -5.
    np.testing.assert_array_equal(slopes(jnp.array([1.5, 1.0, 0.0, -0.5])), [0, 0, -2.5, 0])


@pytest.mark.parametrize("alpha", [SMOOTHEST, 0.01, 0.0625, 1.0])
@pytest.mark.parametrize("theta", [0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.5])
def test_the_distribution_is_as_exact_as_its_vectors(alpha, theta):
    """Against double precision on the same float32 vectors, in any direction: a highlight's peak does not flicker."""
    rng = np.random.default_rng(3)
    n = rng.normal(size=(4096, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t = np.cross(n, rng.normal(size=(4096, 3)))
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    n, h = n.astype(np.float32), (n * np.cos(theta) + t * np.sin(theta)).astype(np.float32)
    alpha = np.float32(alpha)
    n2, h2, a2 = n.astype(np.float64), h.astype(np.float64), np.float64(alpha)
    k = a2 / ((np.cross(n2, h2) ** 2).sum(axis=1) + ((n2 * h2).sum(axis=1) * a2) ** 2)
    np.testing.assert_allclose(D(single(n), single(h), single(np.full(4096, alpha))), k * k / np.pi, rtol=1.5e-6)


# -- Energy ------------------------------------------------------------------------------------------------------------


def grid() -> tuple[np.ndarray, np.ndarray]:
    u = (np.arange(SIDE) + 0.5) / SIDE
    return tuple(x.ravel() for x in np.meshgrid(u, u, indexing="ij"))


def visible_normals(view, alpha) -> tuple[np.ndarray, np.ndarray]:
    """Directions mirrored at GGX normals seen from `view` (Heitz 2018), and their density per steradian.

    Where u₁ nears 1 lie the few normals far from the peak, which throw light into the surface: u₁ = s (2 - s) puts
    more samples there, of density 1/(2 (1 - s)).
    """
    s, u2 = grid()
    u1, dense = s * (2 - s), 0.5 / (1 - s)
    stretched = view * [alpha, alpha, 1]
    stretched /= np.linalg.norm(stretched)
    side = np.array([-stretched[1], stretched[0], 0]) if stretched[2] < 1 else np.array([1.0, 0, 0])
    side /= np.linalg.norm(side)
    a, b = np.sqrt(u1) * np.cos(2 * np.pi * u2), np.sqrt(u1) * np.sin(2 * np.pi * u2)
    s = 0.5 * (1 + stretched[2])
    b = (1 - s) * np.sqrt(1 - a * a) + s * b
    c = np.sqrt(np.maximum(1 - a * a - b * b, 0))
    h = a[:, None] * side + b[:, None] * np.cross(stretched, side) + c[:, None] * stretched
    h = h * [alpha, alpha, 1]
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    mu, a2 = view[2], alpha * alpha
    d = a2 / (np.pi * ((h[:, :2] ** 2).sum(axis=1) + a2 * h[:, 2] ** 2) ** 2)
    masking = 2 * mu / (mu + np.sqrt(a2 + (1 - a2) * mu * mu))
    return 2 * (h @ view)[:, None] * h - view, dense * d * masking / (4 * mu)


def cosine_weighted() -> tuple[np.ndarray, np.ndarray]:
    u1, u2 = grid()
    l = towards(np.arcsin(np.sqrt(u1)), 2 * np.pi * u2)
    return l, l[:, 2] / np.pi


@functools.cache
def albedos(n_dot_v: float, roughness: float, diffuse: tuple, f0: tuple, brdf=gltf) -> np.ndarray:
    """∫ f (n·l) dl of the diffuse and of the specular part, one by cosine-weighted, one by visible-normal samples, for
    the three colours of `diffuse` and `f0`: `[2, 3]`."""
    alpha = max(roughness, 0.045) ** 2
    view = towards(np.arccos(n_dot_v))
    whole = np.broadcast_to(view, (SIDE * SIDE, 3))
    here = surface(whole, diffuse=np.array(diffuse) + 0 * whole, f0=np.array(f0) + 0 * whole, alpha=alpha)
    parts = []
    for part, (l, density) in enumerate((cosine_weighted(), visible_normals(view, alpha))):
        value = np.asarray(brdf(here, single(l))[part], np.float64)
        # Directions below the horizon carry nothing; float32 may put one that grazes it on either side.
        parts.append(np.where(l[:, 2:] > 0, value / density[:, None], 0).mean(axis=0))
    return np.array(parts)


def albedo(n_dot_v: float, roughness: float, diffuse: float, f0: float, brdf=gltf) -> tuple[float, float]:
    """The same of one grey."""
    return tuple(albedos(n_dot_v, roughness, (diffuse,) * 3, (f0,) * 3, brdf)[:, 0])


# (roughness, n·v): E = A + B, the albedo for f0 = 1, by double-precision quadrature of the same lobe.
E_TABLE = {
    (0.1, 0.05): 0.97621, (0.1, 0.25): 0.99909, (0.1, 1.0): 0.99990,
    (0.3, 0.05): 0.90744, (0.3, 0.1): 0.88432, (0.3, 0.5): 0.97509, (0.3, 1.0): 0.99067,
    (0.5, 0.05): 0.93313, (0.5, 0.1): 0.89162, (0.5, 0.25): 0.84008, (0.5, 0.75): 0.89153, (0.5, 1.0): 0.91581,
    (0.8, 0.1): 0.83306, (0.8, 0.5): 0.62122, (0.8, 1.0): 0.55517,
    (1.0, 0.05): 0.84777, (1.0, 0.25): 0.59764, (1.0, 0.5): 0.45069, (1.0, 1.0): 1 - np.log(2),
}  # fmt: skip
# The same for f0 = 0: B, the part that Schlick's (1 - v·h)⁵ adds.
B_TABLE = {
    (0.1, 0.05): 0.73366, (0.1, 0.1): 0.57835, (0.1, 0.25): 0.23616, (0.1, 0.75): 0.00100, (0.1, 1.0): 0.0,
    (0.3, 0.05): 0.36836, (0.3, 0.25): 0.17829, (0.3, 1.0): 0.00001,
    (0.5, 0.05): 0.16431, (0.5, 0.5): 0.02235, (0.5, 1.0): 0.00003,
    (0.8, 0.1): 0.04420, (0.8, 0.5): 0.00687,
    (1.0, 0.05): 0.03209, (1.0, 0.25): 0.01088, (1.0, 1.0): 0.00003,
}  # fmt: skip


@pytest.mark.parametrize(("table", "f0"), [(E_TABLE, 1.0), (B_TABLE, 0.0)])
def test_the_specular_lobe_reflects_what_is_published(table, f0):
    measured = [albedo(n_dot_v, roughness, 0.0, f0)[1] for roughness, n_dot_v in table]
    np.testing.assert_allclose(measured, list(table.values()), atol=4e-4)


def test_one_bounce_never_reflects_more_than_it_gets():
    every = {
        (r, c): albedo(c, r, 0.0, 1.0)[1] for r in (0.0, 0.1, 0.2, 0.5, 0.8, 1.0) for c in (0.002, 0.01, 0.1, 0.5, 1)
    }
    assert max(every.values()) < 1.0005
    # Single scattering loses light on rough metal: 69 % head on at roughness 1.
    np.testing.assert_allclose(every[1.0, 1], 1 - np.log(2), atol=2e-4)


def test_a_white_dielectric_of_gltf_exceeds_one_as_documented():
    """glTF weighs the diffuse by 1 - F(v·h): seen along the surface but lit from above, h is far from v and F small."""
    seen = (0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 1.0)
    white = {r: [sum(albedo(c, r, 1.0, 0.04)) for c in seen] for r in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)}
    print(white)
    for roughness, most in {0.0: 1.86, 0.4: 1.24, 1.0: 1.01}.items():
        np.testing.assert_allclose(white[roughness][0], most, atol=0.006)
    # The excess is largest at the smallest angle and roughness, and gone from 40° on.
    assert max(max(row) for row in white.values()) == white[0.0][0]
    assert max(max(row[5:]) for row in white.values()) < 1


ANGLES = (0.002, 0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
ROUGH = (0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0)
TOLERANCE = 0.003  # what the table is off, and what this quadrature is


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_what_is_white_returns_all_of_uniform_light(metallic):
    """A dielectric of ior 1.5 and a metal alike, at every angle and roughness: in a white furnace both vanish."""
    f0 = 0.04 + 0.96 * metallic
    every = {(r, c): sum(albedo(c, r, 1 - metallic, f0, standard)) for r in ROUGH for c in ANGLES}
    print(min(every.values()), max(every.values()))
    np.testing.assert_allclose(list(every.values()), 1, atol=TOLERANCE)


@pytest.mark.parametrize("metallic", [0.0, 0.2, 0.5, 0.8, 1.0])
def test_nothing_returns_more_than_it_gets(metallic):
    """Dark, middling and white, mixed with metal or not, at every angle and roughness; nor does any colour gain."""
    base = np.array([0.0, 0.5, 1.0])
    diffuse, f0 = tuple(base * (1 - metallic)), tuple(0.04 + metallic * (base - 0.04))
    every = np.array([albedos(c, r, diffuse, f0, standard).sum(axis=0) for r in ROUGH for c in ANGLES])
    print(every.max(axis=0))
    assert every.min() > 0 and every.max() < 1 + TOLERANCE
    assert (np.diff(every, axis=1) > -TOLERANCE).all(), "lighter colours return more"


@pytest.mark.parametrize(("f0", "roughness"), [(0.0, 0.3), (0.17, 0.6), (0.5, 0.2), (0.9, 1.0), (0.99999, 0.4)])
def test_other_dielectrics_return_all_of_it_too(f0, roughness):
    """From glass without reflection to diamond and beyond: what is mirrored is not diffuse."""
    for cosine in (0.05, 0.5, 1.0):
        np.testing.assert_allclose(sum(albedo(cosine, roughness, 1.0, f0, standard)), 1, atol=TOLERANCE)


def test_gltf_and_blinn_phong_return_too_much():
    """What `standard` is measured against: white dielectrics, summed over both parts."""
    for brdf, least in ((gltf, 1.6), (blinn_phong, 1.04)):
        assert max(sum(albedo(c, r, 1.0, 0.04, brdf)) for r in (0.0, 0.2, 0.6) for c in (0.05, 1.0)) > least
    assert sum(albedo(1.0, 1.0, 0.0, 1.0, gltf)) < 0.31


def test_metal_between_the_two_stays_below_them():
    every = [
        sum(albedo(c, r, 1 - m, 0.04 + 0.96 * m, brdf))
        for m in (0.5, 0.75)
        for r in (0.3, 0.6, 1.0)
        for c in (0.1, 0.5)
        for brdf in (gltf, standard)
    ]
    assert max(every) < 1


@pytest.mark.parametrize(("roughness", "f0", "f90"), [(0.2, 0.04, 1.0), (0.5, 0.3, 1.0), (1.0, 0.04, 0.5)])
def test_standard_against_its_formula(roughness, f0, f90):
    """In double precision, with A and B by quadrature rather than from the table."""
    alpha, color = roughness**2, 0.8
    x, weight = np.polynomial.legendre.leggauss(48)
    mu, weight = np.append((0.5 + 0.5 * x) ** 2, [VIEW[2], LIGHT[2]]), weight * (0.5 + 0.5 * x)
    a, b = integrate(mu, np.full(50, alpha))
    mirrored = (f0 * a + f90 * b) * (1 + f0 * (1 / (a + b) - 1))
    mean = 2 * (mirrored[:48] * mu[:48] * weight).sum()
    diffuse = color / np.pi * (1 - mirrored[48]) * (1 - mirrored[49]) / (1 - mean)
    k = alpha / (1 - HALF[2] ** 2 + (alpha * HALF[2]) ** 2)
    smith = [np.sqrt(c**2 + alpha**2 * (1 - c**2)) for c in mu[48:]]
    fresnel = f0 + (f90 - f0) * (1 - VIEW @ HALF) ** 5
    lobe = fresnel * k * k / np.pi * 0.5 / (mu[49] * smith[0] + mu[48] * smith[1])
    here = dataclasses.replace(surface([VIEW], diffuse=color, f0=f0, alpha=alpha), f90=single([f90]))
    parts = standard(here, single([LIGHT]))
    np.testing.assert_allclose(parts[0][0, 0], diffuse * LIGHT[2], rtol=1e-3)
    np.testing.assert_allclose(parts[1][0, 0], lobe * (1 + f0 * (1 / sum((a, b))[48] - 1)) * LIGHT[2], rtol=1e-3)


@pytest.mark.parametrize("roughness", [0.045, 0.1, 0.4, 1.0])
def test_single_precision_is_enough(roughness):
    """The whole BRDF within 1e-5 of double precision on the same vectors, in the peak and far from it."""
    rng = np.random.default_rng(7)
    v = towards(rng.uniform(0, 1.4, 1024), rng.uniform(0, 7, 1024))
    h = towards(np.arctan(roughness**2 * np.abs(rng.standard_cauchy(1024))), rng.uniform(0, 7, 1024))
    l = 2 * (v * h).sum(axis=1, keepdims=True) * h - v
    here = surface(v, diffuse=rng.uniform(0, 1, (1024, 3)), f0=rng.uniform(0, 1, (1024, 3)), alpha=roughness**2)
    parts = np.array(standard(here, single(l)))
    with jax.enable_x64(True):
        double = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64) if x.dtype == jnp.float32 else x, (here, single(l)))
        exact = np.array(standard(*double))
    assert exact.dtype == np.float64
    np.testing.assert_allclose(parts, exact, rtol=1e-5, atol=1e-7)


# -- Blinn–Phong -------------------------------------------------------------------------------------------------------


def test_blinn_phong_against_its_formula():
    rng = np.random.default_rng(4)
    v, l = (towards(np.arccos(rng.uniform(0.1, 1, 512)), rng.uniform(0, 7, 512)) for _ in "vl")
    alpha, color, f0 = rng.uniform(0.05, 1, 512), rng.uniform(0, 1, (512, 3)), rng.uniform(0, 1, (512, 3))
    h = (v + l) / np.linalg.norm(v + l, axis=1, keepdims=True)
    s = 2 / alpha**2 - 2
    exact = f0 * ((s + 8) / (8 * np.pi) * h[:, 2] ** s * l[:, 2])[:, None]
    diffuse, specular = blinn_phong(surface(v, diffuse=color, f0=f0, alpha=alpha), single(l))
    np.testing.assert_allclose(diffuse, color * l[:, 2:] / np.pi, rtol=1e-6)
    # A rounding of n·h counts s times.
    np.testing.assert_allclose(specular, exact, rtol=3e-4, atol=1e-30)


def test_the_peak_of_blinn_phong_and_its_width():
    alpha = np.array([0.01, 0.05, 0.1])
    peak = blinn_phong(surface([Z] * 3, f0=1.0, alpha=alpha), single([Z] * 3))[1]
    np.testing.assert_allclose(peak[:, 0], (2 / alpha**2 + 6) / (8 * np.pi), rtol=1e-6)
    # Half the peak at 0.83 α; there GGX has less, and far out more.
    half = np.sqrt(np.log(2)) * alpha
    v, l = towards(half, 0.0), towards(half, np.pi)
    there = np.asarray(blinn_phong(surface(Z + 0 * v, f0=1.0, alpha=alpha), single(towards(2 * half)))[1][:, 0])
    np.testing.assert_allclose(there / np.cos(2 * half) / np.asarray(peak[:, 0]), 0.5, rtol=0.01)
    np.testing.assert_allclose(
        blinn_phong(surface(v, f0=1.0, alpha=alpha), single(l))[1][:, 0], peak[:, 0] * l[:, 2], rtol=1e-3
    )
    ggx_half = np.sqrt(np.sqrt(2) - 1) * alpha
    ratio = D(single([Z] * 3), single(towards(ggx_half)), single(alpha)) * np.pi * alpha**2
    np.testing.assert_allclose(ratio, 0.5, rtol=0.01)


def test_a_rounded_cosine_does_not_exceed_the_peak_of_blinn_phong():
    """(1 + 1e-7)^(5e5) would be six percent too bright: a flicker."""
    n = towards(*np.random.default_rng(6).uniform(0, 3, (2, 512)))
    peak = (2 / SMOOTHEST**2 + 6) / (8 * np.pi)
    specular = blinn_phong(surface(n, normal=n, f0=1.0, alpha=SMOOTHEST), single(n))[1]
    assert 0.8 * peak < specular.min() and specular.max() < 1.00001 * peak


def test_blinn_phong_gains_head_on_and_loses_at_grazing_angles():
    """As its docstring says; the numbers are for f0 = 1 in uniform light."""
    head_on = [albedo(1.0, r, 0.0, 1.0, blinn_phong)[1] for r in (0.2, 0.5, 0.6, 0.7, 0.8, 1.0)]
    print(head_on)
    np.testing.assert_allclose(max(head_on), 1.07, atol=0.006)
    grazing = [albedo(0.05, r, 0.0, 1.0, blinn_phong)[1] for r in (0.1, 0.2, 0.3)]
    assert max(grazing) < 0.01


# -- Ugly points -------------------------------------------------------------------------------------------------------

UP, SIDEWAYS = Z, np.array([1.0, 0.0, 0.0])
SKEW = towards(np.radians(100), 2.0)
# (v, l), n = +Z.
UGLY = {
    "n·l = 0": (VIEW, SIDEWAYS),
    "n·v = 0": (SIDEWAYS, LIGHT),
    "both 0, opposite": (SIDEWAYS, -SIDEWAYS),
    "both 0, across": (SIDEWAYS, np.array([0.0, 1.0, 0.0])),
    "both 0, the same": (SIDEWAYS, SIDEWAYS),
    "h = n": (VIEW, VIEW * [-1, -1, 1]),
    "v = l": (VIEW, VIEW),
    "v = l = n": (UP, UP),
    "l = -v": (VIEW, -VIEW),
    "l = -v, seen from below": (SKEW, -SKEW),
    "l = -v = n": (-UP, UP),
    "n·v < 0": (SKEW, LIGHT),
    "n·v < 0, n·h < 0": (SKEW, towards(np.radians(85), 2.0)),
    "v = -n": (-UP, LIGHT),
    "n·l < 0": (VIEW, SKEW),
    "all below": (SKEW, -UP),
    "n·v at the floor": (towards(np.arccos(1e-4)), LIGHT),
    "n·l denormal": (VIEW, np.array([1.0, 0.0, 1e-40])),
    "no light direction": (VIEW, np.zeros(3)),
}
ROUGHNESSES = (0.0, 0.045, 0.3, 1.0)
CASES = [(name, roughness, metallic) for name in UGLY for roughness in ROUGHNESSES for metallic in (0.0, 1.0)]


def ugly_arguments() -> tuple:
    v, l = (single([UGLY[name][i] for name, *_ in CASES]) for i in (0, 1))
    n = single(np.broadcast_to(Z, v.shape))
    base = single(np.broadcast_to([1.0, 0.5, 0.0], v.shape))
    return n, v, l, base, single([m for *_, m in CASES]), single([r for _, r, _ in CASES])


def reflect(brdf, n, v, l, base, metallic, roughness):
    """Both parts of one case, from the six numbers that a user may differentiate."""
    diffuse, f0, alpha, f90 = metallic_roughness(base, metallic, roughness)
    zero = jnp.zeros_like(n)
    here = Surface(
        mask=jnp.array(True),
        position=zero,
        normal=n,
        geometric_normal=n,
        view=v,
        uv=zero[:2],
        diffuse_color=diffuse,
        f0=f0,
        f90=f90,
        alpha=alpha,
        emissive=zero,
        occlusion=jnp.ones_like(alpha),
    )
    return jnp.concatenate(brdf(here, l))


@pytest.fixture(scope="module", params=PLAIN)
def ugly(request):
    """Values, reverse-mode and forward-mode Jacobians of all ugly cases under one of the models."""
    function = functools.partial(reflect, PLAIN[request.param])
    every = tuple(range(6))

    @jax.jit
    @jax.vmap
    def all_of(*arguments):
        return function(*arguments), jax.jacrev(function, every)(*arguments), jax.jacfwd(function, every)(*arguments)

    return request.param, all_of(*ugly_arguments())


def test_values_are_finite_and_not_negative_where_vectors_are_ugly(ugly):
    model, (values, _, _) = ugly
    values = np.asarray(values)
    assert np.isfinite(values).all() and (values >= 0).all()
    by_name = {name: values[[i for i, case in enumerate(CASES) if case[0] == name]] for name in UGLY}
    dark = [name for name in UGLY if name.startswith("both 0")]
    dark += ["n·l = 0", "l = -v", "n·l < 0", "all below", "no light direction"]
    for name in dark:
        assert (by_name[name] == 0).all(), name
    lit = ["n·v = 0", "h = n", "v = l", "v = l = n", "n·v < 0", "n·v at the floor"]
    for name in lit:
        assert by_name[name].max() > 1e-3, name
    if model != "local":
        for name in ("l = -v, seen from below", "l = -v = n"):
            assert (by_name[name][:, 3:] == 0).all(), name


def test_gradients_are_finite_and_agree_where_vectors_are_ugly(ugly):
    _, (_, reverse, forward) = ugly
    names = ("normal", "view", "light", "base", "metallic", "roughness")
    for name, r, f in zip(names, reverse, forward):
        r, f = np.asarray(r), np.asarray(f)
        for mode in (r, f):
            bad = [CASES[i] for i in np.flatnonzero(~np.isfinite(mode.reshape(len(CASES), -1)).all(axis=1))]
            assert bad == [], name
        # Polished highlights amplify roundings by 1/α, five hundred, and at their peak by its square.
        largest = np.abs(f).reshape(len(CASES), -1).max(axis=1).reshape(-1, *[1] * (f.ndim - 1))
        off = np.abs(r - f) / (largest + 1e-20)
        polished = np.array([roughness <= 0.045 for _, roughness, _ in CASES])
        assert off[polished].max() < 0.04 and off[~polished].max() < 1e-3, name


@pytest.mark.parametrize("model", PLAIN)
def test_gradients_agree_with_double_precision_differences(model):
    """At ordinary and at nearly ugly points, in all thirteen directions the arguments have."""
    v = np.stack([VIEW, towards(1.5, 1.0), towards(0.5), towards(1e-3, 2.0)])
    l = np.stack([LIGHT, towards(0.7, 3.0), towards(0.51, np.pi + 0.01), towards(1.55, 1.0)])
    base = np.tile([0.9, 0.5, 0.1], (4, 1))
    arguments = [np.tile(Z, (4, 1)), v, l, base, np.array([0.0, 0.5, 1.0, 0.3]), np.array([0.5, 0.3, 0.2, 0.9])]
    function = jax.vmap(functools.partial(reflect, PLAIN[model]))
    rng = np.random.default_rng(5)
    directions = [
        [rng.normal(size=a.shape) if i == k else np.zeros(a.shape) for i, a in enumerate(arguments)] for k in range(6)
    ]
    slope = jax.jit(lambda a, d: jax.jvp(function, a, d)[1])
    for direction in directions:
        measured = slope(tuple(map(single, arguments)), tuple(map(single, direction)))
        with jax.enable_x64(True):
            step = 1e-6
            up, down = (
                function(*(jnp.asarray(a + sign * step * d) for a, d in zip(arguments, direction))) for sign in (1, -1)
            )
            exact = np.asarray(up - down) / (2 * step)
        np.testing.assert_allclose(measured, exact, rtol=1e-3, atol=1e-3 * np.abs(exact).max())


def test_smaller_roughness_than_the_floor_changes_nothing():
    base, metallic = jnp.ones((3, 3)), jnp.zeros(3)
    alpha = metallic_roughness(base, metallic, single([0.0, 0.02, 0.045]))[2]
    np.testing.assert_allclose(alpha, [SMOOTHEST] * 3, rtol=1e-6)
    slope = jax.vmap(jax.grad(lambda r: metallic_roughness(base[0], metallic[0], r)[2]))(
        single([0.0, 0.02, 0.045, 0.5])
    )
    np.testing.assert_allclose(slope, [0, 0, 0.09, 1.0], rtol=1e-6)
