"""Texture lookup against its NumPy twin, and what it promises at borders, infinities, odd sizes and far-away uvs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import texture as twin
from reference.visibility import faces_seen, visible

from jaxraster.geometry.shapes import plane
from jaxraster.math.transform import orbit, perspective
from jaxraster.scene import CLAMP, MIRROR, REPEAT, Camera, Scene, Textures
from jaxraster.scenes.parts import environment
from jaxraster.stack import pack_textures, stack_lights, stack_materials
from jaxraster.surface.gather import gather
from jaxraster.surface.texture import texture
from jaxraster.visibility.project import project

WRAPS = [(u, v) for u in (REPEAT, CLAMP, MIRROR) for v in (REPEAT, CLAMP, MIRROR)]
# (height, width): odd, single texels and rows, powers of two; the first nine differ in wrapping only.
SIZES = [(3, 5)] * 9 + [(1, 1), (7, 1), (1, 6), (8, 8), (13, 9), (4, 16)]
SQUARE, WIDE = 12, 14
LOOKUPS = 8192  # in every call, so that one program serves all tests
lookup = jax.jit(texture)


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.uniform(0.0, 2.0, (*size, 4)).astype(np.float32) for size in SIZES]


@pytest.fixture(scope="module")
def textures(images) -> Textures:
    return pack_textures(images, WRAPS + [(CLAMP, MIRROR), (MIRROR, REPEAT), (REPEAT, CLAMP)] + [(REPEAT, REPEAT)] * 3)


def fetch(textures, index, uv, footprint=0.0):
    """Look up any number of uvs by the one compiled program; return also the arguments in full."""
    index, uv = np.asarray(index, np.int32), np.asarray(uv, np.float32)
    footprint = np.asarray(footprint, np.float32)
    count = max(index.size, len(uv), len(footprint) if footprint.ndim > 2 else 1)
    index, uv = np.broadcast_to(index, count), np.broadcast_to(uv, (count, 2))
    footprint = np.broadcast_to(footprint, (count, 2, 2))
    padded = [np.resize(a, (LOOKUPS, *a.shape[1:])) for a in (index, uv, footprint)]
    return np.asarray(lookup(textures, *map(jnp.asarray, padded)))[:count], (index, uv, footprint)


def agree(textures, index, uv, footprint=0.0, atol=3e-6):
    values, arguments = fetch(textures, index, uv, footprint)
    np.testing.assert_allclose(values, twin.texture(textures, *arguments), atol=atol)


EDGES = [0.0, -0.0, 1.0, -1.0, 2.0, 3.0, -2.0, 0.5, 1e-8, -1e-8, 1 - 6e-8, 1 + 1.2e-7, -1e-30, 1e-40]
EDGES += [0.1, 0.9, 1.1, -0.1, 2.25, -3.75, 1023.5, -4096.25, 16777217.0, 1e9, -1e9, 3e38, np.nan, np.inf, -np.inf]


@pytest.mark.parametrize("number", range(len(SIZES)))
def test_every_edge_of_every_wrapping(textures, number):
    u, v = np.meshgrid(np.float32(EDGES), np.float32(EDGES))
    agree(textures, number, np.stack([u.ravel(), v.ravel()], axis=-1))


def test_what_the_table_of_edges_means(images, textures):
    """Read off the image, not computed: the texel left of u = 0 is the last, the first, or the first again."""
    for number, (wrap_u, _) in enumerate(WRAPS):
        here, _ = fetch(textures, number, [[0.0, 0.5], [-0.0, 0.5], [1.0, 0.5]])
        first, last = images[number][1, 0], images[number][1, -1]
        expected = {REPEAT: [(first + last) / 2] * 3, CLAMP: [first, first, last], MIRROR: [first, first, last]}
        np.testing.assert_allclose(here, expected[wrap_u], atol=1e-6)
    lost, _ = fetch(textures, 0, [[np.nan, 0.5], [np.inf, 0.5], [-np.inf, 0.5], [0.0, 0.5]])
    np.testing.assert_array_equal(lost, np.broadcast_to(lost[3], (4, 4)))


def test_random_lookups_at_all_levels(textures):
    rng = np.random.default_rng(1)
    index = rng.integers(-1, len(SIZES), LOOKUPS)
    uv = rng.uniform(-3, 3, (LOOKUPS, 2))
    footprint = rng.normal(size=(LOOKUPS, 2, 2)) * 10 ** rng.uniform(-3, 1, (LOOKUPS, 1, 1))
    agree(textures, index, uv, footprint, atol=2e-5)


def test_texel_centres_are_texels(images, textures):
    x, y = np.meshgrid(np.arange(8), np.arange(8))
    here, _ = fetch(textures, SQUARE, np.stack([(x.ravel() + 0.5) / 8, (y.ravel() + 0.5) / 8], axis=-1))
    np.testing.assert_array_equal(here.reshape(8, 8, 4), images[SQUARE])
    x, y = np.meshgrid(np.arange(9), np.arange(13))
    here, _ = fetch(textures, 13, np.stack([(x.ravel() + 0.5) / 9, (y.ravel() + 0.5) / 13], axis=-1))
    np.testing.assert_allclose(here.reshape(13, 9, 4), images[13], atol=5e-6)


def test_half_way_between_texels_is_their_mean(images, textures):
    here, _ = fetch(textures, SQUARE, [[2 / 8, 2.5 / 8], [2 / 8, 3 / 8]])
    image = images[SQUARE]
    np.testing.assert_allclose(here, [image[2, 1:3].mean(axis=0), image[2:4, 1:3].mean(axis=(0, 1))], rtol=3e-7)


def box(image: np.ndarray) -> np.ndarray:
    """An 8×8 image's next level."""
    return image.reshape(image.shape[0] // 2, 2, image.shape[1] // 2, 2, 4).mean(axis=(1, 3))


def test_the_level_follows_the_footprint(images, textures):
    """A step of 2^l texels reads level l, halfway in the logarithm the mean of two levels."""
    levels = [images[SQUARE].astype(np.float64)]
    for _ in range(3):
        levels.append(box(levels[-1]))
    uv = np.array([[0.5 / 8, 0.5 / 8]])
    for axis in (0, 1):
        for direction in (0, 1):
            footprint = np.zeros((5, 2, 2))
            footprint[:, axis, direction] = np.array([1, 2, 4, 8, 2**1.5]) / 8
            values, arguments = fetch(textures, SQUARE, uv, footprint)
            np.testing.assert_allclose(values[0], levels[0][0, 0], rtol=1e-6)
            np.testing.assert_allclose(values[3], levels[3][0, 0], rtol=1e-6)
            np.testing.assert_allclose(values, twin.texture(textures, *arguments), atol=1e-6)
            # (0.5, 0.5) of the finest is a quarter of the way to level 1's first centre from outside: it repeats.
            quarter = [0.25, 0.75]
            first = sum(quarter[i] * quarter[j] * levels[1][[-1, 0][i], [-1, 0][j]] for i in (0, 1) for j in (0, 1))
            np.testing.assert_allclose(values[1], first, rtol=1e-6)
            np.testing.assert_allclose(values[4], 0.5 * (values[1] + values[2]), rtol=1e-5)


def test_the_longer_side_in_texels_counts(textures):
    """On 16 × 4 texels, 1/8 along u is two texels, along v half of one."""
    along_u, along_v = np.zeros((2, 2, 2))
    along_u[0, 0], along_v[1, 0] = 1 / 8, 1 / 8
    uv = np.random.default_rng(2).uniform(size=(16, 2))
    flat, _ = fetch(textures, WIDE, uv)
    np.testing.assert_array_equal(fetch(textures, WIDE, uv, along_v)[0], flat)
    assert np.abs(fetch(textures, WIDE, uv, along_u)[0] - flat).max() > 0.1
    agree(textures, WIDE, uv, along_u)


@pytest.mark.parametrize("size", [1e-30, 1e-20, 0.0])
def test_a_footprint_of_nothing_reads_the_finest_level(textures, size):
    uv = np.random.default_rng(3).uniform(size=(64, 2))
    finest, _ = fetch(textures, SQUARE, uv)
    np.testing.assert_array_equal(fetch(textures, SQUARE, uv, np.full((2, 2), size))[0], finest)
    np.testing.assert_array_equal(fetch(textures, SQUARE, uv, np.full((2, 2), np.nan))[0], finest)


@pytest.mark.parametrize("size", [100.0, 1e10, 1e20, 3e38, np.inf])
def test_a_footprint_of_everything_reads_the_mean(images, textures, size):
    uv = np.random.default_rng(4).uniform(size=(64, 2))
    for number in (0, 9, 10, 11, SQUARE, 13, WIDE):
        for place in np.ndindex(2, 2):
            footprint = np.zeros((2, 2))
            footprint[place] = -size
            mean = images[number].mean(axis=(0, 1), dtype=np.float64)
            np.testing.assert_allclose(fetch(textures, number, uv, footprint)[0], np.tile(mean, (64, 1)), rtol=1e-6)


@pytest.mark.parametrize(
    "size", [(1, 1), (1, 2), (1, 9), (17, 1), (3, 5), (13, 9), (8, 8), (255, 7), (2, 31), (100, 65)]
)
def test_every_level_has_the_mean_of_the_image(size):
    rng = np.random.default_rng(5)
    image = (rng.uniform(size=(*size, 4)) * 10 ** rng.uniform(0, 3, (*size, 1))).astype(np.float32)
    mean = image.mean(axis=(0, 1), dtype=np.float64)
    packed = pack_textures([image])
    texels, height, width = np.asarray(packed.texels, np.float64), *size
    end = 0
    for offset, level_width, level_height in np.asarray(packed.levels)[0]:
        assert (offset, level_width, level_height) == (end, width, height)
        end = offset + width * height
        np.testing.assert_allclose(texels[offset:end].mean(axis=0), mean, rtol=1e-6)
        last, height, width = (height, width), max(1, height // 2), max(1, width // 2)
    assert last == (1, 1) and end == len(texels)


def test_without_images_there_is_one_white_texel():
    packed = pack_textures([])
    assert packed.texels.shape == (1, 4) and (packed.texels == 1).all()
    np.testing.assert_array_equal(packed.levels, [[[0, 1, 1]]])


def test_a_constant_texture_is_constant():
    """To two ulp: the four weights are rounded and their sum is 1 only nearly."""
    value = np.float32([0.1, 0.3, 0.7, 1.0])
    packed = pack_textures([np.broadcast_to(value, (*size, 4)) for size in SIZES], WRAPS + [(REPEAT, MIRROR)] * 6)
    rng = np.random.default_rng(6)
    footprint = rng.normal(size=(LOOKUPS, 2, 2)) * 10 ** rng.uniform(-3, 3, (LOOKUPS, 1, 1))
    here, _ = fetch(packed, rng.integers(0, len(SIZES), LOOKUPS), rng.uniform(-9, 9, (LOOKUPS, 2)), footprint)
    print("largest error in ulp:", np.abs(here / value - 1).max() * 2**23)
    np.testing.assert_allclose(here, np.tile(value, (LOOKUPS, 1)), rtol=2.4e-7)


def test_no_texture_is_white(textures):
    here, _ = fetch(textures, -1, [[0.3, 0.3], [np.nan, 1.0], [1e9, np.inf]], np.full((3, 2, 2), np.nan))
    assert (here == 1).all()


# -- Gradients ---------------------------------------------------------------------------------------------------------

FEW = 256


@pytest.fixture(scope="module")
def slopes():
    """Per lookup: value, and the derivatives of all channels along uv and footprint, in both modes."""

    def both(textures, index, uv, footprint):
        def function(uv, footprint):
            return texture(textures, index, uv, footprint)

        reverse, forward = (mode(function, (0, 1))(uv, footprint) for mode in (jax.jacrev, jax.jacfwd))
        return function(uv, footprint), reverse, forward

    return jax.jit(jax.vmap(both, in_axes=(None, 0, 0, 0)))


@pytest.fixture(scope="module")
def places():
    rng = np.random.default_rng(7)
    index, uv = rng.integers(0, len(SIZES), FEW), rng.uniform(-2, 2, (FEW, 2))
    footprint = rng.normal(size=(FEW, 2, 2)) * 10 ** rng.uniform(-2, 0, (FEW, 1, 1))
    return index.astype(np.int32), uv.astype(np.float32), footprint.astype(np.float32)


def test_a_batch_is_its_members(textures, slopes, places):
    alone, _, _ = slopes(textures, *places)
    np.testing.assert_allclose(alone, fetch(textures, *places)[0], rtol=3e-7, atol=1e-7)
    by_row = jax.jit(jax.vmap(texture, in_axes=(None, 0, 0, 0)))(
        textures, *(a.reshape(16, 16, *a.shape[1:]) for a in places)
    )
    np.testing.assert_allclose(by_row.reshape(FEW, 4), alone, rtol=3e-7, atol=1e-7)


def differences(textures, index, uv, footprint, which, place, step):
    """Central differences of the twin, and one-sided ones to tell kinks: uv crosses texels, the level whole numbers."""
    values = []
    for sign in (-1, 0, 1):
        arguments = [np.array(uv, np.float64), np.array(footprint, np.float64)]
        arguments[which][(slice(None), *place)] += sign * step
        values.append(twin.texture(textures, index, *arguments))
    low, middle, high = values
    smooth = np.abs(high - 2 * middle + low).max(axis=1) < 0.02 * step
    return (high - low) / (2 * step), smooth


def test_gradients_agree_with_differences_and_with_each_other(textures, slopes, places):
    _, reverse, forward = slopes(textures, *places)
    for which, every in enumerate([[(0,), (1,)], [(0, 0), (0, 1), (1, 0), (1, 1)]]):
        for place in every:
            exact, smooth = differences(textures, *places, which, place, 1e-5)
            assert smooth.mean() > 0.9
            for mode in (reverse, forward):
                slope = np.asarray(mode[which])[(slice(None), slice(None), *place)]
                np.testing.assert_allclose(slope[smooth], exact[smooth], rtol=2e-3, atol=2e-3)
    assert np.abs(reverse[0]).max() > 1 and np.abs(reverse[1]).max() > 0.1


def test_gradients_of_texels_are_weights(textures, places):
    def total(texels, channel):
        return texture(replace(textures, texels=texels), *map(jnp.asarray, places))[:, channel].sum()

    weights = np.asarray(jax.jit(jax.grad(total), static_argnums=1)(textures.texels, 2))
    assert weights[:, 2].min() >= 0 and (weights[:, [0, 1, 3]] == 0).all()
    np.testing.assert_allclose(weights.sum(), FEW, rtol=1e-6)
    # The lookup is linear in the texels: weights times texels are the values.
    values = fetch(textures, *places)[0][:, 2].sum(dtype=np.float64)
    np.testing.assert_allclose(
        (weights[:, 2] * np.asarray(textures.texels)[:, 2]).sum(dtype=np.float64), values, rtol=1e-6
    )


UGLY_UV = [
    (0.0, 0.0),
    (1.0, 1.0),
    (-0.0, 0.5),
    (0.5 / 5, 0.5 / 3),
    (np.nan, 0.5),
    (np.inf, -np.inf),
    (1e9, -1e9),
    (2.0, 3e38),
]
UGLY_FOOTPRINT = [0.0, 1e-40, 1e-20, 0.2, 1.0, 1e10, 1e20, 3e38, np.inf, np.nan]


def test_gradients_are_finite_at_ugly_places(textures, slopes):
    cases = [(n, uv, np.full((2, 2), f)) for n in (-1, 0, 4, 8, 9, 10) for uv in UGLY_UV for f in UGLY_FOOTPRINT]
    arguments = [np.resize(np.array(a), (512, *np.shape(a)[1:])) for a in zip(*cases)]
    arguments = [a.astype(np.int32 if i == 0 else np.float32) for i, a in enumerate(arguments)]
    everything = slopes(textures, *arguments)
    for leaf in jax.tree.leaves(everything):
        bad = np.flatnonzero(~np.isfinite(np.asarray(leaf).reshape(512, -1)).all(axis=1))
        assert [cases[i] for i in bad if i < len(cases)][:3] == []
    _, reverse, _ = everything
    # Where uv is not a number there is nothing to move.
    lost = ~np.isfinite(arguments[1])
    assert (np.moveaxis(np.asarray(reverse[0]), 1, 2)[lost] == 0).all()


# -- From the mesh on --------------------------------------------------------------------------------------------------

SIZE = {"height": 32, "width": 32}


@pytest.fixture(scope="module")
def drawn():
    """The texture on a square, as a function of what its uvs are shifted by and of how they wrap."""
    rng = np.random.default_rng(8)
    packed = pack_textures([rng.uniform(size=(16, 16, 4)).astype(np.float32)])
    mesh = plane()
    # Uvs of few bits, so that they stay exact up to 2^15, and the square seen askew.
    uvs = jnp.array([[0.0, 0.0], [1.5, 0.25], [0.125, 1.0], [1.75, 1.25]])
    camera = Camera(world_from_view=orbit(0.5, 0.8, 1.2), clip_from_view=perspective(1.0))
    clip = project(mesh.vertices, camera, **SIZE)
    visibility = visible(clip, mesh.faces, faces_seen(clip, mesh.faces, **SIZE))

    @jax.jit
    def draw(shift, wrap):
        scene = Scene(
            mesh=replace(mesh, uvs=uvs + shift),
            materials=stack_materials([{"base_color_texture": 0}]),
            textures=replace(packed, wrap=wrap),
            lights=stack_lights(),
            environment=environment((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        )
        seen = gather(scene, visibility, clip, camera)
        index = jnp.where(seen.mask, 0, -1)
        return texture(scene.textures, index, seen.uv, seen.footprint), seen.uv, seen.mask

    return lambda shift, wrap: draw(jnp.array(shift, jnp.float32)[None], jnp.array([wrap], jnp.int32))


@pytest.mark.parametrize("wrap", [(REPEAT, REPEAT), (MIRROR, MIRROR), (REPEAT, MIRROR)])
def test_whole_even_shifts_change_no_bit(drawn, wrap):
    value, uv, mask = drawn((0, 0), wrap)
    assert mask.mean() > 0.2 and np.asarray(value)[np.asarray(mask)].std() > 0.1
    for shift in ((2, 0), (0, -2), (-6, 1000), (32766, -32766), (2**15, 2**15), (-(2**15), 2)):
        shifted, moved, _ = drawn(shift, wrap)
        np.testing.assert_array_equal(shifted, value)
        np.testing.assert_array_equal(moved, uv)


def test_whole_odd_shifts_change_nothing_that_repeats(drawn):
    value, _, _ = drawn((0, 0), (REPEAT, REPEAT))
    for shift in ((1, 0), (0, -1), (999, 7), (32767, -32767)):
        shifted, moved, _ = drawn(shift, (REPEAT, REPEAT))
        np.testing.assert_allclose(shifted, value, atol=2e-5)
        assert np.abs(moved).max() <= 5
    # A mirror image is another image.
    mirrored, _, _ = drawn((1, 0), (MIRROR, MIRROR))
    assert np.abs(mirrored - drawn((0, 0), (MIRROR, MIRROR))[0]).max() > 0.3


def test_clamped_uvs_stay_where_they_are(drawn):
    _, uv, mask = drawn((0, 0), (CLAMP, REPEAT))
    value, moved, _ = drawn((6, 0), (CLAMP, REPEAT))
    np.testing.assert_allclose(moved[mask], uv[mask] + jnp.array([[6.0, 0.0]]), atol=1e-5)
    assert np.abs(value - drawn((0, 0), (CLAMP, REPEAT))[0]).max() > 0.3
