"""Diffuse reflectance: reciprocity, energy (exactly kept by `oren_nayar`), limits, precision, slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pointwise import check_calls, check_finite, check_precision, check_slopes, product, single, towards

from jaxraster.brdf.diffuse import burley, lambert
from jaxraster.brdf.oren_nayar import AT_GRAZING, MEAN, oren_nayar

BURLEY, OREN_NAYAR = jax.jit(burley), jax.jit(oren_nayar)
MODELS = {"burley": burley, "oren_nayar": oren_nayar}


def last_cosine(name: str, v, l) -> np.ndarray:
    """v·l for Oren and Nayar, l·h for Burley."""
    v_dot_l = (v * l).sum(axis=-1)
    return v_dot_l if name == "oren_nayar" else np.sqrt(np.maximum(0.5 + 0.5 * v_dot_l, 0))


def reflect(name: str, color, roughness, v, l) -> np.ndarray:
    """f in double precision, of colours, roughnesses and directions in the surface's space that broadcast."""
    shape = np.broadcast_shapes(np.shape(v)[:-1], np.shape(l)[:-1])
    v, l, color = (np.broadcast_to(x, (*shape, 3)) for x in (v, l, color))
    arguments = (color, np.broadcast_to(roughness, shape), v[..., 2], l[..., 2], last_cosine(name, v, l))
    with jax.enable_x64(True):
        return np.asarray(jax.jit(MODELS[name])(*(jnp.asarray(np.float64(x)) for x in arguments)))


def albedo(name: str, color, roughness: float, n_dot_v: float) -> np.ndarray:
    """∫ f (n·l) dl by Gauss's points in both angles, which straddle neither n·l = n·v nor a right angle to v."""
    x, weight = np.polynomial.legendre.leggauss(40)
    x, weight = 0.5 * (x + 1), 0.5 * weight
    theta_v = np.arccos(n_dot_v)
    total = 0.0
    for low, high in ((0.0, theta_v), (theta_v, np.pi / 2)):
        for start in (0.0, np.pi / 2):
            theta, phi = low + (high - low) * x, start + np.pi / 2 * x
            f = reflect(name, color, roughness, towards(theta_v), towards(theta[:, None], phi))
            solid = (np.cos(theta) * np.sin(theta) * weight * (high - low))[:, None] * weight * np.pi / 2
            total = total + 2 * (f * solid[..., None]).sum(axis=(0, 1))
    return total


def listing(color, r, v, l) -> np.ndarray:
    """EON with its exact albedo, as the paper prints it: tangents, and 1 - E as a difference."""
    mu_v, mu_l = v[..., 2], l[..., 2]
    s = (v * l).sum(axis=-1) - mu_v * mu_l
    a = 1 / (1 + (0.5 - 2 / (3 * np.pi)) * r)

    def e(mu):
        sine = np.sqrt(1 - mu * mu)
        g = sine * (np.arccos(mu) - sine * mu) + 2 / 3 * (sine / mu * (1 - sine**3) - sine)
        return a + r * a / np.pi * g

    mean = a * (1 + (2 / 3 - 28 / (15 * np.pi)) * r)
    once = color / np.pi * (a * (1 + r * np.where(s > 0, s / np.maximum(mu_v, mu_l), s)))[..., None]
    again = color**2 * mean / (1 - color * (1 - mean)) / np.pi
    return once + again * ((1 - e(mu_v)) * (1 - e(mu_l)) / (1 - mean))[..., None]


def test_oren_nayar_is_that_of_the_paper():
    rng = np.random.default_rng(0)
    v, l = (towards(np.arccos(rng.uniform(0.02, 1, 256)), rng.uniform(0, 7, 256)) for _ in "vl")
    color = rng.uniform(0, 1, (256, 3))
    for roughness in (0.01, 0.3, 1.0):
        ours = reflect("oren_nayar", color, roughness, v, l)
        np.testing.assert_allclose(ours, listing(color, roughness, v, l), rtol=1e-9)


@pytest.mark.parametrize("roughness", [0.0, 1e-3, 0.3, 1.0])
def test_the_white_furnace_of_oren_nayar_is_exact(roughness):
    """White returns all light at every angle; a colour returns c E + m (1 - E), never more than it has."""
    for n_dot_v in (0.002, 0.05, 0.3, 0.7, 0.999):
        np.testing.assert_allclose(albedo("oren_nayar", np.ones(3), roughness, n_dot_v), 1, atol=1e-8)
    a = 1 / (1 + AT_GRAZING * roughness)
    mean = a * (1 + MEAN * roughness)
    color = np.array([0.9, 0.5, 0.1])
    again = color**2 * mean / (1 - color * (1 - mean))
    measured = albedo("oren_nayar", color, roughness, 1.0)
    np.testing.assert_allclose(measured, color * a + again * (1 - a), atol=1e-8)
    assert (measured <= color + 1e-9).all()


def test_without_roughness_oren_nayar_is_lambert():
    rng = np.random.default_rng(1)
    v, l = (towards(np.arccos(rng.uniform(0, 1, 64)), rng.uniform(0, 7, 64)) for _ in "vl")
    color = single(rng.uniform(0, 1, (64, 3)))
    arguments = (jnp.zeros(64), *(single(x) for x in (v[:, 2], l[:, 2], last_cosine("oren_nayar", v, l))))
    np.testing.assert_allclose(OREN_NAYAR(color, *arguments), lambert(color), rtol=3e-7)


def test_rough_matter_is_bright_towards_the_light_and_flat():
    """Towards the light, brighter the lower it stands; away from it, darker than Lambert."""
    angles = np.radians([0.0, 40.0, 75.0])
    back = reflect("oren_nayar", np.ones(3), 1.0, towards(angles), towards(angles))[:, 0]
    away = reflect("oren_nayar", np.ones(3), 1.0, towards(angles), towards(angles, np.pi))[:, 0]
    assert (np.diff(back) > 0.1).all() and back[-1] > 3 * back[0] and (np.diff(away) < 0).all()
    assert away[-1] < 1 / np.pi < back[1]


def test_burley_in_closed_form():
    """Head on it is Lambert, both grazing and opposite (l·h = 0) a quarter, at right angles half and the roughness."""
    color, grazing = np.array([0.9, 0.5, 0.1]), towards(np.pi / 2)
    cases = [
        (towards(0.0), towards(0.0), 1.0, 1.0),
        (grazing, towards(np.pi / 2, np.pi), 0.7, 0.25),
        (grazing, grazing, 0.7, (0.5 + 1.4) ** 2),
        (grazing, towards(0.0), 0.7, 0.5 + 0.7),
    ]
    for v, l, roughness, expected in cases:
        f = reflect("burley", color, roughness, v, l)
        np.testing.assert_allclose(f, color / np.pi * expected, atol=1e-12)


def test_burley_keeps_energy_as_badly_as_it_says():
    seen = (0.01, 0.1, 0.3, 0.6, 0.9999)
    white = {r: [albedo("burley", np.ones(3), r, c)[0] for c in seen] for r in (0.0, 0.5, 1.0)}
    print(white)
    np.testing.assert_allclose([white[0.0][-1], white[1.0][-1]], [0.98, 1.04], atol=0.005)
    np.testing.assert_allclose([white[0.0][0], white[1.0][0]], [0.51, 1.54], atol=0.005)
    # Head on and smooth it is 1 - ½ · 2 ∫ c (1 - c)⁵ dc.
    np.testing.assert_allclose(white[0.0][-1], 1 - 0.5 / 21, atol=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_light_and_viewer_may_change_places(name):
    rng = np.random.default_rng(2)
    v, l = (towards(np.arccos(rng.uniform(0, 1, 512)), rng.uniform(0, 7, 512)) for _ in "vl")
    color, roughness = rng.uniform(0, 1, (512, 3)), rng.uniform(0, 1, 512)
    np.testing.assert_allclose(reflect(name, color, roughness, v, l), reflect(name, color, roughness, l, v), rtol=1e-12)


def arguments(name: str, seed: int, count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    v, l = (towards(rng.uniform(0.1, 1.4, count), rng.uniform(0, 7, count)) for _ in "vl")
    color, roughness = rng.uniform(0, 1, (count, 3)), rng.uniform(0, 1, count)
    return [color, roughness, v[:, 2], l[:, 2], last_cosine(name, v, l)]


@pytest.mark.parametrize("name", MODELS)
def test_gradients_are_exact_and_every_call_the_same(name):
    check_slopes(MODELS[name], *arguments(name, 3, 8))
    check_calls(MODELS[name], *arguments(name, 3, 16))


@pytest.mark.parametrize("name", MODELS)
def test_single_precision_keeps(name):
    color, roughness, x, y, phi = product(
        [np.full(3, 0.02), np.full(3, 0.9), np.ones(3)], [0.0, 1e-4, 0.5, 1.0],
        [0.0, 1e-4, 0.1, 0.7, 1.0], [1e-4, 0.1, 0.7, 1.0], [0.1, 2.0],
    )  # fmt: skip
    last = last_cosine(name, towards(np.arccos(x)), towards(np.arccos(y), phi))
    check_precision(MODELS[name], color, roughness, x, y, last, rtol=1e-5)


@pytest.mark.parametrize("name", MODELS)
def test_finite_at_every_edge(name):
    """Cosines 0 and 1, one or both, from everywhere; black and white; smooth and rough."""
    directions = [towards(theta) for theta in (0.0, 1e-4, 1.0, 1.5707963)] + [
        np.array([1.0, 0, 0]),
        np.array([0, 1.0, 0]),
    ]
    color, roughness, v, l = product([np.zeros(3), np.ones(3)], [0.0, 1e-20, 1.0], directions, directions)
    value = check_finite(MODELS[name], color, roughness, v[:, 2], l[:, 2], last_cosine(name, v, l))
    assert (value >= -1e-6).all() and (value[color == 0] == 0).all()
