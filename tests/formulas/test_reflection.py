"""Where a rough surface mirrors on the average: beside the mean of its lobe, by quadrature, at every angle."""

import jax
import jax.numpy as jnp
import numpy as np
from lobe import lobe
from pointwise import check_calls, check_finite, check_precision, check_slopes, product, towards

from jaxraster.light.reflection import reflection

UP = np.array([0.0, 0.0, 1.0])


def cases(angles, alphas) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals, views at those angles (degrees) from them, and alphas, of all combinations."""
    angle, alpha = product(np.radians(angles), alphas)
    return np.broadcast_to(UP, (len(angle), 3)).copy(), towards(angle, 0.3), alpha


def mean(v: np.ndarray, alpha: float) -> np.ndarray:
    """∫ D V (n·l) l dl, up to a factor."""
    l, weight = lobe(v, alpha)
    return (weight[..., None] * l).sum(axis=(0, 1))


def test_it_lies_as_close_to_the_mean_as_it_says():
    n, v, alpha = cases(np.degrees(np.arccos(np.linspace(0.03, 1, 12))), np.linspace(0.08, 1, 12) ** 2)
    got = np.asarray(jax.jit(reflection)(*(jnp.asarray(x, jnp.float32) for x in (n, v, alpha))), np.float64)
    expected = np.stack([mean(*case) for case in zip(v, alpha)])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    chord = np.linalg.norm(got - expected, axis=1)
    off = np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1)))
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
    arguments = cases([0, 1e-3, 45, 89.999, 90, 90.001, 100, 180], [0.0, 1e-12, 1e-6, 0.002, 0.3, 1.0])
    np.testing.assert_allclose(np.linalg.norm(check_finite(reflection, *arguments), axis=1), 1, atol=2e-6)
    check_calls(reflection, *arguments)


def test_what_faces_away_is_mirrored_as_if_it_were_seen_edge_on():
    """Without a step at n·v = 0, where the slope is that of what is seen."""
    before, behind = (cases([angle], np.linspace(0.1, 1, 10)) for angle in (89.9999, 90.0001))
    call = jax.jit(reflection)
    seen, unseen = (call(*(jnp.asarray(x, jnp.float32) for x in case)) for case in (before, behind))
    np.testing.assert_allclose(seen, unseen, atol=1e-5)
    n, v, zero = (jnp.asarray(x, jnp.float32) for x in cases([90, 120, 180], [0.0]))
    np.testing.assert_allclose(call(n, v, zero), -v, atol=1e-6)
    height = jax.grad(lambda z, alpha: reflection(n[0], jnp.array([1.0, 0.0, 0.0]) + z * n[0], alpha)[2])
    for alpha in (0.1, 0.6):
        np.testing.assert_allclose(height(0.0, jnp.array(alpha)), height(1e-5, jnp.array(alpha)), rtol=1e-3)


def test_it_is_exact_in_single_precision_and_in_its_slopes():
    arguments = cases([5, 40, 80], [0.01, 0.2, 0.8])
    check_precision(reflection, *arguments, atol=1e-6)
    check_slopes(reflection, *cases([5, 40, 80, 120], [0.01, 0.2, 0.8]))
