"""Buffers as pictures: the right codes, black for nothing, one sample of each pixel."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.buffers import Frame, Radiance, Stats, Surface, Visibility
from jaxraster.cli.aov import AOVS, finite_pixels, pick, picture
from jaxraster.display.transfer import srgb_encode
from jaxraster.math.transform import look_at, perspective
from jaxraster.plan import Plan
from jaxraster.scene import Camera

SIZE = (2, 3)  # the picture; its first pixel sees nothing
SEEN = np.ones(SIZE, bool)
SEEN[0, 0] = False
RAMP = np.linspace(0.0, 1.0, 18, dtype=np.float32).reshape(*SIZE, 3)
FACE = np.array([[-1, 7, 7], [8, 9, 7]], np.int32)
# Two metres in front of an eye at z = 5, then three, four, and sideways, which is no farther along the axis.
POSITION = np.array([[(9, 9, 9), (0, 0, 3), (0, 0, 2)], [(0, 0, 1), (1, 0, 1), (0, 2, 1)]], np.float32)
NORMAL = np.array([[(0, 0, 0), (0, 0, 1), (0, 0, -1)], [(1, 0, 0), (0, -1, 0), (0, 1, 0)]], np.float32)


def samples(values: np.ndarray) -> jnp.ndarray:
    """2 x 2 samples a pixel, of which only the one that is to be shown is sound."""
    values = np.repeat(np.repeat(values, 2, axis=0), 2, axis=1)
    wrong = np.ones(values.shape[:2], bool)
    wrong[1::2, 1::2] = False
    values[wrong] = {"f": np.nan, "i": 12345, "b": False}[values.dtype.kind]
    return jnp.asarray(values)


@pytest.fixture(scope="module")
def frame() -> Frame:
    """A frame whose picture is 2 x 3 pixels at 2 x 2 samples each."""
    parts = dict.fromkeys(("diffuse_color", "f0", "emissive", "view"), RAMP)
    parts |= {
        "uv": RAMP[..., :2] * 4 - 1,
        "alpha": RAMP[..., 0],
        "f90": RAMP[..., 0],
        "occlusion": RAMP[..., 1],
        "position": POSITION,
    }
    parts |= {"normal": NORMAL, "geometric_normal": -NORMAL, "mask": SEEN}
    lights = {name: samples(RAMP * 8) for name in Radiance.__annotations__}
    return Frame(
        image=jnp.asarray(RAMP),
        hdr=jnp.asarray(RAMP),
        radiance=Radiance(**lights),
        surface=Surface(**{name: samples(value) for name, value in parts.items()}),
        visibility=Visibility(
            face=samples(FACE),
            barycentric=samples(RAMP),
            depth=samples(RAMP[..., 0]),
            nearness=samples(FACE),
            stats=Stats(non_finite=jnp.int32(0), degenerate=jnp.int32(0), out_of_range=jnp.int32(0)),
        ),
    )


def show(frame: Frame, name: str) -> tuple[np.ndarray, str]:
    pose = look_at(jnp.array([0.0, 0.0, 5.0]), jnp.zeros(3))
    camera = Camera(world_from_view=pose, clip_from_view=perspective(0.7))
    plan = Plan(width=3, height=2, supersample=2, exposure=-3.0, tonemap="clip")
    return picture(name, *pick(name, frame, camera, plan), plan)


EXPECTED = {
    "depth": np.repeat(np.array([[0, 1, 0.55], [0.1, 0.1, 0.1]])[..., None], 3, axis=2),
    "normal": 0.5 + 0.5 * NORMAL,
    "geometric_normal": 0.5 - 0.5 * NORMAL,
    "barycentric": RAMP,
    "uv": np.concatenate([(RAMP[..., :2] * 4) % 1, np.zeros((*SIZE, 1))], axis=2),
    "position": (POSITION - (0, 0, 1)) / (1, 2, 2),
    "diffuse_color": srgb_encode(jnp.asarray(RAMP)),
    "f0": srgb_encode(jnp.asarray(RAMP)),
    "emissive": srgb_encode(jnp.asarray(RAMP)),
    "roughness": np.repeat(np.sqrt(RAMP[..., :1]), 3, axis=2),
    "occlusion": np.repeat(RAMP[..., 1:2], 3, axis=2),
}


@pytest.mark.parametrize("name", EXPECTED)
def test_codes(frame, name):
    """Data are codes as they are, colours go through the sRGB curve, nothing is black."""
    image, _ = show(frame, name)
    assert image.shape == (*SIZE, 3)
    np.testing.assert_allclose(image, np.where(SEEN[..., None], EXPECTED[name], 0.0), atol=1e-6)


@pytest.mark.parametrize("name", Radiance.__annotations__)
def test_light_is_displayed_as_the_image_is(frame, name):
    """8 x at -3 EV through a clipping curve is x; where there is no surface there is no light of one."""
    expected = np.where((FACE >= 0)[..., None], srgb_encode(jnp.asarray(RAMP)), 0.0)
    np.testing.assert_allclose(show(frame, name)[0], expected, atol=1e-6)


def test_faces_have_colours_of_their_own(frame):
    image, about = show(frame, "face")
    colours = {tuple(image[face == FACE][0]) for face in (-1, 7, 8, 9)}
    assert len(colours) == 4 and (0.0, 0.0, 0.0) in colours
    assert (image[FACE == 7] == image[0, 1]).all()
    assert about == "3 faces"


def test_scales_are_told(frame):
    assert show(frame, "depth")[1] == "2 to 4 m, white to dark"
    assert show(frame, "position")[1] == "0 0 1 to 1 2 3 m, black to white"


def test_every_buffer_has_a_picture(frame):
    """Whatever a frame is made of can be looked at, but for what is no picture of the scene."""
    buffers = {*Surface.__annotations__, *Radiance.__annotations__, *Visibility.__annotations__}
    assert buffers - AOVS.keys() == {"mask", "view", "alpha", "nearness", "opacity", "coat", "sheen", "stats"}
    assert AOVS.keys() - buffers == {"roughness"}


def test_pixels_that_are_not_finite():
    """They are counted once a pixel and become black, the others stay."""
    image = np.full((2, 2, 3), 0.5, np.float32)
    image[0, 0, 1:], image[1, 1, 0] = np.nan, np.inf
    clean, bad = finite_pixels(image)
    assert bad == 2
    np.testing.assert_array_equal(clean[..., 0], [[0.0, 0.5], [0.5, 0.0]])
