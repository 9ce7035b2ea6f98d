"""Where a rough surface mirrors on the average: beside the mean of its lobe, by quadrature, at every angle."""

import jax
import jax.numpy as jnp
import numpy as np
from pointwise import check_calls, check_finite, check_precision, check_slopes, product, towards

from jaxraster.light.reflection import reflection

UP = np.array([0.0, 0.0, 1.0])


def cases(angles, alphas) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals, views at those angles (degrees) from them, and alphas, of all combinations."""
    angle, alpha = product(np.radians(angles), alphas)
    return np.broadcast_to(UP, (len(angle), 3)).copy(), towards(angle, 0.3), alpha


def mean(v: np.ndarray, alpha: float, side: int = 96) -> np.ndarray:
    """∫ D V (n·l) l dl, up to a factor: l mirrored at visible normals (Dupuy and Benyoub 2023), times G₂/G₁."""
    u = (np.arange(side) + 0.5) / side
    u, w = np.meshgrid(u, u, indexing="ij")
    stretched = np.array([alpha, alpha, 1.0]) * v
    stretched /= np.linalg.norm(stretched)
    t = w * (1 + stretched[2])
    radius = np.sqrt(t * (2 - t))
    cap = np.stack([radius * np.cos(2 * np.pi * u), radius * np.sin(2 * np.pi * u), 1 - t], axis=-1)
    h = (cap + stretched) * np.array([alpha, alpha, 1.0])
    # The cap lies about z: its points are 1 - t high, of which the view's own height is a part.
    h[..., 2] = (1 - w) * (1 + stretched[2])
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    l = 2 * (h @ v)[..., None] * h - v
    long_v, long_l = (np.sqrt(alpha**2 * (1 - c * c) + c * c) for c in (v[2], l[..., 2]))
    weight = np.where(l[..., 2] > 0, l[..., 2] * (v[2] + long_v) / (l[..., 2] * long_v + v[2] * long_l), 0)
    return (weight[..., None] * l).sum(axis=(0, 1))


def test_it_lies_as_close_to_the_mean_as_it_says():
    n, v, alpha = cases(np.degrees(np.arccos(np.linspace(0.03, 1, 12))), np.linspace(0.08, 1, 12) ** 2)
    got = np.asarray(jax.jit(reflection)(*(jnp.asarray(x, jnp.float32) for x in (n, v, alpha))), np.float64)
    expected = np.stack([mean(*case) for case in zip(v, alpha)])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    chord = np.linalg.norm(got - expected, axis=1)
    off = np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1)))
    print(np.sqrt((off**2).mean()), off.max())
    assert np.sqrt((off**2).mean()) < 0.9 and 2.0 < off.max() < 2.7
    mirror = 2 * v[:, 2:] * n - v
    assert np.degrees(np.arccos(np.clip((mirror * expected).sum(axis=1), -1, 1))).max() > 80


def test_a_mirror_mirrors_and_the_roughest_surface_faces_along_n():
    n, v, _ = cases(np.linspace(0, 90, 7), [0.0])
    zero, one = jnp.zeros(len(n)), jnp.ones(len(n))
    n, v = jnp.asarray(n, jnp.float32), jnp.asarray(v, jnp.float32)
    np.testing.assert_allclose(reflection(n, v, zero), 2 * v[:, 2:] * n - v, atol=1e-6)
    np.testing.assert_allclose(reflection(n, v, one), n, atol=1e-6)


def test_it_is_a_unit_vector_with_finite_slopes_at_every_end():
    arguments = cases([0, 1e-3, 45, 89.999, 90], [0.0, 1e-12, 1e-6, 0.002, 0.3, 1.0])
    np.testing.assert_allclose(np.linalg.norm(check_finite(reflection, *arguments), axis=1), 1, atol=2e-6)
    check_calls(reflection, *arguments)


def test_it_is_exact_in_single_precision_and_in_its_slopes():
    arguments = cases([5, 40, 80], [0.01, 0.2, 0.8])
    check_precision(reflection, *arguments, atol=1e-6)
    check_slopes(reflection, *arguments)
