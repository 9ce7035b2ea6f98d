"""What of occluded ambient light arrives after all: by bouncing off what occludes, and in lobes that miss it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lobe import lobe
from pointwise import check_calls, check_finite, check_precision, check_slopes, product

from jaxraster.light.bounced import bounced
from jaxraster.light.specular_occlusion import specular_occlusion

ALBEDOS = [0.0, 0.2, 0.5, 0.8, 1.0]


def test_what_is_multiplied_by_visibility_is_brighter_for_what_is_bright():
    """The published values at V = ½; never darker than V, V for black, 1 where nothing is occluded."""
    half = bounced(jnp.full(5, 0.5), jnp.broadcast_to(jnp.array(ALBEDOS)[:, None], (5, 3)))
    np.testing.assert_allclose(half[:, 0], [0.5, 0.5508, 0.68096, 0.81113, 0.8979], atol=2e-5)
    v, rho = product(np.linspace(0, 1, 33), np.linspace(0, 1, 10))
    colors = np.broadcast_to(rho[:, None], (rho.size, 3))
    shown = check_finite(bounced, v, colors)
    check_calls(bounced, v, colors)
    assert (shown >= v[:, None] - 1e-6).all() and shown.max() <= 1 and (shown[v == 1] >= 1 - 1e-7).all()
    np.testing.assert_allclose(shown[rho == 0], v[rho == 0, None].repeat(3, axis=1), atol=2e-6)


def test_the_slopes_of_bounced_light_are_exact_up_to_both_ends():
    """At V = 0 and 1, where the least and the most meet the fit, those of the side within."""
    v, rho = product([0.1, 0.4, 0.7], ALBEDOS[1:4])
    check_precision(bounced, v, np.broadcast_to(rho[:, None], (rho.size, 3)))
    check_slopes(bounced, v, np.broadcast_to(rho[:, None], (rho.size, 3)))
    for albedo in ALBEDOS[:3]:
        light = jax.grad(lambda v, albedo=albedo: bounced(v, jnp.full(3, albedo))[0])
        np.testing.assert_allclose(light(0.0), max(1.0, 2.7552 * albedo + 0.6903), rtol=1e-6)
        assert light(1.0) == 1.0


def test_smooth_matter_is_occluded_less():
    """The published values; 1 where nothing is occluded, and V for what is rough."""
    one, half = np.ones(2), np.full(2, 0.5)
    found = specular_occlusion(*map(jnp.float32, (one, half, [0.0, 0.5])))
    np.testing.assert_allclose(found, [0.72474, 0.50079], atol=1e-5)
    n_dot_v, v, alpha = product([-0.5, 0.0, 1e-6, 0.3, 1.0], [0.0, 1e-6, 0.4, 1.0], [0.0, 1e-6, 0.1, 1.0])
    shown = check_finite(specular_occlusion, n_dot_v, v, alpha)
    check_calls(specular_occlusion, n_dot_v, v, alpha)
    assert (shown >= 0).all() and (shown <= 1).all() and (shown[(v == 1)] == 1).all()
    rough = (alpha == 1) & (n_dot_v > 0.1)
    np.testing.assert_allclose(shown[rough], v[rough], atol=1e-4)
    check_slopes(specular_occlusion, *product([0.2, 0.9], [0.3, 0.8], [0.0, 0.1, 0.5]))


def _pit(open_share):
    """Sees all but what is lower than its rim."""
    return open_share, lambda l, _: l[..., 2] ** 2 > 1 - open_share


def _wall(l, azimuth):
    return np.cos(azimuth) * l[..., 0] + np.sin(azimuth) * l[..., 1] > 0


PLACES = [_pit(0.8), _pit(0.5), _pit(0.2), (0.5, _wall), (0.25, lambda l, a: _wall(l, a) & _wall(l, a + np.pi / 2))]


@pytest.mark.parametrize(("roughness", "off", "plain"), [(0.1, 0.33, 0.41), (0.3, 0.29, 0.32), (0.5, 0.18, 0.18)])
def test_it_is_as_near_as_is_said_to_what_the_lobe_sees_and_so_is_visibility(roughness, off, plain):
    """In pits, at a wall and in a corner, from 16 sides and six heights: the lobe's open share, by quadrature."""
    errors = []
    for cosine in (0.1, 0.3, 0.5, 0.7, 0.9, 0.999):
        l, weight = lobe(np.array([np.sqrt(1 - cosine**2), 0, cosine]), roughness**2, side=64)
        for share, sees in PLACES:
            found = float(specular_occlusion(*map(jnp.float32, (cosine, share, roughness**2))))
            for azimuth in 0.1 + np.arange(16) * np.pi / 8:
                exact = (weight * sees(l, azimuth)).sum() / weight.sum()
                errors.append((abs(found - exact), abs(share - exact)))
    np.testing.assert_allclose(np.mean(errors, axis=0), [off, plain], atol=0.006)
