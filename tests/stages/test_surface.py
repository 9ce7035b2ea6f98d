"""What lies at each pixel: barycentrics, footprints, normals, materials, and the pixels where nothing does."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.visibility import faces_seen, visible

from jaxraster.buffers import Visibility
from jaxraster.geometry.shapes import plane
from jaxraster.math.transform import look_at, orthographic, perspective
from jaxraster.scene import Camera, Scene
from jaxraster.scenes.parts import at, environment
from jaxraster.stack import pack_textures, stack_lights, stack_materials
from jaxraster.surface.gather import gather, view_direction
from jaxraster.surface.material import MIN_N_DOT_V, face_viewer, material, metallic_roughness
from jaxraster.surface.normal_map import normal_map
from jaxraster.visibility.barycentric import footprint, interpolate
from jaxraster.visibility.project import project
from jaxraster.visibility.raster import rasterize

SIZE = {"height": 48, "width": 64}
NUM_FACES = 60
ULP = 2.0**-23


# -- Interpolation -----------------------------------------------------------------------------------------------------


def random_clip(seed: int, w_ratio: float) -> np.ndarray:
    """Three corners each for `NUM_FACES` triangles on and around the picture, w from 1 to `w_ratio`."""
    rng = np.random.default_rng(seed)
    w = w_ratio ** rng.uniform(0, 1, (NUM_FACES, 3, 1))
    middle = rng.uniform(-1, 1, (NUM_FACES, 1, 2))
    size = 10 ** rng.uniform(-1.5, 0.3, (NUM_FACES, 1, 1))
    xy = middle + size * rng.normal(size=(NUM_FACES, 3, 2))
    z = rng.uniform(0.1, 0.9, (NUM_FACES, 3, 1))
    return np.concatenate([xy * w, z * w, w], axis=-1).reshape(-1, 4).astype(np.float32)


FACES = jnp.arange(3 * NUM_FACES, dtype=jnp.int32).reshape(-1, 3)


@pytest.fixture(scope="module")
def drawn():
    """Visibility, interpolated attributes and their footprints of the triangles in clip space."""

    @jax.jit
    def draw(clip, attributes, face) -> tuple[Visibility, jax.Array, jax.Array]:
        visibility = visible(clip, FACES, face)
        return visibility, interpolate(attributes, FACES, visibility), footprint(attributes, clip, FACES, visibility)

    rng = np.random.default_rng(9)
    attributes = rng.uniform(-2, 2, (3 * NUM_FACES, 3)).astype(np.float32)
    attributes[:, 2] = 0.1  # the same everywhere, and not exact in binary

    def at_ratio(w_ratio):
        clip = random_clip(int(np.log10(w_ratio)), w_ratio)
        # Widen every patch of faces by a pixel: coverage may pass a true edge, by far less, and β must bear it.
        face = faces_seen(clip, FACES, **SIZE)
        face = jnp.where(face < 0, jnp.roll(face, 1, axis=1), face)
        return clip, attributes, draw(jnp.asarray(clip), jnp.asarray(attributes), face)

    return {ratio: at_ratio(ratio) for ratio in (1.0, 10.0, 1e6)}


def exact_barycentric(clip: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Perspective-correct β of each pixel's three clip positions `[p, 3, 4]`, at screen places in pixels; double."""
    clip = clip.astype(np.float64)
    place = np.stack([x * 2 / SIZE["width"] - 1, 1 - y * 2 / SIZE["height"], np.ones_like(x)], axis=-1)
    # The pixel's ray is Σ β_i (x_i, y_i, w_i) up to length.
    weights = np.linalg.solve(np.swapaxes(clip[..., [0, 1, 3]], -1, -2), place[..., None])[..., 0]
    return weights / weights.sum(axis=-1, keepdims=True)


def covered(clip, visibility) -> tuple:
    """Rows, columns and clip corners of all pixels with a face."""
    face = np.asarray(visibility.face)
    rows, columns = np.nonzero(face >= 0)
    return rows, columns, clip.reshape(-1, 3, 4)[face[rows, columns]]


@pytest.mark.parametrize("ratio", [1.0, 10.0, 1e6])
def test_barycentrics_lie_on_the_simplex(drawn, ratio):
    _, _, (visibility, _, _) = drawn[ratio]
    face, beta = np.asarray(visibility.face), np.asarray(visibility.barycentric, np.float64)
    inside = face >= 0
    assert inside.mean() > 0.3 and len(np.unique(face)) > 20
    assert beta.min() >= 0 and beta.max() <= 1
    # Three quotients, each rounded by at most half an ulp, of one sum that was rounded twice.
    assert np.abs(beta[inside].sum(axis=-1) - 1).max() <= 1.5 * ULP
    assert (beta[~inside] == 0).all()


def altitude(corners: np.ndarray) -> np.ndarray:
    """The least altitude in pixels of triangles `[p, 3, 4]` in clip space."""
    corners = corners.astype(np.float64)
    place = corners[..., :2] / corners[..., 3:] * [SIZE["width"] / 2, SIZE["height"] / 2]
    side = np.roll(place, -1, axis=1) - place
    area = np.abs(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    return area / np.linalg.norm(side, axis=-1).max(axis=-1)


@pytest.mark.parametrize("ratio", [1.0, 10.0, 1e6])
def test_barycentrics_agree_with_double_precision(drawn, ratio):
    """Within 2e-6, times what a range of w and a sliver cost; outside its true triangle β is clamped."""
    clip, _, (visibility, _, _) = drawn[ratio]
    rows, columns, corners = covered(clip, visibility)
    exact = exact_barycentric(corners, columns + 0.5, rows + 0.5)
    inside = (exact >= 0).all(axis=-1)
    assert 0.8 < inside.mean() < 1
    error = np.abs(np.asarray(visibility.barycentric)[rows, columns] - exact).max(axis=-1)
    bound = 2e-6 * (corners[..., 3].max(axis=-1) / corners[..., 3].min(axis=-1)) * np.maximum(1, 1 / altitude(corners))
    print(f"w ratio {ratio:g}: largest error {(error / bound)[inside].max():.2f} of the bound")
    assert (error <= bound)[inside].all() and np.median(error[inside]) < 2e-7


@pytest.mark.parametrize("ratio", [1.0, 10.0, 1e6])
def test_a_constant_attribute_stays_exact_and_others_stay_between_their_corners(drawn, ratio):
    _, attributes, (visibility, values, _) = drawn[ratio]
    face, values = np.asarray(visibility.face), np.asarray(values)
    inside = face >= 0
    assert (values[inside][:, 2] == np.float32(0.1)).all()
    assert (values[~inside] == 0).all()
    corners = attributes.reshape(-1, 3, 3)[face[inside]]
    low, high = corners.min(axis=1), corners.max(axis=1)
    # Two products and two sums of numbers up to 4.
    assert (values[inside] >= low - 4 * ULP).all() and (values[inside] <= high + 4 * ULP).all()


@pytest.mark.parametrize(("ratio", "bound"), [(1.0, 1e-5), (10.0, 1e-4), (1e6, 3e-3)])
def test_footprints_agree_with_double_precision_differences(drawn, ratio, bound):
    clip, attributes, (visibility, _, footprints) = drawn[ratio]
    rows, columns, corners = covered(clip, visibility)
    exact = exact_barycentric(corners, columns + 0.5, rows + 0.5)
    inside = (exact >= 0).all(axis=-1)
    values = attributes.astype(np.float64).reshape(-1, 3, 3)[np.asarray(visibility.face)[rows, columns]]

    def attribute(dx, dy):
        return np.einsum("pk,pkc->pc", exact_barycentric(corners, columns + 0.5 + dx, rows + 0.5 + dy), values)

    step = 1e-4  # pixels: the second derivative of a 1/w of ratio 10 adds 1e-8 of the first
    right = (attribute(step, 0) - attribute(-step, 0)) / (2 * step)
    down = (attribute(0, step) - attribute(0, -step)) / (2 * step)
    exact = np.stack([right, down], axis=-1)[inside]
    measured = np.asarray(footprints)[rows, columns][inside]
    # Slivers magnify the rounding of their corners: weigh errors by the whole step of the pixel.
    scale = np.abs(exact).max(axis=(1, 2))
    error = np.abs(measured - exact).max(axis=(1, 2)) / (scale + 1e-3)
    print(f"w ratio {ratio:g}: largest relative error {error.max():.1e}, median {np.median(error):.1e}")
    assert np.quantile(error, 0.98) < bound and np.median(error) < 1e-5
    assert (measured[:, 2] == 0).all()
    assert (np.asarray(footprints)[np.asarray(visibility.face) < 0] == 0).all()


def test_the_gradient_of_a_footprint_is_finite_everywhere(drawn):
    clip, attributes, (visibility, _, _) = drawn[10.0]

    def total(clip, attributes, face):
        seen = visible(clip, FACES, face)
        return jnp.sum(footprint(attributes, clip, FACES, seen) ** 2)

    for slope in jax.jit(jax.grad(total, (0, 1)))(jnp.asarray(clip), jnp.asarray(attributes), visibility.face):
        assert jnp.isfinite(slope).all() and jnp.abs(slope).max() > 0


# -- Normal maps -------------------------------------------------------------------------------------------------------

N = np.array([0.0, 0.0, 1.0])
T = np.array([1.0, 0.0, 0.0, 1.0])


def mapped(color, scale=1.0, normal=N, tangent=T):
    return np.asarray(normal_map(*(jnp.asarray(np.asarray(a, np.float32)) for a in (color, scale, normal, tangent))))


def test_a_flat_map_is_the_interpolated_normal():
    rng = np.random.default_rng(10)
    normal = rng.normal(size=(100, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = np.concatenate([rng.normal(size=(100, 3)), rng.choice([-1, 1], (100, 1))], axis=1)
    flat = mapped(np.tile([0.5, 0.5, 1.0], (100, 1)), np.ones(100), normal, tangent)
    np.testing.assert_allclose(flat, normal, atol=2e-7)


def test_directions_of_the_map():
    """Red goes along the tangent, green along the bitangent w · n × t, scale to the slopes alone."""
    s = np.sqrt(0.5)
    np.testing.assert_allclose(mapped([1.0, 0.5, 0.5]), [1, 0, 0], atol=1e-7)
    np.testing.assert_allclose(mapped([0.5, 1.0, 0.5]), [0, 1, 0], atol=1e-7)
    np.testing.assert_allclose(mapped([0.5, 1.0, 0.5], tangent=T * [1, 1, 1, -1]), [0, -1, 0], atol=1e-7)
    np.testing.assert_allclose(mapped([1.0, 0.5, 1.0], 0.5), np.array([1, 0, 2]) / np.sqrt(5), atol=1e-7)
    np.testing.assert_allclose(mapped([1.0, 0.5, 1.0], -1.0), [-s, 0, s], atol=1e-7)
    np.testing.assert_allclose(mapped([1.0, 1.0, 1.0], 0.0), N, atol=1e-7)


def test_the_tangent_is_straightened_and_its_length_does_not_count():
    for tangent in ([1, 0, 5, 1], [1e-10, 0, 0, 1], [1e10, 0, 0, 1], [1, 0, 0, 0.1], [3, 0, -2, 1]):
        np.testing.assert_allclose(mapped([1.0, 0.75, 1.0], tangent=tangent), mapped([1.0, 0.75, 1.0]), atol=1e-6)


FALLBACKS = {
    "no direction in the map": ([0.5, 0.5, 0.5], 1.0, N, T, N),
    "slopes scaled away": ([1.0, 0.0, 0.5], 0.0, N, T, N),
    "no tangent": ([0.9, 0.2, 1.0], 1.0, N, [0, 0, 0, 0], N),
    "no tangent and a flat map": ([0.5, 0.5, 1.0], 1.0, N, [0, 0, 0, 1], N),
    "tangent along the normal": ([0.9, 0.2, 1.0], 1.0, N, [0, 0, 3, 1], N),
    "no normal": ([0.5, 0.5, 1.0], 1.0, [0, 0, 0], T, [0, 0, 0]),
    "nothing at all": ([0.5, 0.5, 0.5], 1.0, [0, 0, 0], [0, 0, 0, 0], [0, 0, 0]),
}


@pytest.mark.parametrize("name", FALLBACKS)
def test_without_a_frame_the_interpolated_normal_is_left(name):
    *arguments, expected = FALLBACKS[name]
    np.testing.assert_array_equal(mapped(*arguments), expected)


def test_gradients_of_normal_maps_are_finite_without_a_frame():
    cases = [case[:4] for case in FALLBACKS.values()] + [([0, 0, 0], 1.0, N, T), ([0.6, 0.5, 0.9], 1.0, N, T)]
    arguments = tuple(jnp.asarray(np.array(a, np.float32)) for a in zip(*cases))
    every = (0, 1, 2, 3)
    modes = jax.vmap(lambda *a: [mode(normal_map, every)(*a) for mode in (jax.jacrev, jax.jacfwd)])
    reverse, forward = jax.jit(modes)(*arguments)
    for r, f in zip(reverse, forward):
        assert jnp.isfinite(r).all() and jnp.isfinite(f).all()
        np.testing.assert_allclose(r, f, rtol=1e-5, atol=1e-5)
    # In an ordinary frame the mapped normal turns with the colour: by 2/|2c - 1| across it.
    red = np.asarray(forward[0])[-1, :, 0]
    d = np.array([0.2, 0.0, 0.8])
    unit = d / np.linalg.norm(d)
    np.testing.assert_allclose(red, 2 / np.linalg.norm(d) * (np.array([1, 0, 0]) - unit * unit[0]), atol=1e-5)


# -- Normals that face away --------------------------------------------------------------------------------------------


def test_normals_are_bent_only_as_far_as_visible():
    rng = np.random.default_rng(11)
    normal, view = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 4096, 3)))
    normal, view = (jnp.asarray(v, jnp.float32) for v in (normal, view))
    bent = face_viewer(normal, view)
    before, after = (np.asarray(jnp.sum(n * view, axis=-1)) for n in (normal, bent))
    facing = before >= MIN_N_DOT_V
    np.testing.assert_array_equal(bent[facing], normal[facing])
    assert 0.4 < facing.mean() < 0.6
    assert after.min() >= MIN_N_DOT_V - ULP
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1, atol=3e-7)
    # In the plane of the two, and no further than the rim: n·v after is MIN_N_DOT_V over the length before.
    shortened = np.sqrt(1 - before**2 + MIN_N_DOT_V**2)
    np.testing.assert_allclose(after[~facing], (MIN_N_DOT_V / shortened)[~facing], rtol=2e-2)
    across = np.cross(normal, view)
    assert np.abs((np.asarray(bent) * across).sum(axis=1)).max() < 1e-6


def test_a_normal_that_points_straight_away_becomes_the_view():
    n, v = jnp.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]), jnp.array([[0.0, 0.0, 1.0]] * 2)
    np.testing.assert_allclose(face_viewer(n, v), [[0, 0, 1]] * 2, atol=1e-7)
    modes = jax.jit(jax.vmap(lambda n, v: [mode(face_viewer, (0, 1))(n, v) for mode in (jax.jacrev, jax.jacfwd)]))
    assert all(jnp.isfinite(slope).all() for slope in jax.tree.leaves(modes(n, v)))


# -- Materials ---------------------------------------------------------------------------------------------------------


def test_metallic_and_roughness():
    base = jnp.array([[0.5, 0.2, 1.0]] * 4)
    diffuse, f0, alpha, _ = metallic_roughness(
        base, jnp.array([0.0, 0.25, 1.0, 0.0]), jnp.array([0.0, 0.3, 1.0, 0.045])
    )
    np.testing.assert_allclose(diffuse, np.array([[1.0], [0.75], [0.0], [1.0]]) * base, rtol=1e-6)
    np.testing.assert_allclose(f0[0], [0.04] * 3, rtol=1e-6)
    np.testing.assert_allclose(f0[1], [0.155, 0.08, 0.28], rtol=1e-6)
    np.testing.assert_allclose(f0[2], base[2], rtol=1e-6)
    np.testing.assert_allclose(alpha, [0.045**2, 0.09, 1.0, 0.045**2], rtol=1e-6)


# -- The whole stage ---------------------------------------------------------------------------------------------------

SMALL = {"height": 24, "width": 32}
COLORS = {
    "base_color": (0.5, 0.25, 0.125, 1.0),
    "metallic_roughness": (0.9, 0.6, 0.5, 1.0),
    "normal": (0.6, 0.4, 0.9, 1.0),
    "occlusion": (0.25, 0.9, 0.9, 1.0),
    "emissive": (0.5, 1.0, 0.25, 1.0),
}
ROW = {"base_color": (0.8, 0.4, 0.2), "metallic": 0.5, "roughness": 0.5, "emissive": (2.0, 3.0, 4.0)}
ROW |= {"occlusion_strength": 0.5}
TEXTURED = ROW | {f"{slot}_texture": number for number, slot in enumerate(COLORS)}


@pytest.fixture(scope="module")
def see():
    """Gather and material of a square, of any materials, vertices and cameras; slots are compiled in."""
    packed = pack_textures([np.broadcast_to(np.float32(c), (2, 2, 4)) for c in COLORS.values()])
    # Facing +Z, its image upright.
    square = at(plane(), 0.0, 0.0, 0.0, None, pitch=90.0)

    def scene(rows, vertices, numbers) -> Scene:
        nothing = (0.0, 0.0, 0.0)
        mesh = replace(square, vertices=vertices, material=numbers)
        return Scene(
            mesh=mesh, materials=rows, textures=packed, lights=stack_lights(), environment=environment(nothing, nothing)
        )

    @jax.jit
    def everything(rows, vertices, numbers, camera, face):
        clip = project(vertices, camera, **SMALL)
        fragment = gather(scene(rows, vertices, numbers), visible(clip, square.faces, face), clip, camera)
        return fragment, material(fragment, rows, packed, tuple(COLORS))

    def pixels(vertices, camera):
        return faces_seen(project(vertices, camera, **SMALL), square.faces, **SMALL)

    def see(*rows, vertices=square.vertices, numbers=(0, 0), eye=(0.0, 0.0, 2.0), camera=None):
        if camera is None:
            view = look_at(jnp.array(eye), jnp.zeros(3))
            camera = Camera(world_from_view=view, clip_from_view=perspective(0.8))
        return everything(
            stack_materials(rows), vertices, jnp.array(numbers, jnp.int32), camera, pixels(vertices, camera)
        )

    see.square, see.everything, see.pixels = square, everything, pixels
    # A corner of one face only.
    first, second = np.asarray(square.faces)
    see.lonely = int(np.setdiff1d(first, second)[0])
    return see


def test_the_square_faces_plus_z(see):
    np.testing.assert_allclose(see.square.normals, [[0, 0, 1]] * 4, atol=1e-7)
    np.testing.assert_allclose(see.square.tangents, [[1, 0, 0, 1]] * 4, atol=1e-7)


def test_textures_multiply_their_factors_channel_by_channel(see):
    _, surface = see(TEXTURED, ROW)
    mask = np.asarray(surface.mask)
    assert 0.2 < mask.mean() < 0.8
    base, metallic, roughness = np.array([0.8, 0.4, 0.2]) * [0.5, 0.25, 0.125], 0.5 * 0.5, 0.5 * 0.6
    expected = {
        "diffuse_color": base * (1 - metallic),
        "f0": 0.04 + metallic * (base - 0.04),
        "alpha": roughness**2,
        "emissive": np.array([2.0, 3.0, 4.0]) * [0.5, 1.0, 0.25],
        "occlusion": 1 + 0.5 * (0.25 - 1),
        "normal": np.array([0.2, -0.2, 0.8]) / np.linalg.norm([0.2, -0.2, 0.8]),
        "geometric_normal": [0, 0, 1],
    }
    for name, value in expected.items():
        np.testing.assert_allclose(
            np.asarray(getattr(surface, name))[mask],
            np.broadcast_to(value, getattr(surface, name)[mask].shape),
            rtol=1e-5,
            atol=1e-6,
            err_msg=name,
        )


def test_every_face_has_its_own_material(see):
    fragment, surface = see(TEXTURED, ROW, numbers=(1, 0))
    number, mask = np.asarray(fragment.material), np.asarray(surface.mask)
    assert (number[mask] == 0).any() and (number[mask] == 1).any() and (number[~mask] == 0).all()
    plain = mask & (number == 1)
    np.testing.assert_allclose(np.asarray(surface.f0)[plain], np.tile([0.42, 0.22, 0.12], (plain.sum(), 1)), rtol=1e-5)
    np.testing.assert_allclose(np.asarray(surface.alpha)[plain], 0.25, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(surface.occlusion)[plain], 1)
    np.testing.assert_allclose(np.asarray(surface.normal)[plain], np.tile([0, 0, 1], (plain.sum(), 1)), atol=1e-6)


def test_geometry_under_the_pixels(see):
    fragment, surface = see(ROW, ROW)
    mask = np.asarray(surface.mask)
    position, uv = np.asarray(surface.position)[mask], np.asarray(surface.uv)[mask]
    # The image is upright: u to the right, v downwards.
    np.testing.assert_allclose(uv, np.stack([position[:, 0] + 0.5, 0.5 - position[:, 1]], axis=-1), atol=1e-6)
    exact = np.array([0, 0, 2]) - position
    np.testing.assert_allclose(
        np.asarray(surface.view)[mask], exact / np.linalg.norm(exact, axis=1, keepdims=True), atol=1e-6
    )
    # A pixel is 2 tan(0.4) · 2 m / 24 wide, all over a square that faces the camera.
    pixel = 4 * np.tan(0.4) / 24
    steps = np.asarray(fragment.footprint)[mask]
    np.testing.assert_allclose(steps, np.broadcast_to([[pixel, 0], [0, pixel]], steps.shape), atol=1e-6)


def test_from_behind_the_normal_is_the_fronts_negative(see):
    """A tilt to the left stays a tilt to the left of the same point, now into the other half space."""
    _, front = see(TEXTURED, ROW)
    _, back = see(TEXTURED, ROW, eye=(0.0, 0.0, -2.0))
    # From behind the picture is mirrored, and the square symmetric.
    mask = np.asarray(front.mask)
    np.testing.assert_array_equal(np.asarray(back.mask)[:, ::-1], mask)
    normal = np.asarray(front.normal)[mask]
    assert (normal[:, 0] > 0.2).all() and (normal[:, 1] < -0.2).all()
    np.testing.assert_allclose(np.asarray(back.normal)[:, ::-1][mask], -normal, atol=1e-6)
    np.testing.assert_allclose(np.asarray(back.position)[:, ::-1][mask], np.asarray(front.position)[mask], atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(back.geometric_normal)[:, ::-1][mask], -np.asarray(front.geometric_normal)[mask], atol=1e-6
    )
    for surface in (front, back):
        assert (np.asarray(jnp.sum(surface.normal * surface.view, axis=-1))[mask] > 0.5).all()


def test_mapped_normals_are_bent_towards_a_grazing_view(see):
    """The map leans away from an eye on the left, the square itself does not."""
    fragment, surface = see(TEXTURED, ROW, eye=(-2.0, 0.0, 0.2))
    mask = np.asarray(surface.mask)
    cosine = np.asarray(jnp.sum(surface.normal * surface.view, axis=-1))[mask]
    assert mask.sum() > 20 and cosine.min() > 0.99 * MIN_N_DOT_V and cosine.min() < 2 * MIN_N_DOT_V
    assert np.asarray(jnp.sum(fragment.normal * fragment.view, axis=-1))[mask].min() > 0.05


def test_views_of_parallel_projections_are_parallel_and_at_the_eye_point_back():
    view = look_at(jnp.array([3.0, 4.0, 0.0]), jnp.zeros(3))
    places = jnp.array([[0.0, 0.0, 0.0], [100.0, -7.0, 3.0], [3.0, 4.0, 0.0]])
    flat = Camera(world_from_view=view, clip_from_view=orthographic(1.0, 0.1, 10.0))
    np.testing.assert_allclose(view_direction(places, flat), [[0.6, 0.8, 0]] * 3, atol=1e-6)
    pinhole = replace(flat, clip_from_view=perspective(1.0))
    there = np.array([-97, 11, -3]) / np.linalg.norm([-97, 11, -3])
    np.testing.assert_allclose(view_direction(places, pinhole), [[0.6, 0.8, 0], there, [0.6, 0.8, 0]], atol=1e-6)


# -- Where nothing is --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def total(see):
    """Sum of all that a surface holds, for pictures with background; its gradients in scene and camera."""

    def total(rows, vertices, camera, face):
        fragment, surface = see.everything(rows, vertices, jnp.zeros(2, jnp.int32), camera, face)
        leaves = [fragment.footprint, *(v for v in jax.tree.leaves(surface) if jnp.issubdtype(v.dtype, jnp.floating))]
        return sum(jnp.sum(jnp.sin(v)) for v in leaves)

    return jax.jit(jax.value_and_grad(total, (0, 1, 2), allow_int=True))


VIEW = Camera(world_from_view=look_at(jnp.array([0.3, 0.2, 2.0]), jnp.zeros(3)), clip_from_view=perspective(0.8))


def test_background_pixels_are_finite_and_face_the_viewer(see):
    fragment, surface = see(TEXTURED, ROW)
    nothing = ~np.asarray(surface.mask)
    assert nothing.any()
    for leaf in jax.tree.leaves((fragment, surface)):
        assert np.isfinite(np.asarray(leaf, np.float32)).all()
    view = np.asarray(surface.view)[nothing]
    np.testing.assert_allclose(np.linalg.norm(view, axis=-1), 1, atol=1e-6)
    for vectors in (fragment.normal, surface.geometric_normal, surface.normal):
        np.testing.assert_array_equal(np.asarray(vectors)[nothing], view)
    assert (np.asarray(fragment.footprint)[nothing] == 0).all() and (np.asarray(surface.alpha)[nothing] > 0).all()


@pytest.mark.parametrize(
    "name", ["as it is", "out of sight", "a corner not a number", "a corner infinite", "a point", "through the camera"]
)
def test_gradients_stay_finite_whatever_the_square_is(see, total, name):
    vertices = np.array(see.square.vertices)
    if name == "out of sight":
        vertices += [100, 0, 0]
    elif name == "a corner not a number":
        vertices[see.lonely] = np.nan
    elif name == "a corner infinite":
        vertices[see.lonely] = [np.inf, 0, 0]
    elif name == "a point":
        vertices[:] = 0
    elif name == "through the camera":
        vertices = vertices[:, [0, 2, 1]] * [1, 1, 50] + [0, -0.3, 0]
    vertices = jnp.asarray(vertices, jnp.float32)
    value, slopes = total(stack_materials([TEXTURED]), vertices, VIEW, see.pixels(vertices, VIEW))
    assert jnp.isfinite(value)
    # A corner that is not finite reaches the camera's gradient through their product, but nothing else's.
    for leaf in jax.tree.leaves(slopes[:2] if "corner" in name else slopes):
        assert leaf.dtype == jax.dtypes.float0 or jnp.isfinite(leaf).all()
    assert (np.abs(slopes[1]).max() > 0) == (name not in ("out of sight", "a point"))


def test_a_missing_corner_leaves_the_other_face_alone(see):
    """Its face is not drawn; the other one's pixels hold what they held."""
    _, whole = see(TEXTURED, ROW)
    vertices = see.square.vertices.at[see.lonely].set(jnp.nan)
    fragment, half = see(TEXTURED, ROW, vertices=vertices)
    mask = np.asarray(half.mask)
    assert 0.4 < mask.sum() / np.asarray(whole.mask).sum() < 0.6
    for one, other in zip(jax.tree.leaves(half), jax.tree.leaves(whole)):
        np.testing.assert_allclose(np.asarray(one)[mask], np.asarray(other)[mask], atol=1e-6)
    for leaf in jax.tree.leaves((fragment, half)):
        assert np.isfinite(np.asarray(leaf, np.float32)).all()


def test_the_gradient_of_a_map_of_uvs_is_that_of_the_uvs_as_they_are():
    """Also at the identity, and where the uvs lie outside of one period: whole numbers shift the map's derivative."""
    rng = np.random.default_rng(21)
    packed = pack_textures([rng.uniform(0, 1, (8, 8, 4)).astype(np.float32)])
    square = at(plane(), 0.0, 0.0, 0.0, None, pitch=90.0)
    square = replace(square, uvs=square.uvs * 0.5 + 4.3)
    camera = Camera(world_from_view=look_at((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)), clip_from_view=perspective(0.8))
    nothing = (0.0, 0.0, 0.0)
    clip = project(square.vertices, camera, **SMALL)
    face = faces_seen(clip, square.faces, **SMALL)

    @jax.jit
    def total(matrix):
        rows = stack_materials([{"emissive": (1.0, 1.0, 1.0), "emissive_texture": 0}])
        rows = replace(rows, uv_transforms=jnp.broadcast_to(matrix, (1, 5, 2, 3)))
        scene = Scene(
            mesh=square,
            materials=rows,
            textures=packed,
            lights=stack_lights(),
            environment=environment(nothing, nothing),
        )
        fragment = gather(scene, visible(clip, square.faces, face), clip, camera)
        return jnp.sum(material(fragment, rows, packed, ("emissive",)).emissive)

    identity = jnp.eye(2, 3)
    slope = np.asarray(jax.grad(total)(identity))
    for i, j in np.ndindex(2, 3):
        step = jnp.zeros((2, 3)).at[i, j].set(1e-3)
        expected = float(total(identity + step) - total(identity - step)) / 2e-3
        assert abs(slope[i, j] - expected) < 0.02 * np.abs(slope).max(), (i, j)


@pytest.mark.parametrize("turn", range(3))
def test_depth_of_a_plane_to_the_horizon_is_that_of_double_precision(turn):
    """Whichever corner is the far one: its weight is tiny, and multiplied by its w."""
    corners = np.array([[0, 0.9e6, 0.1, 1e6], [-0.2, -0.2, 0.1, 0.2], [0.2, -0.2, 0.1, 0.2]], np.float32)
    clip = np.roll(corners, turn, axis=0)
    visibility = jax.jit(lambda clip: rasterize(clip, FACES[:1], **SIZE))(jnp.asarray(clip))
    rows, columns, corners = covered(clip, visibility)
    exact = exact_barycentric(corners, columns + 0.5, rows + 0.5)
    inside = (exact >= 0).all(axis=-1)
    z, w = (np.einsum("pk,pk->p", exact, corners[..., i].astype(np.float64)) for i in (2, 3))
    assert inside.sum() > 100
    np.testing.assert_allclose(np.asarray(visibility.depth)[rows, columns][inside], (z / w)[inside], rtol=8 * ULP)


def test_footprints_of_attributes_far_from_zero_lose_nothing():
    clip = jnp.array([[-1.0, -1, 0.5, 1], [3, -1, 0.5, 1], [-1, 3, 0.5, 1]])
    attributes = 2.0**13 + jnp.array([[0.0], [2.0**-8], [0.0]])
    visibility = rasterize(clip, FACES[:1], **SIZE)
    footprints = footprint(attributes, clip, FACES[:1], visibility)
    np.testing.assert_allclose(np.asarray(footprints[..., 0, 0]), 2.0**-8 / (2 * SIZE["width"]), rtol=1e-5)
