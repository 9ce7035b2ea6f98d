"""The conventions of docs/conventions.md, one by one, and that the page names a test for each."""

import pathlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.buffers import Radiance, Visibility
from jaxraster.display.exposure import exposure
from jaxraster.display.tonemap import tonemap
from jaxraster.display.transfer import srgb_encode
from jaxraster.light.shadow_map import ShadowMap
from jaxraster.math.transform import invert_rigid, look_at, perspective
from jaxraster.plan import Plan
from jaxraster.render import render
from jaxraster.resolve import resolve
from jaxraster.scene import Camera
from jaxraster.scenes import stage
from jaxraster.stack import pack_textures
from jaxraster.surface.material import metallic_roughness
from jaxraster.surface.texture import texture
from jaxraster.visibility.barycentric import interpolate
from jaxraster.visibility.project import clip_from_world, project
from jaxraster.visibility.raster import rasterize

ROOT = pathlib.Path(__file__).parents[2]
SIZE = {"height": 6, "width": 8}
FACES = jnp.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
# A small square near the eye, up and to the right, and a floor that runs away from it: nearer below.
NEAR = [(0.0, 0.0, -2.0), (9.0, 0.0, -2.0), (9.0, 9.0, -2.0), (0.0, 9.0, -2.0)]
FLOOR = [(-9.0, -1.0, -1.5), (9.0, -1.0, -1.5), (9.0, 9.0, -40.0), (-9.0, 9.0, -40.0)]
VERTICES = jnp.array(NEAR + FLOOR)
HERE = Camera(world_from_view=jnp.eye(4), clip_from_view=perspective(jnp.pi / 2, 0.5))


def see(vertices: jax.Array, **options) -> Visibility:
    return rasterize(project(vertices, HERE, **SIZE), FACES, **SIZE, **options)


@pytest.fixture(scope="module")
def seen() -> Visibility:
    return see(VERTICES)


def test_the_camera_looks_down_minus_z_with_y_up_and_row_0_on_top(seen):
    """+X is to the right, +Y in the rows of lower number, and what has a negative z is in front."""
    first = np.asarray(seen.face)
    assert np.isin(first[:3, 4:], (0, 1)).all() and not np.isin(first[3:], (0, 1)).any()
    assert not np.isin(first[:, :4], (0, 1)).any()
    assert (np.asarray(see(VERTICES * jnp.array([[1.0, 1.0, -1.0]])).face) == -1).all()


def test_nothing_is_face_minus_1_and_depth_0(seen):
    face, depth = np.asarray(seen.face), np.asarray(seen.depth)
    assert (face == -1).any() and ((face == -1) == (depth == 0)).all()


def test_depth_is_reversed_and_the_greater_wins(seen):
    """1 at the near plane, towards 0 far away: near / distance for an infinite far plane."""
    depth, face = np.asarray(seen.depth), np.asarray(seen.face)
    np.testing.assert_allclose(depth[:3, 4:], 0.5 / 2.0, rtol=1e-6)
    behind = np.asarray(see(VERTICES.at[:4, 2].set(-2000.0)).depth)
    floor = np.isin(np.asarray(see(VERTICES.at[:4, 2].set(1.0)).face), (2, 3))
    assert (face[:3, 4:] < 2).all() and (behind[floor] > 0.5 / 2000).all()
    ends = project(jnp.array([[0.0, 0.0, -0.5], [0.0, 0.0, -1e30]]), HERE, **SIZE)
    np.testing.assert_allclose(ends[:, 2] / ends[:, 3], [1.0, 0.0], atol=1e-7)


def test_pixel_centres_are_at_one_half_and_barycentrics_perspective_correct(seen):
    """The point seen by pixel (row, column) lies on the ray through (column + ½, row + ½), on a slanted floor too."""
    x, y, z = np.moveaxis(np.asarray(interpolate(VERTICES, FACES, seen), np.float64), -1, 0)
    hit = np.asarray(seen.face) >= 2
    row, column = np.nonzero(hit)
    assert len(row) > 10
    # The vertical field of view is 90°, so that the picture's upper edge is at y = -z; pixels are square.
    np.testing.assert_allclose(x[hit] / -z[hit], ((column + 0.5) - 4) / 3, atol=1e-5)
    np.testing.assert_allclose(y[hit] / -z[hit], (3 - (row + 0.5)) / 3, atol=1e-5)


def test_front_faces_are_counter_clockwise():
    """Culling the back keeps the square, whose corners go round against the clock; culling the front drops it."""
    assert (np.asarray(see(VERTICES, cull="back").face)[:3, 4:] >= 0).all()
    assert not np.isin(np.asarray(see(VERTICES, cull="front").face), (0, 1)).any()


def test_matrices_are_read_right_to_left():
    """clip_from_view @ view_from_world on columns, the first row scaled by height / width."""
    pose = look_at(jnp.array([3.0, 2.0, 5.0]), jnp.array([0.0, 1.0, 0.0]))
    camera = Camera(world_from_view=pose, clip_from_view=perspective(0.7, 0.1, 50.0))
    expected = np.diag([6 / 8, 1, 1, 1]) @ np.asarray(camera.clip_from_view) @ np.asarray(invert_rigid(pose))
    np.testing.assert_allclose(clip_from_world(camera, **SIZE), expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(pose @ invert_rigid(pose), np.eye(4), atol=1e-6)
    point = np.array([0.3, -0.2, 0.5])
    clip = project(jnp.asarray(point[None], jnp.float32), camera, **SIZE)
    np.testing.assert_allclose(clip[0], expected @ [*point, 1], rtol=1e-5, atol=1e-6)


def test_uv_origin_is_the_images_top_left():
    """u grows to the right and v downwards, texel centres at +½."""
    image = np.arange(4 * 6, dtype=np.float32).reshape(2, 3, 4)
    textures, index = pack_textures([image]), jnp.zeros(2, jnp.int32)
    uv = jnp.array([[0.5 / 3, 0.25], [2.5 / 3, 0.75]])
    np.testing.assert_allclose(
        texture(textures, index, uv, jnp.zeros((2, 2, 2))), [image[0, 0], image[1, 2]], atol=1e-5
    )


def test_alpha_is_roughness_squared():
    half = jnp.array([0.5])
    assert metallic_roughness(jnp.ones((1, 3)), half, half)[2].tolist() == [0.25]


def test_light_is_linear_and_the_display_alone_knows_srgb():
    """A pixel half covered by white is half the light, and that is code 188 of 255, not 128."""
    light = np.zeros((2, 2, 3), np.float32)
    light[:, 0] = 1.0
    dark = jnp.zeros((2, 2, 3))
    radiance = Radiance(
        direct_diffuse=jnp.asarray(light),
        direct_specular=dark,
        indirect_diffuse=dark,
        indirect_specular=dark,
        emitted=dark,
    )
    hdr = resolve(radiance, jnp.ones((2, 2), bool), None, 2)
    assert hdr.tolist() == [[[0.5, 0.5, 0.5]]]
    image = srgb_encode(tonemap(exposure(hdr, 0.0), "clip"))
    np.testing.assert_array_equal(np.rint(255 * np.asarray(image)), np.full((1, 1, 3), 188))


def test_geometry_asks_for_full_precision():
    """No matrix product of a rendering is left to an accelerator's default, which rounds factors to 10 bits."""
    scene, camera = stage()
    plan = Plan(width=16, height=16, shadow_map=ShadowMap())
    program = str(jax.make_jaxpr(lambda s, c, p: render(s, c, p).image)(scene, camera, plan))
    products = program.count("dot_general[")
    assert products > 0
    assert program.count("precision=(Precision.HIGHEST, Precision.HIGHEST)") == products


def test_the_page_names_a_test_for_each():
    """Every row of the first table names a test that exists."""
    page = (ROOT / "docs" / "conventions.md").read_text().split("\n## ")[0]
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page)
    rows = [line for line in page.splitlines() if line.startswith("| ") and "---" not in line]
    assert len(named) >= len(rows) - 1 > 8
    missing = [f"{file}::{test}" for file, test in named if f"def {test}(" not in (ROOT / file).read_text()]
    assert missing == []
