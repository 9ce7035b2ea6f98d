"""What may be done to an input without changing the picture, or changing it only in a way that is known beforehand."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from hard_case import case
from on_screen import clip_of, depth_inside, draw, num_wrong, on_grid, pixels, same, with_w
from reference import raster as twin

from jaxraster.math.transform import look_at, perspective
from jaxraster.plan import Plan
from jaxraster.render import render
from jaxraster.scene import Camera
from jaxraster.visibility import raster

HEIGHT, WIDTH = 32, 64  # powers of two: positions on a grid of 1/256 px are exact in clip space
NUM = 200
KINDS = ("directional", "point", "spot", "environment", "emission")
PLAN = Plan(width=small.WIDTH, height=small.HEIGHT, texture_slots=())


def triangles(seed, grid=None, size=8.0):
    """Corners `[n, 3, 2]` of triangles over the picture and beyond its border."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform([-4, -4], [WIDTH + 4, HEIGHT + 4], (NUM, 1, 2)) + rng.normal(0, size, (NUM, 3, 2))
    return on_grid(corners, grid)


def scattered(seed, w=True, **options):
    """Clip positions and faces of such triangles, each corner at a depth and, with `w`, at a w of its own."""
    rng = np.random.default_rng(seed)
    corners = triangles(seed, **options)
    corners = with_w(corners, np.exp(rng.uniform(-2, 2, (NUM, 3)))) if w else corners
    clip = clip_of(corners, HEIGHT, WIDTH, rng.uniform(0.05, 1, (NUM, 3)))
    return clip.reshape(-1, 4), np.arange(3 * NUM).reshape(NUM, 3)


def see(clip, faces):
    return draw(clip, faces, HEIGHT, WIDTH)


@case("I1", "the same input again", "the same bits")
def test_the_same_input_gives_the_same_bits():
    assert same(see(*scattered(1)), see(*scattered(1)))


@case("I3", "faces with their winding reversed, nothing culled", "the same faces, and weights in the reversed order")
def test_winding_changes_no_coverage():
    clip, faces = scattered(3)
    front, back = see(clip, faces), see(clip, faces[:, ::-1])
    assert (front.face == back.face).all() and len(np.unique(front.face)) > 50
    # Cross products of the corners are taken the other way round, and w spans e⁴ in a triangle.
    assert np.abs(front.barycentric - back.barycentric[..., ::-1]).max() < 2e-6


@case("I5", "triangles moved by whole pixels, where no border cuts them", "the same faces, moved; exact on 1/256 px")
@pytest.mark.parametrize("step", [(1, 0), (0, -1), (-3, 2), (16, 5)])
def test_moving_by_whole_pixels_moves_the_picture(step):
    rng = np.random.default_rng(5)
    inner = rng.uniform([20, 10], [WIDTH - 20, HEIGHT - 10], (NUM, 3, 2))
    depth, faces = rng.permutation(NUM)[:, None] / NUM * 0.9 + 0.05, np.arange(3 * NUM).reshape(NUM, 3)
    here, there = (
        see(clip_of(on_grid(inner, 256) + offset, HEIGHT, WIDTH, depth).reshape(-1, 4), faces)
        for offset in ((0, 0), step)
    )
    assert (np.roll(here.face, step[::-1], (0, 1)) == there.face).all()
    # Both are the same float of depth: a picture's position enters neither.
    np.testing.assert_allclose(np.roll(here.depth, step[::-1], (0, 1)), there.depth, rtol=1e-6)
    assert len(np.unique(here.face)) > 10


def on_an_edge(clip, faces):
    """Pixels whose centre lies exactly on an edge of some triangle, as snapped."""
    points, _ = twin.snapped(clip, HEIGHT, WIDTH)
    centres = np.round((pixels(HEIGHT, WIDTH) - [WIDTH / 2, HEIGHT / 2]) * twin.SUBPIXELS).astype(np.int64)
    ends = [(points[faces[:, k]], points[faces[:, (k + 1) % 3]]) for k in range(3)]
    return np.any([[(twin.edge(a, b, centres) == 0) for a, b in zip(*end)] for end in ends], axis=(0, 1))


@case("I6", "a scene mirrored from left to right", "the mirrored picture, but for centres exactly on an edge")
@pytest.mark.parametrize("seed", range(4))
def test_mirroring_mirrors_the_picture(seed):
    clip, faces = scattered(seed, size=4.0)
    seen, mirrored = see(clip, faces), see(clip * np.float32([-1, 1, 1, 1]), faces)
    sure = ~on_an_edge(clip, faces)
    assert (seen.face == mirrored.face[:, ::-1])[sure].all() and sure.mean() > 0.7
    assert len(np.unique(seen.face)) > 50


@case(
    "I6", "edges through pixel centres, mirrored or not", "a top or left edge has its pixels, a bottom or right one not"
)
@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_edges_on_centres_belong_to_the_top_and_the_left(mirror):
    square = np.array([[22.5, 6.5], [41.5, 6.5], [41.5, 25.5], [22.5, 25.5]])
    seen = see(clip_of(square, HEIGHT, WIDTH) * np.float32([mirror, 1, 1, 1]), np.array([[0, 1, 2], [0, 2, 3]]))
    expected = np.full((HEIGHT, WIDTH), False)
    expected[6:25, 22:41] = True
    assert ((seen.face >= 0) == expected).all()


@case(
    "R14", "work that ends anywhere in a chunk, a group or a window", "the same bits: nothing has a capacity to exceed"
)
@case("I7", "chunks, groups and windows of other sizes", "the same bits")
def test_no_length_of_a_loop_changes_a_bit(monkeypatch):
    clip, faces = scattered(7, size=12.0)
    # Some triangles cross the plane of the camera, so that all three ways of drawing are taken.
    clip[::31, 3] *= -1
    seen = see(clip, faces)
    # Compile anew: nothing that was compiled with the usual lengths is found again.
    monkeypatch.setattr(raster, "_power_of_two", lambda number, least, most: 7)
    monkeypatch.setattr(raster, "_core", functools.cache(raster._core.__wrapped__))
    assert same(see(clip, faces), seen) and len(np.unique(seen.face)) > 50
    assert seen.stats.non_finite == 0


@case("I9", "triangles split at the middle of an edge", "every pixel is covered by exactly one part")
@pytest.mark.parametrize("seed", range(3))
def test_parts_of_a_split_triangle_cover_it_once(seed):
    # Corners on even steps of the grid, whose middles lie on a step and exactly on the edge.
    for a, b, c in triangles(seed, grid=128, size=20.0)[:8]:
        middle = (b + c) / 2
        halves = np.array([[a, b, middle], [a, middle, c]])
        quarter = np.array([[a, (a + b) / 2, middle], [(a + b) / 2, b, middle], [a, middle, c]])
        whole = see(clip_of(np.array([a, b, c]), HEIGHT, WIDTH), np.array([[0, 1, 2]])).face == 0
        for parts in (halves, quarter):
            assert num_wrong(parts, whole, HEIGHT, WIDTH) == 0
            union = (
                see(clip_of(parts, HEIGHT, WIDTH).reshape(-1, 4), np.arange(3 * len(parts)).reshape(-1, 3)).face >= 0
            )
            assert (union == whole).all()


def zoom(x, y):
    """Clip positions, as rows, times this are twice as large, moved by (x, y) w."""
    return np.float32([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0], [x, y, 0, 1]])


@case("I10", "twice the resolution", "the four samples of a pixel agree with its one, but beside an edge")
def test_twice_the_resolution_differs_beside_edges_alone():
    for corners in triangles(10, grid=256, size=15.0)[:12]:
        clip, face = clip_of(corners, HEIGHT, WIDTH), np.array([[0, 1, 2]])
        coarse = see(clip, face).face == 0
        # Each quarter of the larger picture is one of the same size, on its own part of the clip space.
        quarters = [[see(clip @ zoom(x, y), face).face == 0 for x in (1, -1)] for y in (-1, 1)]
        fine = np.block(quarters).reshape(HEIGHT, 2, WIDTH, 2)
        # A sample is √2/4 px from the centre.
        away = np.abs(depth_inside(corners, pixels(HEIGHT, WIDTH))) > 0.36
        assert ((fine == coarse[:, None, :, None]) | ~away[:, None, :, None]).all() and away.any()


LIT = small.scene(
    [
        {"emissive": (0.0, 0.0, 0.0)},
        {"metallic": 1.0, "roughness": 0.3},
        {"emissive": (0.5, 0.2, 0.1)},
        {"metallic": 0.5},
        {},
    ],
    directional=[((-0.4, -1.0, -0.3), 2.0)],
    point=[((0.5, 2.0, 1.5), 4.0)],
    spot=[((1.0, 3.0, 1.0), (-0.2, -1.0, -0.3), 6.0)],
    sky=0.4,
    ground=0.2,
)
EXTRA = np.float32([[-9, -3, -9], [9, -3, -9], [0, -3, 9]])  # below the floor
SLOT = len(LIT.mesh.vertices) + np.arange(3)


def with_extra(corners, face, scene=LIT):
    """The scene and one more triangle."""
    mesh = scene.mesh
    last = {"normals": (0, 1, 0), "tangents": (1, 0, 0, 1), "uvs": (0, 0)}
    grown = {
        name: jnp.concatenate([getattr(mesh, name), jnp.full((3, len(v)), jnp.array(v, jnp.float32))])
        for name, v in last.items()
    }
    return replace(
        scene,
        mesh=replace(
            mesh,
            vertices=jnp.concatenate([mesh.vertices, jnp.asarray(corners)]),
            faces=jnp.concatenate([mesh.faces, jnp.array([face], mesh.faces.dtype)]),
            material=jnp.append(mesh.material, jnp.array(small.BOX, mesh.material.dtype)),
            **grown,
        ),
    )


EYE, TARGET = (1.0, 2.0, 4.0), (0.0, 0.8, 0.0)


def camera(scale=1.0):
    pose = look_at(jnp.array(EYE) * scale, jnp.array(TARGET) * scale)
    return Camera(world_from_view=pose, clip_from_view=perspective(0.8, 0.1 * scale, 100.0 * scale))


_render = jax.jit(lambda scene, camera: render(scene, camera, PLAN))


def picture(scene, scale=1.0):
    """The whole frame of a scene to which a triangle is added, so that one program draws all."""
    scene = scene if len(scene.mesh.faces) > len(LIT.mesh.faces) else with_extra(EXTRA * scale, [0, 0, 0], scene)
    return jax.device_get(_render(scene, camera(scale)))


def brighter(scene, **factors):
    """The scene with each kind of light multiplied by its factor."""
    every, lights = dict.fromkeys(KINDS, 1.0) | factors, {}
    for kind, field in (("directional", "irradiance"), ("point", "intensity"), ("spot", "intensity")):
        light = getattr(scene.lights, kind)
        lights[kind] = replace(light, **{field: getattr(light, field) * every[kind]})
    tones = {tone: getattr(scene.environment, tone) * every["environment"] for tone in ("sky", "ground")}
    return replace(
        scene,
        lights=replace(scene.lights, **lights),
        environment=replace(scene.environment, **tones),
        materials=replace(scene.materials, emissive=scene.materials.emissive * every["emission"]),
    )


@case(
    "I4",
    "a scene, its camera and the ranges of its lights scaled by 2^k, lights by 4^k",
    "light and picture, bit for bit",
)
@pytest.mark.parametrize("power", [-20, -3, 1, 10])
def test_scaling_the_world_by_a_power_of_two_changes_no_bit(power):
    scale = 2.0**power
    lights = {}
    for kind in ("point", "spot"):
        light = getattr(LIT.lights, kind)
        lights[kind] = replace(light, position=light.position * scale, range=light.range * scale)
    larger = replace(
        LIT, mesh=replace(LIT.mesh, vertices=LIT.mesh.vertices * scale), lights=replace(LIT.lights, **lights)
    )
    usual, scaled = picture(LIT), picture(brighter(larger, point=scale**2, spot=scale**2), scale)
    assert len(np.unique(usual.visibility.face)) > 8
    assert same(usual.visibility, scaled.visibility)
    for name in ("hdr", "image"):
        np.testing.assert_array_equal(getattr(usual, name), getattr(scaled, name))


NOT_SEEN = {  # corners, and the three of them that the face names
    "hidden below the floor": (EXTRA, SLOT),
    "behind the camera": (EXTRA * [1, 1, 0.1] + [0, 2, 9], SLOT),
    "beside the picture": (EXTRA * 0.1 + [90, 0, 0], SLOT),
    "without area before the camera": (np.array([[0, 1, 3], [0, 1.5, 3], [0, 2, 3]]), SLOT),
    "a corner that is not a number": (np.array([[0, 1, 3], [1, 1.5, np.nan], [1, 2, 3]]), SLOT),
    "corners at infinity": (np.array([[0, 1, 3], [np.inf, 1, 3], [1, -np.inf, 3]]), SLOT),
    "an index that names no vertex": (EXTRA, [0, 1, 2**30]),
}


@case("I8", "something more that is hidden, out of sight, without area or broken", "no number of any pixel changes")
@pytest.mark.parametrize("name", NOT_SEEN)
def test_what_is_not_seen_changes_no_number(name):
    corners, face = NOT_SEEN[name]
    usual, more = picture(LIT), picture(with_extra(np.float32(corners), face))
    for (path, one), other in zip(jax.tree_util.tree_leaves_with_path(usual), jax.tree.leaves(more), strict=True):
        where = jax.tree_util.keystr(path)
        if ".stats" not in where:
            np.testing.assert_array_equal(one, other, err_msg=where)


@case("I11", "all light multiplied by 2^k", "the picture's light, times 2^k, bit for bit")
@pytest.mark.parametrize("power", [-30, -1, 20])
def test_light_times_a_power_of_two_is_the_pictures_times_it(power):
    scaled = picture(brighter(LIT, **dict.fromkeys(KINDS, 2.0**power)))
    np.testing.assert_array_equal(scaled.hdr, picture(LIT).hdr * 2.0**power)


@case("I11", "each kind of light alone", "their pictures' light adds up to that of all, within 4 ulp")
def test_light_of_each_kind_adds_up_to_the_pictures():
    parts = [picture(brighter(LIT, **{other: float(other == kind) for other in KINDS})).hdr for kind in KINDS]
    assert all(part.max() > 0.01 for part in parts)
    together = picture(LIT).hdr
    np.testing.assert_allclose(np.sum(parts, axis=0, dtype=np.float64), together, rtol=4 * 2.0**-23)


@case("I12", "white metal in a world of one tone", "never brighter than it; darker by what single scattering loses")
@pytest.mark.parametrize(("roughness", "least"), [(0.0, 0.97), (0.3, 0.93), (1.0, 1 - np.log(2))])
def test_white_metal_in_a_white_world_is_not_brighter_than_it(roughness, least):
    row = {"base_color": (1.0, 1.0, 1.0), "metallic": 1.0, "roughness": roughness}
    white = small.scene([row] * 5, sky=1.0, ground=1.0)
    frame = picture(white)
    share = frame.hdr / np.array(white.environment.sky)
    assert (share[~frame.surface.mask] == 1).all()
    # A rounding of each tone above, and below what the fitted albedo may be off by.
    assert share.max() <= 1 + 2.0**-22 and share.min() > least - 0.01
