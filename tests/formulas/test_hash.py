"""The PCG hash: its author's check values, a Python twin, and the statistics that its users rely on."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxraster.math.hash import pcg, uniform

MASK = 2**32 - 1
HASH = jax.jit(pcg)


def twin(x: int) -> int:
    """The same hash in Python's unbounded integers."""
    state = (x * 747796405 + 2891336453) & MASK
    word = ((state >> ((state >> 28) + 4)) ^ state) * 277803737 & MASK
    return word >> 22 ^ word


def test_generates_the_sequence_published_for_seed_42():
    # imneme/pcg-c, test-high/expected/check-pcg32si.out, round 1; seeding steps once, adds 42, steps again.
    published = [0x256B5357, 0xA5EFAD32, 0x170B7830, 0x334A5B22, 0x3DE5C680, 0x9B47B7B3]
    state = (2891336453 + 42) & MASK
    for value in published:
        assert int(HASH(jnp.uint32(state))) == value
        state = (state * 747796405 + 2891336453) & MASK


def test_agrees_with_its_twin_at_the_edges_and_at_random():
    x = np.r_[[0, 1, 2, 2**31 - 1, 2**31, MASK], np.random.default_rng(0).integers(0, 2**32, 1000)].astype(np.uint32)
    expected = np.array([twin(int(v)) for v in x], np.uint32)
    for result in (HASH(jnp.asarray(x)), pcg(jnp.asarray(x)), jax.vmap(pcg)(jnp.asarray(x))):
        assert result.dtype == jnp.uint32
        np.testing.assert_array_equal(result, expected)


def test_is_a_permutation():
    values = np.asarray(HASH(jnp.arange(2**18, dtype=jnp.uint32)))
    assert len(np.unique(values)) == 2**18


def test_one_bit_in_flips_half_of_the_bits_out():
    x = jnp.asarray(np.random.default_rng(1).integers(0, 2**32, 4096), jnp.uint32)
    flips = jnp.stack([HASH(x) ^ HASH(x ^ jnp.uint32(1 << bit)) for bit in range(32)])
    mean = np.asarray(jax.lax.population_count(flips)).mean(axis=1)
    # The top state bits also select the shift, the one place where the hash is not uniform: allow a bit and a half.
    np.testing.assert_allclose(mean, 16, atol=1.5)


def test_uniform_stays_below_one_and_fills_the_interval_evenly():
    n = 2**18
    u = np.asarray(jax.jit(uniform)(jnp.arange(n, dtype=jnp.uint32)))
    assert u.dtype == np.float32 and u.min() >= 0 and u.max() < 1
    np.testing.assert_allclose(u.mean(), 0.5, atol=4 * np.sqrt(1 / 12 / n))
    np.testing.assert_allclose(u.var(), 1 / 12, rtol=4 * np.sqrt(0.8 / n))
    counts = np.histogram(u, 256, (0, 1))[0]
    chi2 = ((counts - n / 256) ** 2 / (n / 256)).sum()
    assert abs(chi2 - 255) < 4 * np.sqrt(2 * 255)
    # Neighbouring keys must not be related: pixels are numbered in sequence.
    for lag in (1, 2, 3, 6, 64, 1024):
        assert abs(np.corrcoef(u[:-lag], u[lag:])[0, 1]) < 4 / np.sqrt(n)


def test_uniform_keeps_24_bits_exactly():
    # The largest hash of all must round down: 1 - 2^-24, never 1.
    keys = jnp.arange(2**16, dtype=jnp.uint32)
    hashes = np.asarray(HASH(keys))
    np.testing.assert_array_equal(np.asarray(uniform(keys), np.float64) * 2**24, hashes >> 8)
    assert np.float32(MASK >> 8) * np.float32(2.0**-24) < 1
