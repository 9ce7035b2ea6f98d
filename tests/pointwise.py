"""What holds for every formula that takes each element for itself, whatever it computes.

`arguments` are arrays with the elements along their first axis; a formula returns one such array.
"""

import jax
import jax.numpy as jnp
import numpy as np


def single(x) -> jax.Array:
    return jnp.asarray(np.asarray(x, np.float32))


def towards(theta, phi=0.0) -> np.ndarray:
    """Unit vectors at the angle theta from +Z, in radians."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def product(*columns) -> list[np.ndarray]:
    """One array per column, of all combinations of their rows."""
    index = np.meshgrid(*(np.arange(len(column)) for column in columns), indexing="ij")
    return [np.asarray(column)[i.ravel()] for column, i in zip(columns, index)]


def in_double(formula, *arguments) -> np.ndarray:
    """The formula of the same single-precision numbers, in double precision."""
    with jax.enable_x64(True):
        result = jax.jit(formula)(*(jnp.asarray(np.float64(np.float32(a))) for a in arguments))
        assert result.dtype == jnp.float64
        return np.asarray(result)


def check_precision(formula, *arguments, rtol=1e-5, atol=0.0) -> None:
    """Single precision is as good as the numbers that it is given."""
    result = jax.jit(formula)(*map(single, arguments))
    assert result.dtype == jnp.float32
    np.testing.assert_allclose(result, in_double(formula, *arguments), rtol=rtol, atol=atol)


def check_calls(formula, *arguments, rtol=2e-6) -> None:
    """Called as it is, compiled, or mapped over its elements, a formula gives the same."""
    arguments = [*map(single, arguments)]
    plain = formula(*arguments)
    np.testing.assert_allclose(jax.jit(formula)(*arguments), plain, rtol=rtol, atol=1e-30)
    np.testing.assert_allclose(jax.jit(jax.vmap(formula))(*arguments), plain, rtol=rtol, atol=1e-30)
    pairs = [a.reshape(2, -1, *a.shape[1:]) for a in arguments]
    np.testing.assert_allclose(jax.jit(formula)(*pairs).reshape(plain.shape), plain, rtol=rtol, atol=1e-30)


def jacobians(formula, *arguments) -> tuple[list, list]:
    """Of each element, by reverse and by forward mode; one array per argument."""
    every = tuple(range(len(arguments)))
    modes = [jax.vmap(mode(formula, every)) for mode in (jax.jacrev, jax.jacfwd)]
    return tuple(jax.jit(lambda *a: [mode(*a) for mode in modes])(*arguments))


def check_finite(formula, *arguments) -> np.ndarray:
    """Value and both Jacobians are finite numbers, in single precision; the value is returned."""
    arguments = [*map(single, arguments)]
    value = np.asarray(jax.jit(formula)(*arguments))
    results = {"value": value}
    for mode, slopes in zip(("reverse", "forward"), jacobians(formula, *arguments)):
        results |= {f"{mode} {i}": np.asarray(slope) for i, slope in enumerate(slopes)}
    for name, result in results.items():
        bad = np.flatnonzero(~np.isfinite(result.reshape(len(value), -1)).all(axis=1))
        assert len(bad) == 0, (name, [[np.asarray(a[i]).tolist() for a in arguments] for i in bad[:3]])
    return value


def check_slopes(formula, *arguments, step=1e-6, rtol=1e-6) -> None:
    """In double precision, both Jacobians are the differences of values a step apart."""
    at = [np.float64(a) for a in arguments]
    with jax.enable_x64(True):
        compiled = jax.jit(formula)
        reverse, forward = ([np.asarray(slope) for slope in mode] for mode in jacobians(formula, *map(jnp.asarray, at)))
        for i, point in enumerate(at):
            np.testing.assert_allclose(reverse[i], forward[i], rtol=1e-9, atol=1e-9)
            for j in np.ndindex(point.shape[1:]):
                ends = []
                for sign in (1, -1):
                    moved = point.copy()
                    moved[:, *j] += sign * step
                    ends.append(np.asarray(compiled(*map(jnp.asarray, [*at[:i], moved, *at[i + 1 :]]))))
                expected = (ends[0] - ends[1]) / (2 * step)
                np.testing.assert_allclose(
                    forward[i][..., *j], expected, rtol=rtol, atol=rtol * np.abs(expected).max(initial=0)
                )
