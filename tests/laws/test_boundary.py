"""The API's boundary: what is no argument is refused when the call is traced, by one line that says what was meant."""

import functools
import logging
from dataclasses import replace

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import small

import jaxraster as jr
from jaxraster.light.ambient import Ambient

SCENE, CAMERA, PLAN = small.scene(directional=[((0.0, -1.0, 0.0), 1.0)]), small.camera(), jr.Plan(width=4, height=4)
NUM = SCENE.mesh.vertices.shape[0]
CLIP, FACES = jnp.zeros((8, 4)), jnp.zeros((2, 3), jnp.int32)
IMAGE, PACKED = np.ones((2, 2, 4), np.float32), jr.pack_textures([])
UV, FOOTPRINT = jnp.zeros((5, 2)), jnp.zeros((5, 2, 2))


@pytest.fixture(autouse=True)
def without_the_type_checker():
    """Users do not have the one that these tests run under."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def changed(part: str, **fields):
    """The scene with other fields in one of its parts."""
    names = part.split(".")
    owners = [functools.reduce(getattr, names[:depth], SCENE) for depth in range(len(names) + 1)]
    for owner, name in zip(reversed(owners), [*reversed(names), None]):
        fields = {name: replace(owner, **fields)}
    return fields[None]


def render(scene=SCENE, camera=CAMERA, plan=PLAN):
    return jax.eval_shape(lambda s, c: jr.render(s, c, plan).image, scene, camera)


def rasterize(clip=CLIP, faces=FACES, **options):
    return jr.rasterize(clip, faces, **{"height": 4, "width": 4, **options})


MESH = SCENE.mesh
CASES = {
    "vertices transposed": (
        lambda: render(changed("mesh", vertices=MESH.vertices.T)),
        ValueError,
        f"scene.mesh.vertices must be float [v, 3], got float32 [3, {NUM}]",
    ),
    "vertices flat": (
        lambda: render(changed("mesh", vertices=MESH.vertices.ravel())),
        ValueError,
        f"scene.mesh.vertices must be float [v, 3], got float32 [{3 * NUM}]",
    ),
    "vertices as a list": (
        lambda: rasterize(clip=[[0.0, 0.0, 0.0, 1.0]]),
        TypeError,
        "rasterize: clip must be float [..., v, 4], got list; make it an array",
    ),
    "normals of another mesh": (
        lambda: render(changed("mesh", normals=MESH.normals[:-1])),
        ValueError,
        f"scene.mesh.normals must be float [v, 3] with v = {NUM}, got float32 [{NUM - 1}, 3]",
    ),
    "faces as floats": (
        lambda: render(changed("mesh", faces=MESH.faces.astype(float))),
        TypeError,
        "scene.mesh.faces must be int [f, 3], got float32",
    ),
    "light in codes": (
        lambda: render(changed("lights.directional", irradiance=np.full((2, 3), 255, np.uint8))),
        TypeError,
        "scene.lights.directional.irradiance must be float [d, 3] with d = 2, got uint8 [2, 3]",
    ),
    "a batch of cameras": (
        lambda: render(camera=jax.tree.map(lambda x: jnp.stack([x, x]), CAMERA)),
        ValueError,
        "camera.world_from_view must be float [4, 4], got float32 [2, 4, 4]; map over a batch with jax.vmap",
    ),
    "camera and scene swapped": (lambda: render(CAMERA, SCENE), TypeError, "scene must be a Scene, got Camera"),
    "a face of no vertex": (
        lambda: jr.render(changed("mesh", faces=MESH.faces.at[0, 1].set(NUM)), CAMERA, PLAN),
        ValueError,
        f"scene.mesh.faces holds {NUM}, but there are {NUM} vertices, counted from 0",
    ),
    "a face of no material": (
        lambda: jr.render(changed("mesh", material=MESH.material.at[0].set(-1)), CAMERA, PLAN),
        ValueError,
        "scene.mesh.material holds -1, but there are 5 materials, counted from 0",
    ),
    "a material of no texture": (
        lambda: jr.render(changed("materials", normal_texture=jnp.full(5, 9)), CAMERA, PLAN),
        ValueError,
        "scene.materials.normal_texture holds 9, but there are 2 textures, counted from 0",
    ),
    "rasterize: index of no vertex": (
        lambda: rasterize(faces=FACES.at[1, 2].set(8)),
        ValueError,
        "rasterize: faces holds 8, but there are 8 vertices, counted from 0",
    ),
    "rasterize: negative index": (lambda: rasterize(faces=FACES - 1), ValueError, "rasterize: faces holds -1, but"),
    "rasterize: traced size": (
        lambda: jax.jit(lambda n: rasterize(width=n).depth)(4),
        ValueError,
        "rasterize: width must be a whole number of at least 1, got JitTracer(~int32[]) (close over it)",
    ),
    "interpolate: vertices by columns": (
        lambda: jr.interpolate(jnp.zeros(8), FACES, rasterize()),
        ValueError,
        "interpolate: attributes must be float [v, c], got float32 [8]",
    ),
    "interpolate: fewer attributes than vertices": (
        lambda: jr.interpolate(jnp.zeros((2, 1)), FACES + 5, rasterize()),
        ValueError,
        "interpolate: faces holds 5, but there are 2 vertices",
    ),
    "texture: index as float": (
        lambda: jr.texture(PACKED, jnp.zeros(5), UV, FOOTPRINT),
        TypeError,
        "texture: index must be int [...], got float32 [5]",
    ),
    "texture: uv with a third number": (
        lambda: jr.texture(PACKED, 0, jnp.zeros((5, 3)), FOOTPRINT),
        ValueError,
        "texture: uv must be float [..., 2], got float32 [5, 3]",
    ),
    "texture: footprint of other pixels": (
        lambda: jr.texture(PACKED, 0, UV, FOOTPRINT[:4]),
        ValueError,
        "texture: uv is [5, 2], but footprint [4, 2, 2]; it has one axis more",
    ),
    "pack_textures: codes": (
        lambda: jr.pack_textures([IMAGE, IMAGE.astype(np.uint8)]),
        TypeError,
        "pack_textures: images[1] must be float [h, w, 4], got uint8 [2, 2, 4]",
    ),
    "pack_textures: no alpha": (
        lambda: jr.pack_textures([IMAGE[..., :3]]),
        ValueError,
        "pack_textures: images[0] must be float [h, w, 4], got float32 [2, 2, 3]",
    ),
    "pack_textures: no texels": (
        lambda: jr.pack_textures([IMAGE[:0]]),
        ValueError,
        "pack_textures: images[0] has no texels, its shape is [0, 2, 4]",
    ),
    "pack_textures: wrap of another count": (
        lambda: jr.pack_textures([IMAGE], [(0, 0), (1, 1)]),
        ValueError,
        "pack_textures: wrap must hold a row of 2 codes, from 0 to (2, 2), for each of 1 images",
    ),
    "pack_textures: unknown wrap": (
        lambda: jr.pack_textures([IMAGE], [(0, 10497)]),
        ValueError,
        "pack_textures: wrap must hold a row of 2 codes, from 0 to (2, 2), for each of 1 images, got [(0, 10497)]",
    ),
    "plan: traced size": (
        lambda: jax.jit(lambda n: jr.Plan(width=n).exposure)(4),
        TypeError,
        "Plan.width is static: expected int, str, bool or a tuple of these, got ",
    ),
    "plan: size as float": (
        lambda: jr.Plan(width=4.0),
        TypeError,
        "Plan.width is static: expected int, str, bool or a tuple of these, got float",
    ),
    "plan: effect as a switch": (
        lambda: jr.Plan(ambient=True),
        ValueError,
        "Plan.ambient must be None or Ambient(...), got True",
    ),
    "plan: effect in another's place": (
        lambda: jr.Plan(emission=Ambient()),
        ValueError,
        "Plan.emission must be None or Emission(...), got Ambient",
    ),
    "plan: exposure in words": (
        lambda: jr.Plan(exposure="1"),
        TypeError,
        "Plan.exposure must be a number, got '1'",
    ),
    "plan: culling by name": (
        lambda: jr.Plan(cull="back"),
        ValueError,
        "Plan.cull must be True or False, got 'back'",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_no_argument_is_refused_in_one_line(case):
    call, kind, message = CASES[case]
    with pytest.raises(kind) as caught:
        call()
    # JAX may append lines of its own.
    assert message in str(caught.value).splitlines()[0]


def test_arrays_of_numpy_will_do():
    """Scenes, cameras and textures of NumPy arrays are drawn like those of JAX arrays."""
    plain, camera = jax.tree.map(np.asarray, (SCENE, CAMERA))
    drawn = jax.jit(jr.render)(plain, camera, PLAN).image
    np.testing.assert_array_equal(drawn, jax.jit(jr.render)(SCENE, CAMERA, PLAN).image)
    clip = jr.project(plain.mesh.vertices, camera, height=4, width=4)
    visibility = jr.rasterize(np.asarray(clip), plain.mesh.faces, height=4, width=4)
    assert jr.interpolate(plain.mesh.uvs, plain.mesh.faces, visibility).shape == (4, 4, 2)
    assert jr.footprint(plain.mesh.uvs, np.asarray(clip), plain.mesh.faces, visibility).shape == (4, 4, 2, 2)
    assert jr.texture(plain.textures, 1, np.asarray(UV), np.asarray(FOOTPRINT)).shape == (5, 4)


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.int32])
def test_small_indices_reach_every_texture(dtype):
    """The table of levels has more rows than an index of 8 bits can count."""
    greys = [np.full((64, 64, 4), i / 100, np.float32) for i in range(100)]
    seen = jr.texture(
        jr.pack_textures(greys), jnp.arange(100).astype(dtype), jnp.zeros((100, 2)), jnp.zeros((100, 2, 2))
    )
    np.testing.assert_allclose(seen[:, 0], np.arange(100) / 100, rtol=1e-6)


def test_a_second_call_outside_of_jit_compiles_nothing(caplog):
    """The verbs and `render` itself, called as they are."""

    def draw():
        clip = jr.project(SCENE.mesh.vertices, CAMERA, height=4, width=4)
        visibility = jr.rasterize(clip, SCENE.mesh.faces, height=4, width=4)
        uv = jr.interpolate(SCENE.mesh.uvs, SCENE.mesh.faces, visibility)
        steps = jr.footprint(SCENE.mesh.uvs, clip, SCENE.mesh.faces, visibility)
        return jr.texture(SCENE.textures, 0, uv, steps), jr.render(SCENE, CAMERA, PLAN).image

    draw()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        draw()
    assert [record.message for record in caplog.records if "ompil" in record.message] == []


def test_an_unknown_index_is_left_out_and_counted():
    """Where the faces are traced their values are unknown; none of these triangles may be drawn."""
    clip = jnp.array([[-1.0, -1.0, 0.5, 1.0], [3.0, -1.0, 0.5, 1.0], [-1.0, 3.0, 0.5, 1.0]])
    faces = jnp.array([[0, 1, 3], [0, 1, 2], [-1, 1, 2], [2**31 - 1, 1, 2]])
    seen = jax.jit(lambda c, f: jr.rasterize(c, f, height=2, width=2))(clip, faces)
    assert (seen.face == 1).all()
    assert (seen.stats.out_of_range, seen.stats.non_finite, seen.stats.degenerate) == (3, 0, 0)
