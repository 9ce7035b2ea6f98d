"""Numbers at the corners of a divided octahedron: found again, mixed linearly, and without a seam anywhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.environment.octahedral import cell, directions, lookup, mixed, place, table

CELLS = 8
AXES = np.concatenate([np.eye(3), -np.eye(3)])


def unit(points) -> np.ndarray:
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def scattered(count: int, seed: int = 0) -> np.ndarray:
    return unit(np.random.default_rng(seed).normal(size=(count, 3)))


def ties() -> np.ndarray:
    """Directions on the octahedron's edges and corners, and where two or three components are equal."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    masks = np.array([(1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)], float)
    t = np.linspace(0, 1, 9)[:, None]
    edges = [a * (1 - t) + b * t for a in AXES for b in AXES if abs(a @ b) < 0.5]
    return unit(np.concatenate([AXES, (signs[:, None] * masks).reshape(-1, 3), *edges]))


@jax.jit
def seen(corners, direction):
    """Numbers `[4, n, n, 3]` at the corners, looked up."""
    return lookup(table(corners), direction, corners.shape[1] - 1)


def single(x) -> jax.Array:
    return jnp.asarray(x, jnp.float32)


@pytest.mark.parametrize("cells", [1, 2, 5, CELLS])
def test_numbers_at_corners_are_found_again(cells):
    d = directions(cells)
    got = seen(d, d.reshape(-1, 3))
    np.testing.assert_allclose(got, d.reshape(-1, 3), atol=3e-7 * cells)


def test_quadrants_share_the_directions_of_their_borders_to_the_bit():
    d = np.asarray(directions(CELLS))
    bits = d.view(np.int32)
    assert (bits[0, :, 0] == bits[1, :, 0]).all() and (bits[2, :, 0] == bits[3, :, 0]).all()
    assert (bits[0, 0] == bits[2, 0]).all() and (bits[1, 0] == bits[3, 0]).all()
    # Beyond the horizon their outer borders are those towards +Z and -Z, or +X and -X.
    assert (bits[0, -1] == bits[1, -1]).all() and (bits[0, :, -1] == bits[2, :, -1]).all()
    np.testing.assert_allclose(np.linalg.norm(d, axis=-1), 1, atol=1e-6)


def test_constants_and_linear_functions_of_the_octahedron_are_exact():
    """Of a point p of |x| + |y| + |z| = 1, numbers a + b·p at corners give a + b·p everywhere: a triangle is flat, and
    its three weights are its barycentrics."""
    d = np.concatenate([scattered(2000), ties()])
    corners = np.asarray(directions(CELLS), np.float64)
    flat = [x / np.abs(x).sum(axis=-1, keepdims=True) for x in (corners, d)]
    np.testing.assert_allclose(seen(jnp.ones((4, 9, 9, 3)), single(d)), 1, atol=3e-7)
    b = np.random.default_rng(1).normal(size=(3, 3))
    np.testing.assert_allclose(seen(single(2 + flat[0] @ b), single(d)), 2 + flat[1] @ b, atol=2e-6)


def test_there_is_no_seam():
    """Across edges, corners and equal components numbers change no more than their slope allows, however they vary."""
    corners = np.asarray(directions(CELLS))
    rough = np.random.default_rng(2).normal(size=(4096, 3)).astype(np.float32)
    # A number for each direction, the same wherever the same direction is a corner.
    key = np.abs((corners * 1e4).round().astype(np.int64) @ np.array([73856093, 19349663, 83492791])) % 4096
    step = 1e-4
    middle = ties()
    for away in scattered(6, 3):
        across = step * np.cross(middle, away)
        sides = [np.asarray(seen(single(rough[key]), single(unit(middle + s * across)))) for s in (-1, 1)]
        slope = 12 * CELLS  # at most |change of numbers| 8 over the shortest edge, 1/(√3 CELLS)
        assert np.abs(sides[1] - sides[0]).max() < 2 * step * slope


def test_a_smooth_function_is_off_by_the_square_of_the_cells():
    """Halving cells quarters the error, everywhere: no edge is worse than the rest."""
    d, errors = np.concatenate([scattered(4000), ties()]), []
    for cells in (8, 16, 32):
        got = seen(directions(cells), single(d))
        errors.append(np.abs(np.asarray(got) - d).max())
    assert errors[0] < 0.02 and 3.5 < errors[0] / errors[1] < 4.5 and 3.5 < errors[1] / errors[2] < 4.5


@pytest.mark.parametrize("length", [1e-20, 1e-3, 1.0, 1e20])
def test_length_means_nothing(length):
    d = ties()
    np.testing.assert_allclose(
        seen(directions(CELLS), single(d * length)), seen(directions(CELLS), single(d)), atol=1e-6
    )


def test_values_and_gradients_are_finite_wherever_a_direction_points():
    d = single(np.concatenate([ties(), np.zeros((1, 3)), scattered(20) * 1e-30, [[-0.0, -1.0, -0.0]]]))
    corners = single(np.random.default_rng(4).normal(size=(4, 9, 9, 3)))
    value, slope = jax.jit(jax.vmap(jax.value_and_grad(lambda x: seen(corners, x).sum())))(d)
    assert np.isfinite(value).all() and np.isfinite(slope).all()
    broken = seen(corners, single([[np.nan, 1, 0], [np.inf, 1, 0]]))
    assert broken.shape == (2, 3)


def test_several_tables_lie_in_one():
    """Each direction in the table of its own size and place."""
    first, second = directions(4), 1.0 + 2.0 * directions(8)
    rows, d = jnp.concatenate([table(first), table(second)]), single(scattered(30))
    which = jnp.arange(30) % 2
    got = mixed(rows, cell(place(d), jnp.where(which == 0, 4, 8), jnp.where(which == 0, 0, 4 * 4**2)))
    np.testing.assert_allclose(got[::2], seen(first, d[::2]), atol=1e-6)
    np.testing.assert_allclose(got[1::2], seen(second, d[1::2]), atol=1e-6)


def test_no_direction_is_nothing():
    assert seen(directions(2), jnp.zeros((0, 3))).shape == (0, 3)
