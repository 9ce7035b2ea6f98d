"""Keyed numbers, scrambled Sobol' points and the maps of the square: their laws, exactly where they are exact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from devices import run_on_devices

from jaxraster.math import sampling, sobol
from jaxraster.math.hash import keyed, pcg, uniform, unit

N = 2**16
STEP = 2.0**-24
EDGES = [0.0, STEP, 0.5 - STEP, 0.5, 0.5 + STEP, 1.0 - STEP]
# Each map, and what of its result is spread evenly in the unit square.
MAPS = {
    "disc": lambda p: np.stack([np.sum(p**2, axis=-1), np.arctan2(p[:, 1], p[:, 0]) / (2 * np.pi) + 0.5], axis=-1),
    "cosine_hemisphere": lambda d: np.stack([d[:, 2] ** 2, np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) + 0.5], axis=-1),
    "sphere": lambda d: np.stack([0.5 + 0.5 * d[:, 2], np.arctan2(d[:, 1], d[:, 0]) / (2 * np.pi) + 0.5], axis=-1),
    "triangle": lambda b: np.stack([(1 - b[:, 2]) ** 2, b[:, 0] / (1 - b[:, 2])], axis=-1),
}
DENSITIES = {
    "disc": lambda p: np.full(len(p), 1 / np.pi),
    "cosine_hemisphere": lambda d: d[:, 2] / np.pi,
    "sphere": lambda d: np.full(len(d), 1 / (4 * np.pi)),
    "triangle": lambda b: np.full(len(b), 2.0),
}
MAPPED = {name: jax.jit(getattr(sampling, name)) for name in MAPS}
POINTS = jax.jit(sobol.sobol)
ALL = pytest.mark.parametrize("name", MAPS)


def hashed(count: int, seed: int) -> jax.Array:
    """Independent points of the square."""
    index = jnp.arange(count, dtype=jnp.uint32)
    return jnp.stack([uniform(keyed(seed, index, dimension)) for dimension in (0, 1)], axis=-1)


def points(count: int, key: int, start: int = 0) -> np.ndarray:
    index = jnp.arange(start, start + count, dtype=jnp.uint32)
    return np.asarray(POINTS(index, jnp.broadcast_to(jnp.uint32(key), index.shape)), np.float64)


def chi_square(counts: np.ndarray, expected: np.ndarray | float) -> float:
    """Pearson's statistic in standard deviations from what chance would make it."""
    total = ((counts - expected) ** 2 / expected).sum()
    freedom = counts.size - 1
    return (total - freedom) / np.sqrt(2 * freedom)


def boxes(square: np.ndarray, rows: int, columns: int) -> np.ndarray:
    return np.histogram2d(*square.T, (rows, columns), ((0, 1), (0, 1)))[0]


def test_keys_are_nested_hashes():
    pixel = jnp.arange(6, dtype=jnp.uint32)
    np.testing.assert_array_equal(keyed(pixel, 3, 5), pcg(pcg(pixel) + jnp.uint32(3)) + jnp.uint32(5))
    assert keyed(pixel, 3).dtype == jnp.uint32
    grid = np.stack([np.asarray(uniform(keyed(a, b, c))) for a, b, c in [(1, 2, 3), (3, 2, 1), (1, 3, 2), (2, 1, 3)]])
    assert len(np.unique(grid)) == 4


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_neighbouring_coordinates_have_unrelated_numbers(axis):
    """Of pixels, samples and dimensions alike."""
    grid = jnp.meshgrid(*(jnp.arange(n, dtype=jnp.uint32) for n in (32, 32, 64)), indexing="ij")
    u = np.moveaxis(np.asarray(uniform(keyed(*grid))), axis, 0)
    assert abs(np.corrcoef(u[:-1].ravel(), u[1:].ravel())[0, 1]) < 4 / np.sqrt(u[1:].size)
    assert abs(chi_square(boxes(np.stack([u[:-1].ravel(), u[1:].ravel()], -1), 16, 16), u[1:].size / 256)) < 4


def test_without_scrambling_it_is_sobols_sequence():
    """SciPy's, digit by digit; it goes through the points in Gray code order."""
    qmc = pytest.importorskip("scipy.stats.qmc", reason="the oracle of Sobol' points")
    expected = qmc.Sobol(2, scramble=False, bits=32).random(2**12)
    index = np.arange(2**12, dtype=np.uint32)
    digits = jnp.asarray(index ^ (index >> 1))
    found = np.stack([sobol._reverse(digits), sobol._reverse(sobol._pascal(digits))], axis=-1) / 2**32
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("key", [0, 1, 12345, 2**32 - 1])
@pytest.mark.parametrize("start", [0, 3])
def test_every_box_of_every_shape_has_one_point(key, start):
    """Of the first and of the fourth 2^k points, for every k up to 10: the (0, 2)-sequence survives its scrambling."""
    for k in range(11):
        square = points(2**k, key, start * 2**k)
        for i in range(k + 1):
            assert (boxes(square, 2**i, 2 ** (k - i)) == 1).all(), (k, i)


def test_scrambling_is_nested_and_flips_every_digit_by_chance():
    """Owen's law: two numbers that agree in their first m digits do so afterwards, differ in the next one if they did,
    and what is behind that is flipped apart."""
    rng = np.random.default_rng(0)
    x = rng.integers(0, 2**32, 4096, dtype=np.uint32)
    seeds = jnp.asarray(rng.integers(0, 2**32, 4096, dtype=np.uint32))
    scramble = jax.jit(sobol._scramble)
    for m in (0, 1, 7, 20, 31):
        # Digits are reversed: the first is the lowest bit.
        other = x ^ np.uint32(1 << m) ^ (rng.integers(0, 2**32, 4096) << (m + 1) & (2**32 - 1)).astype(np.uint32)
        change = np.asarray(scramble(jnp.asarray(x), seeds) ^ scramble(jnp.asarray(other), seeds))
        assert (change & (2**m - 1) == 0).all() and (change >> m & 1 == 1).all()
        behind = [(change >> bit & 1).mean() for bit in range(m + 1, 32)]
        np.testing.assert_allclose(behind, 0.5, atol=5 * 0.5 / np.sqrt(4096))
    flips = np.asarray(scramble(jnp.asarray(x), seeds)) ^ x
    np.testing.assert_allclose([(flips >> bit & 1).mean() for bit in range(32)], 0.5, atol=5 * 0.5 / np.sqrt(4096))


def test_any_point_of_a_random_sequence_is_uniform():
    """So that means are unbiased: the same index of many keys, and two of its pairs together."""
    keys = keyed(jnp.arange(N, dtype=jnp.uint32), 0)
    for index in (0, 1, 100):
        pairs = [np.asarray(POINTS(jnp.full(N, index, jnp.uint32), keys + jnp.uint32(pair))) for pair in (0, 1)]
        for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (0, 3)):
            square = np.concatenate(pairs, axis=-1)[:, [i, j]]
            assert abs(chi_square(boxes(square, 16, 16), N / 256)) < 4, (index, i, j)


def test_pairs_of_one_sequence_are_padded_without_correlation():
    """A sample's numbers for one purpose say nothing of those for the next."""
    first, second = points(2**14, 77), points(2**14, 78)
    for i in (0, 1):
        for j in (0, 1):
            square = np.stack([first[:, i], second[:, j]], axis=-1)
            # At most as uneven as chance; the sequence may make it evener.
            assert chi_square(boxes(square, 16, 16), 2**14 / 256) < 4


def test_means_converge_faster_than_by_chance():
    """Of a smooth function over 64 sequences of 1024 points: at most a tenth of the error of independent ones."""

    def error(square):
        values = np.exp(-square[..., 0]) * np.cos(2 * square[..., 1])
        return np.sqrt(np.mean((values.mean(axis=-1) - (1 - np.exp(-1)) * np.sin(2) / 2) ** 2))

    spread = np.stack([points(1024, key) for key in range(64)])
    chance = np.asarray(hashed(64 * 1024, 5), np.float64).reshape(64, 1024, 2)
    assert error(spread) < 0.1 * error(chance)


def test_numbers_have_24_bits_and_stay_below_1():
    square = points(N, 3)
    assert square.min() >= 0 and square.max() < 1
    np.testing.assert_array_equal(square / STEP, np.rint(square / STEP))
    largest = jnp.full(1, 2**32 - 1, jnp.uint32)
    assert float(unit(largest)[0]) == 1 - STEP


HEIGHT, WIDTH, SAMPLES = 6, 8, 4


def numbers(rows, columns):
    """All numbers of some pixels: [rows columns samples pair 2], and hashed ones beside them."""
    pixel = (rows[:, None] * WIDTH + columns[None, :])[..., None, None]
    sample, pair = jnp.arange(SAMPLES, dtype=jnp.uint32)[:, None], jnp.arange(2, dtype=jnp.uint32)
    pixel, sample, pair = jnp.broadcast_arrays(pixel, sample[None, None], pair[None, None, None])
    spread = sobol.sobol(sample, keyed(pixel, pair))
    return jnp.concatenate([spread, uniform(keyed(pixel, sample, pair))[..., None]], axis=-1)


def test_the_same_numbers_for_any_tiling():
    """Whole, in blocks, pixel by pixel under vmap, eager and with 64 bits switched on: the same bits."""
    rows, columns = (jnp.arange(n, dtype=jnp.uint32) for n in (HEIGHT, WIDTH))
    whole = np.asarray(jax.jit(numbers)(rows, columns))
    np.testing.assert_array_equal(numbers(rows, columns), whole)
    tiles = [[numbers(rows[y : y + 4], columns[x : x + 3]) for x in (0, 3, 6)] for y in (0, 4)]
    np.testing.assert_array_equal(np.concatenate([np.concatenate(row, axis=1) for row in tiles]), whole)
    mapped = jax.vmap(lambda row: numbers(row[None], columns)[0])(rows)
    np.testing.assert_array_equal(mapped, whole)
    with jax.enable_x64(True):
        np.testing.assert_array_equal(numbers(rows, columns), whole)
    assert len(np.unique(whole[..., 2])) == whole[..., 2].size


SHARDED = """
    from test_sampling import HEIGHT, WIDTH, numbers
    rows, columns = (jnp.arange(n, dtype=jnp.uint32) for n in (HEIGHT, WIDTH))
    mesh = Mesh(np.array(jax.devices()), ("b",))
    sharded = jax.jit(jax.shard_map(lambda r: numbers(r, columns), mesh=mesh, in_specs=P("b"), out_specs=P("b")))
    np.testing.assert_array_equal(sharded(rows), jax.jit(numbers)(rows, columns))
"""


def test_the_same_numbers_for_any_number_of_devices():
    run_on_devices(2, SHARDED)


@ALL
def test_maps_have_the_density_that_they_say(name):
    """χ² of 256 boxes of equal probability, and the density's own closed form."""
    drawn, density = (np.asarray(x, np.float64) for x in MAPPED[name](hashed(N, 11)))
    square = MAPS[name](drawn)
    assert square.min() >= 0 and square.max() <= 1
    assert abs(chi_square(boxes(square, 16, 16), N / 256)) < 4
    np.testing.assert_allclose(density, DENSITIES[name](drawn), rtol=1e-6)


@ALL
def test_maps_keep_the_square_s_evenness(name):
    """Each of 256 boxes gets its share of well-spread points within a few: chance would miss it by 32 at a time."""
    drawn = np.asarray(MAPPED[name](jnp.asarray(points(N, 9), jnp.float32))[0], np.float64)
    assert chi_square(boxes(MAPS[name](drawn), 16, 16), N / 256) < -10


@ALL
def test_maps_at_the_edges(name):
    """u = 0, u → 1 and the middle, in all combinations: on the surface, of positive density, of finite slope."""
    u = jnp.asarray(np.stack(np.meshgrid(EDGES, EDGES), axis=-1).reshape(-1, 2), jnp.float32)
    drawn, density = MAPPED[name](u)
    drawn, density = np.asarray(drawn, np.float64), np.asarray(density)
    assert np.isfinite(density).all() and (density > 0).all()
    if name == "disc":
        assert (np.sum(drawn**2, axis=-1) < 1).all()
    elif name == "triangle":
        assert drawn.min() >= 0 and drawn.max() <= 1
        np.testing.assert_allclose(drawn.sum(axis=-1), 1, atol=1e-7)
    else:
        np.testing.assert_allclose(np.sum(drawn**2, axis=-1), 1, atol=5e-7)
    assert name != "cosine_hemisphere" or (drawn[:, 2] > 0).all()
    jacobian = jax.jit(jax.vmap(jax.jacrev(MAPPED[name])))(u)
    assert all(np.isfinite(part).all() for part in jacobian)
    forward = jax.jit(jax.vmap(jax.jacfwd(MAPPED[name])))(u)
    for ours, theirs in zip(jacobian, forward):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)


@ALL
def test_gradients_are_the_maps_own(name):
    """Reverse and finite differences in double precision, away from seams."""
    with jax.enable_x64(True):
        u = jnp.asarray([[0.3, 0.62], [0.81, 0.13], [0.9, 0.55], [0.2, 0.27]])
        function = MAPPED[name]
        slope = jax.jit(jax.vmap(jax.jacrev(function)))(u)
        for i in (0, 1):
            step = 1e-6 * jnp.eye(2)[i][None]
            for found, ahead, behind in zip(slope, function(u + step), function(u - step)):
                np.testing.assert_allclose(found[..., i], (ahead - behind) / 2e-6, rtol=1e-6, atol=1e-8)
