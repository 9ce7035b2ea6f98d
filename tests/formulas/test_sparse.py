"""Work for some of many elements gives what the work for all of them does, and skips runs without any."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.math import sparse

NUM = 60
VALUES = {"x": jnp.arange(1.0, NUM + 1).reshape(5, 12), "y": jnp.arange(3.0 * NUM).reshape(5, 12, 3)}
PRESENT = {
    "all": np.ones(NUM, bool),
    "none": np.zeros(NUM, bool),
    "one": np.arange(NUM) == 59,
    "every third": np.arange(NUM) % 3 == 0,
    "a run and one": np.arange(NUM) < 9,
}


def work(values):
    return jnp.sqrt(values["x"]), values["x"][..., None] * values["y"]


@pytest.mark.parametrize("chunk", [1, 7, 2**14])
def test_results_and_gradients_where_present(chunk, monkeypatch):
    monkeypatch.setattr(sparse, "CHUNK", chunk)

    @jax.jit
    def both(values, present):
        def total(values, function):
            root, product = made = function(values)
            return jnp.sum(jnp.where(present, root + product.sum(-1), 0.0)), made

        def some(values):
            return sparse.where_present(work, present, values)

        return [jax.grad(total, has_aux=True)(values, function) for function in (some, work)]

    for name, present in PRESENT.items():
        present = present.reshape(5, 12)
        ours, theirs = jax.device_get(both(VALUES, present))
        for a, b in zip(ours[1], theirs[1]):
            assert a.shape == b.shape
            np.testing.assert_allclose(a[present], b[present], rtol=1e-6, err_msg=name)
            # What stands in elsewhere is a result for some element.
            near = np.isclose(a.reshape(NUM, 1, -1), b.reshape(1, NUM, -1), rtol=1e-6).all(-1)
            assert near.any(1).all(), name
        for a, b in zip(jax.tree.leaves(ours[0]), jax.tree.leaves(theirs[0])):
            np.testing.assert_allclose(a, b, rtol=1e-6, err_msg=name)


def test_runs_without_any_are_skipped(monkeypatch):
    monkeypatch.setattr(sparse, "CHUNK", 8)
    runs = []

    def count(x):
        jax.debug.callback(lambda: runs.append(1))
        return x

    for name, expected in (("all", 8), ("none", 1), ("one", 1), ("every third", 3), ("a run and one", 2)):
        runs.clear()
        present = jnp.asarray(PRESENT[name])
        jax.block_until_ready(sparse.where_present(count, present, VALUES["x"].reshape(-1)))
        jax.effects_barrier()
        assert len(runs) == expected, name
