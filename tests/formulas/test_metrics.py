"""Metrics: oracles, closed forms, identical pictures to the bit, pixels that are not finite, gradients both ways."""

import importlib

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxraster import metrics
from jaxraster.metrics import exposures, flip, hdr_flip, heat, psnr, relative_mse, ssim
from jaxraster.metrics.opponent import LINEAR_FROM_XYZ, XYZ_FROM_LINEAR, hunt_lab, hyab

SIZE = (19, 26)  # odd, and no multiple of a vector's width; one size for all, so that each metric compiles once
RNG = np.random.default_rng(7)


def smooth(rng: np.random.Generator, size=SIZE) -> np.ndarray:
    """A picture of waves, edges and a little noise in [0, 1]."""
    y, x = np.mgrid[: size[0], : size[1]] / 8.0
    waves = [0.5 + 0.4 * np.sin(a * x + b * y + c) for a, b, c in rng.uniform(0.2, 3.0, (3, 3))]
    picture = np.stack(waves, -1) + 0.03 * rng.normal(size=(*size, 3))
    picture[size[0] // 3 :, size[1] // 2 :] *= 0.3
    return np.clip(picture, 0.0, 1.0).astype(np.float32)


REFERENCE = smooth(RNG)
IMAGES = {
    "noise": np.clip(REFERENCE + 0.08 * RNG.normal(size=REFERENCE.shape), 0, 1).astype(np.float32),
    "shift": np.roll(REFERENCE, 1, axis=1),
    "tint": (REFERENCE * np.array([1.0, 0.8, 0.6])).astype(np.float32),
    "another": smooth(RNG),
    "black": np.zeros_like(REFERENCE),
    "inverse": 1 - REFERENCE,
}
LIGHT = (REFERENCE * RNG.lognormal(0.0, 1.5, (*SIZE, 1)) * 4.0).astype(np.float32)
LIGHTS = {
    "noise": (LIGHT * RNG.lognormal(0.0, 0.2, LIGHT.shape)).astype(np.float32),
    "dim": 0.7 * LIGHT,
    "black": np.zeros_like(LIGHT),
}
EVS = exposures(jnp.asarray(LIGHT))


def scaled(image, reference):
    return hdr_flip(image, reference, evs=jnp.asarray(EVS, jnp.result_type(float)))


METRICS = {"relative_mse": relative_mse, "psnr": psnr, "ssim": ssim, "flip": flip, "hdr_flip": scaled}
ALL = pytest.mark.parametrize("name", METRICS)
SAME = {"relative_mse": 0.0, "psnr": np.inf, "ssim": 1.0, "flip": 0.0, "hdr_flip": 0.0}


SLOPES = {name: jax.jit(jax.grad(lambda i, r, m=m: m(i, r).value, (0, 1))) for name, m in METRICS.items()}


def of(name: str, image, reference) -> metrics.Score:
    return METRICS[name](jnp.asarray(image), jnp.asarray(reference))


@pytest.fixture(scope="module")
def evaluator():
    return pytest.importorskip("flip_evaluator", reason="the oracle of ꟻLIP has no wheel for this machine")


@pytest.mark.parametrize("case", IMAGES)
def test_flip_is_the_evaluators(evaluator, case):
    expected, mean, _ = evaluator.evaluate(REFERENCE, IMAGES[case], "LDR", applyMagma=False)
    score = of("flip", IMAGES[case], REFERENCE)
    np.testing.assert_allclose(score.map, expected[..., 0], atol=2e-4)
    np.testing.assert_allclose(score.value, mean, atol=2e-5)


@pytest.mark.parametrize("pixels_per_degree", [5.0, 30.0])
def test_flip_is_the_evaluators_at_other_distances(evaluator, pixels_per_degree):
    """Down to filters of three pixels, where a wrong window would show most."""
    image = IMAGES["noise"]
    options = {"applyMagma": False, "parameters": {"ppd": pixels_per_degree}}
    expected, _, _ = evaluator.evaluate(REFERENCE, image, "LDR", **options)
    score = flip(jnp.asarray(image), jnp.asarray(REFERENCE), pixels_per_degree=pixels_per_degree)
    np.testing.assert_allclose(score.map, expected[..., 0], atol=2e-4)


@pytest.mark.parametrize("case", LIGHTS)
def test_hdr_flip_and_its_exposures_are_the_evaluators(evaluator, case):
    expected, mean, used = evaluator.evaluate(LIGHT, LIGHTS[case], "HDR", applyMagma=False)
    assert len(EVS) == used["numExposures"] > 4
    np.testing.assert_allclose(EVS[[0, -1]], [used["startExposure"], used["stopExposure"]], atol=1e-5)
    score = of("hdr_flip", LIGHTS[case], LIGHT)
    np.testing.assert_allclose(score.map, expected[..., 0], atol=2e-4)
    np.testing.assert_allclose(score.value, mean, atol=2e-5)


def test_exposures_of_a_picture_that_is_mostly_black(evaluator):
    """The median is 0: the longest exposure is that of the smallest luminance that counts."""
    dark = np.where(np.arange(SIZE[0])[:, None, None] < 12, 0, LIGHT).astype(np.float32)
    _, _, used = evaluator.evaluate(dark, dark, "HDR", applyMagma=False)
    found = exposures(jnp.asarray(dark))
    assert len(found) == used["numExposures"]
    np.testing.assert_allclose(found[[0, -1]], [used["startExposure"], used["stopExposure"]], atol=1e-5)


@pytest.mark.parametrize(
    ("light", "expected"),
    [(0.0, [0, 0]), (1.0, [1.0832973, 1.0832973]), (np.nan, [0, 0]), (-1.0, [0, 0])],
)
def test_exposures_of_a_single_light(light, expected):
    """85 % of white is the light 2.1188 on the curve, log2 of which is 1.0833; nothing to see is exposure 0."""
    np.testing.assert_allclose(exposures(jnp.full((3, 2, 3), light)), expected, atol=1e-6)


def test_exposures_leave_out_what_is_not_finite():
    broken = LIGHT.copy()
    broken[3, 4, 1], broken[5, 6] = np.nan, np.inf
    kept = np.delete(LIGHT.reshape(-1, 3), [3 * SIZE[1] + 4, 5 * SIZE[1] + 6], axis=0)
    np.testing.assert_allclose(exposures(jnp.asarray(broken)), exposures(jnp.asarray(kept[None])), rtol=1e-12)


@pytest.mark.parametrize("case", IMAGES)
def test_ssim_is_scikit_images(case):
    compare = pytest.importorskip("skimage.metrics", reason="the oracle of SSIM is an optional package")
    options = {"data_range": 1.0, "channel_axis": -1, "gaussian_weights": True, "use_sample_covariance": False}
    images = REFERENCE.astype(np.float64), IMAGES[case].astype(np.float64)
    mean, expected = compare.structural_similarity(*images, full=True, **options)
    score = of("ssim", IMAGES[case], REFERENCE)
    np.testing.assert_allclose(score.map, expected.mean(axis=-1), atol=5e-4)
    np.testing.assert_allclose(score.value, mean, atol=2e-5)


@pytest.mark.parametrize(("case", "gain"), [("twice", 2.0), ("none", 0.0), ("same", 1.0), ("far", 1e6)])
def test_relative_mse_of_a_gain(case, gain):
    """(g - 1)² r² / (r² + 0.01), of light over eight decades."""
    r = np.geomspace(1e-4, 1e4, 9)
    reference = np.broadcast_to(r[:, None, None], (9, 2, 3)).astype(np.float32)
    score = relative_mse(jnp.asarray(np.float32(gain) * reference), jnp.asarray(reference))
    expected = (gain - 1) ** 2 * r**2 / (r**2 + 0.01)
    np.testing.assert_allclose(score.map, np.repeat(expected[:, None], 2, axis=1), rtol=1e-5)
    np.testing.assert_allclose(score.value, expected.mean(), rtol=1e-5)


@pytest.mark.parametrize(("error", "decibels"), [(1.0, 0.0), (0.1, 20.0), (1 / 255, 48.1308036), (1e-6, 120.0)])
def test_psnr_of_an_error(error, decibels):
    black = jnp.zeros((9, 2, 3))
    score = psnr(black + error, black)
    np.testing.assert_allclose(score.value, decibels, rtol=1e-6)
    np.testing.assert_allclose(score.map, error**2, rtol=1e-6)


def test_ssim_of_flat_pictures():
    """Without any pattern the luminance term is left: (2 a b + C) / (a² + b² + C)."""
    score = ssim(jnp.full((*SIZE, 3), 0.2), jnp.full((*SIZE, 3), 0.6))
    np.testing.assert_allclose(score.map, (0.24 + 1e-4) / (0.4 + 1e-4), rtol=1e-4)


def test_flip_of_full_green_and_full_blue_is_1():
    """The largest difference there is, by which all are measured."""
    green, blue = np.zeros((2, *SIZE, 3), np.float32)
    green[..., 1], blue[..., 2] = 1, 1
    np.testing.assert_allclose(of("flip", green, blue).map, 1, atol=1e-5)
    with jax.enable_x64(True):
        largest = hyab(*(hunt_lab(tuple(jnp.asarray(color[0, 0], float))) for color in (green, blue)))
    module = importlib.import_module("jaxraster.metrics.flip")
    np.testing.assert_allclose(module.LARGEST, largest, rtol=1e-8)


def test_lab_is_colour_sciences():
    """White is (100, 0, 0); elsewhere CIELAB of XYZ, a and b times L / 100, and of black as of white."""
    colour = pytest.importorskip("colour")
    rgb = np.concatenate([np.random.default_rng(3).random((50, 3)), np.eye(3), [[0] * 3, [1] * 3, [1e-3] * 3]])
    matrix = colour.models.normalised_primary_matrix(
        np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]]), np.array([0.3127, 0.3290])
    )
    lab = colour.XYZ_to_Lab(rgb @ matrix.T, np.array([0.3127, 0.3290]))
    with jax.enable_x64(True):
        found = np.stack(hunt_lab(tuple(jnp.asarray(rgb.T))), axis=-1)
    # colour-science rounds the line's slope and the corner of CIE 1976 as the standard's first edition did.
    np.testing.assert_allclose(found, lab * np.c_[np.ones(len(rgb)), lab[:, [0, 0]] / 100], atol=2e-3)
    np.testing.assert_allclose(XYZ_FROM_LINEAR @ LINEAR_FROM_XYZ, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(XYZ_FROM_LINEAR.sum(axis=1), 1, rtol=1e-14)


@ALL
@pytest.mark.parametrize("size", [SIZE, (16, 67)])
def test_identical_pictures_have_no_error_to_the_bit(name, size):
    """In every pixel, whichever lane of a vector, row of a loop or end of an array it falls on."""
    image = smooth(np.random.default_rng(1), size) * (9 if name == "hdr_flip" else 1)
    score = of(name, image, image)
    same = {"psnr": 0.0}.get(name, SAME[name])
    np.testing.assert_array_equal(score.map, np.full(size, same, np.float32))
    assert (float(score.value), int(score.undefined)) == (SAME[name], 0)


@ALL
def test_pixels_that_are_not_finite_are_counted_and_in_no_mean(name):
    """NaN and both infinities, in the image, the reference, or both. The mean is that of the rest; a metric of single
    pixels is what it is without them, and one of neighbourhoods changes as little as if they were equal in both."""
    image, reference = (LIGHTS["noise"], LIGHT) if name == "hdr_flip" else (IMAGES["noise"], REFERENCE)
    places = [(0, 0), (8, 9), (8, 10), (18, 25), (12, 3)]
    broken, wanted, mended = image.copy(), reference.copy(), image.copy()
    for value, channel, (y, x) in zip((np.nan, np.inf, -np.inf), (0, 1, slice(None)), places):
        broken[y, x, channel] = value
        mended[y, x] = reference[y, x]
    wanted[18, 25, 2] = np.nan
    broken[12, 3], wanted[12, 3, 0] = np.nan, np.inf
    score = of(name, broken, wanted)
    bad = np.isnan(score.map)
    assert sorted(map(tuple, np.argwhere(bad))) == sorted(places) and int(score.undefined) == len(places)
    assert np.isfinite(score.value)
    inside = (slice(5, -5),) * 2 if name == "ssim" else (slice(None),) * 2
    np.testing.assert_allclose(mean := np.asarray(score.map)[inside][~bad[inside]].mean(), mean)
    np.testing.assert_allclose(score.value, -10 * np.log10(mean) if name == "psnr" else mean, rtol=1e-5)
    # Pixels 12 rows or more from those that are broken in the reference see a reference equal to the whole one.
    expected = np.asarray(of(name, mended, reference).map)
    far = np.zeros(SIZE, bool)
    far[:2, :] = True
    far = (far if name in ("flip", "hdr_flip") else np.ones(SIZE, bool)) & ~bad
    if name == "ssim":
        far[7:, :10], far[12:, 19:] = False, False
    np.testing.assert_allclose(np.asarray(score.map)[far], expected[far], atol=1e-6)


@ALL
def test_a_picture_without_a_finite_pixel_has_no_value(name):
    nothing = np.full((*SIZE, 3), np.nan, np.float32)
    score = of(name, nothing, LIGHT)
    assert np.isnan(score.value) and np.isnan(score.map).all() and int(score.undefined) == SIZE[0] * SIZE[1]
    assert all((np.asarray(slope) == 0).all() for slope in SLOPES[name](jnp.asarray(nothing), jnp.asarray(LIGHT)))


@ALL
def test_mapped_over_a_batch_is_one_by_one(name):
    pairs = LIGHTS if name == "hdr_flip" else IMAGES
    reference = jnp.asarray(LIGHT if name == "hdr_flip" else REFERENCE)
    images = [jnp.asarray(pairs[case]) for case in ("noise", "black")]
    batch = jax.jit(jax.vmap(METRICS[name], (0, None)))(jnp.stack(images), reference)
    for i, image in enumerate(images):
        alone = METRICS[name](image, reference)
        np.testing.assert_allclose(batch.map[i], alone.map, atol=2e-6)
        np.testing.assert_allclose(batch.value[i], alone.value, rtol=1e-5)


@ALL
def test_reverse_forward_and_finite_differences_agree(name):
    """Into the image and into the reference; forward along both at once."""
    with jax.enable_x64(True):
        pictures = (LIGHTS["noise"], LIGHT) if name == "hdr_flip" else (IMAGES["noise"], REFERENCE)
        # Away from 0 and 1, where display codes are clipped.
        image, reference = (jnp.asarray(0.05 + 0.9 * x.astype(np.float64)) for x in pictures)
        steps = jnp.asarray(np.random.default_rng(5).normal(size=(2, *image.shape)))
        value = jax.jit(lambda t: METRICS[name](image + t[0] * steps[0], reference + t[1] * steps[1]).value)
        reverse = [jnp.sum(slope * step) for slope, step in zip(SLOPES[name](image, reference), steps)]
        at = jnp.zeros(2)
        forward = jax.jvp(value, (at,), (jnp.ones(2),))[1]
        small = 1e-8 * np.eye(2)
        numeric = [(value(at + step) - value(at - step)) / 2e-8 for step in small]
        np.testing.assert_allclose(sum(reverse), forward, rtol=1e-9)
        np.testing.assert_allclose(reverse, numeric, rtol=2e-5)


UGLY = {
    "identical": lambda r: r,
    "black": lambda r: 0 * r,
    "almost identical": lambda r: r + np.float32(1e-7),
    "equal in places": lambda r: np.where(np.arange(SIZE[1])[:, None] < 9, r, 0.5 * r).astype(np.float32),
    "NaN in a pixel": lambda r: np.where(np.arange(SIZE[1])[:, None] == 9, np.nan, 0.5 * r).astype(np.float32),
    "beyond white": lambda r: 4 * r - 1,
}


@ALL
@pytest.mark.parametrize("case", UGLY)
def test_gradients_are_finite(name, case):
    """Into the image and into the reference, in every pixel."""
    reference = jnp.asarray(np.where(np.arange(SIZE[0])[:, None, None] < 6, 0, REFERENCE))
    image = jnp.asarray(UGLY[case](np.asarray(reference)))
    slopes = SLOPES[name](image, reference)
    assert all(np.isfinite(slope).all() for slope in slopes)
    if case == "identical":
        assert all((np.asarray(slope) == 0).all() for slope in slopes)
    if case == "NaN in a pixel":
        assert (np.asarray(slopes[0])[:, 9] == 0).all() and np.asarray(slopes[0]).any()


def test_heat_is_magma_between_its_ends_and_green_where_undefined(evaluator):
    """Within 3 codes of the evaluator's table of 256, a fixed scale whatever the map holds."""
    grey = np.broadcast_to(np.linspace(0, 1, 64, dtype=np.float32)[:, None, None], (64, 9, 3)).copy()
    options = {"inputsRGB": True, "parameters": {"ppd": 5.0}}
    plain, _, _ = evaluator.evaluate(np.zeros_like(grey), grey, "LDR", applyMagma=False, **options)
    shown, _, _ = evaluator.evaluate(np.zeros_like(grey), grey, "LDR", applyMagma=True, **options)
    assert np.ptp(plain) > 0.9
    # Its table has steps of a 255th, in which a colour changes by up to 2 codes.
    np.testing.assert_allclose(heat(jnp.asarray(plain[..., 0])), shown, atol=5 / 255)
    ends = np.asarray(heat(jnp.array([[-3.0, 0.0, 1.0, np.inf, np.nan]])))[0]
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[2], ends[3])
    assert ends[4].tolist() == [0, 1, 0]
    assert (np.diff(np.asarray(heat(jnp.linspace(0.0, 1.0, 500)[None]))[0].sum(-1)) > 0).all()


A = jnp.zeros((12, 12, 3))
REFUSED = {
    "another size": (lambda: flip(A, A[1:]), ValueError, "flip: reference must be float [h, w, 3] with h = 12, w = 12"),
    "grey": (lambda: flip(A[..., :1], A), ValueError, "flip: image must be float [h, w, 3]"),
    "codes": (lambda: psnr(A.astype(int), A), TypeError, "psnr: image must be float [h, w, c]"),
    "another type": (
        lambda: relative_mse(np.zeros((2, 2, 3), np.float16), A[:2, :2]),
        TypeError,
        "relative_mse: image must be float32 or float64",
    ),
    "a batch": (lambda: psnr(A[None], A[None]), ValueError, "map over a batch with jax.vmap"),
    "small": (lambda: ssim(A[:10], A[:10]), ValueError, "ssim: image must have at least 11 x 11 pixels, got 12 x 10"),
    "no distance": (lambda: flip(A, A, pixels_per_degree=0.0), ValueError, "flip: pixels_per_degree must be a plain"),
    "traced distance": (
        lambda: jax.jit(lambda p: flip(A, A, pixels_per_degree=p).value)(60.0),
        ValueError,
        "flip: pixels_per_degree must be a plain",
    ),
    "traced reference": (
        lambda: jax.jit(lambda r: hdr_flip(A, r).value)(A),
        ValueError,
        "call exposures(reference) outside of jit",
    ),
    "no exposure": (lambda: hdr_flip(A, A, evs=jnp.zeros(0)), ValueError, "hdr_flip: evs must be one or more numbers"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_argument_is_refused_in_one_line(case):
    jaxtyping.config.update("jaxtyping_disable", True)
    call, kind, message = REFUSED[case]
    try:
        with pytest.raises(kind) as caught:
            call()
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)
    assert message in str(caught.value).splitlines()[0]


def test_a_picture_of_light_closed_over_needs_no_exposures():
    reference = jnp.asarray(LIGHT)
    value = jax.jit(lambda image: hdr_flip(image, reference).value)(jnp.asarray(LIGHTS["dim"]))
    np.testing.assert_allclose(value, of("hdr_flip", LIGHTS["dim"], LIGHT).value, rtol=1e-6)
