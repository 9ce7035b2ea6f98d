"""A plan's treedef is what compiles, its leaves are knobs; `render` is the same function under jit, vmap and grad."""

import dataclasses
import functools
import logging
import re
import typing

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from small import COLOUR_TEXTURE, HEIGHT, NORMAL_TEXTURE, WIDTH

from jaxraster.display.dither import Dither
from jaxraster.display.tonemap import TONEMAPS
from jaxraster.light.ambient import Ambient
from jaxraster.light.area import Area
from jaxraster.light.background import Background
from jaxraster.light.emission import Emission
from jaxraster.light.shadow_map import ShadowMap
from jaxraster.parameters import parameters
from jaxraster.plan import Plan
from jaxraster.render import render
from jaxraster.scene import LIGHT_KINDS, TEXTURE_SLOTS
from jaxraster.screen.horizon import HorizonAO
from jaxraster.stack import stack_lights
from jaxraster.visibility.layers import Layers

CAMERA = small.camera()
SCENE = small.scene(
    [
        {"base_color_texture": COLOUR_TEXTURE},
        {"normal_texture": NORMAL_TEXTURE, "metallic": 1.0, "roughness": 0.3},
        {"emissive": (0.5, 0.2, 0.1), "double_sided": True},
        {"metallic": 0.5},
        {},
    ],
    directional=[((-0.4, -1.0, -0.3), 2.0)],
    point=[((0.5, 2.0, 1.5), 4.0)],
    sky=0.4,
    ground=0.2,
)
LAMP = stack_lights(rectangle=[((0.0, 2.5, 1.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.5), (3.0, 2.0, 1.0), True)]).rectangle
GLOWING = dataclasses.replace(SCENE, lights=dataclasses.replace(SCENE.lights, rectangle=LAMP))
WEIGHTS = np.random.default_rng(2).uniform(0.5, 1.5, (HEIGHT, WIDTH, 3)).astype(np.float32)
EFFECTS = {
    "layers": Layers(blended=1),
    "shadow_map": ShadowMap(resolution=64),
    "area": Area(kinds=("rectangle",)),
    "occlusion": HorizonAO(slices=1, steps=2),
    "ambient": Ambient(),
    "emission": Emission(),
    "background": Background(),
    "dither": Dither(),
}
SIZE = {"width": WIDTH, "height": HEIGHT}
PLAN = Plan(**SIZE, texture_slots=("base_color", "normal"), light_kinds=("directional", "point"), dither=Dither())
BARE = Plan(**SIZE, texture_slots=(), light_kinds=("directional",), **dict.fromkeys(EFFECTS))
KNOBS = [
    {"exposure": 1.0},
    {"exposure": -0.5},
    {"ambient": Ambient(gain=2.0)},
    {"emission": Emission(gain=0.0)},
    {"background": Background(blurriness=0.1, gain=3.0)},
    {"dither": Dither(amplitude=0.5)},
]
VALUES, rebuild = parameters(SCENE, ("mesh", "materials", "lights", "environment"))


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 2), has_aux=True)
def differentiate(values, camera, plan):
    """A weighted mean of the image and the whole frame; gradients in all floats of the scene and knobs of the plan."""
    frame = render(rebuild(values), camera, plan)
    return (frame.image * WEIGHTS).mean(), frame


def draw(plan, camera=CAMERA):
    return differentiate(VALUES, camera, plan)[0][1]


def stack(*records):
    """One record of several that share their integers."""
    return jax.tree.map(
        lambda a, *b: a if jnp.issubdtype(jnp.result_type(a), jnp.integer) or a.dtype == bool else jnp.stack([a, *b]),
        *(jax.tree.map(jnp.asarray, record) for record in records),
    )


def assert_same_frame(seen, expected, tolerance):
    """Integers and masks are equal, floats within `tolerance` of one or of their own size."""
    for (path, a), b in zip(jax.tree_util.tree_flatten_with_path(seen)[0], jax.tree.leaves(expected), strict=True):
        name = jax.tree_util.keystr(path)
        if jnp.issubdtype(a.dtype, jnp.floating):
            np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance, err_msg=name)
        else:
            np.testing.assert_array_equal(a, b, err_msg=name)


def test_every_effect_is_listed_here():
    hints = typing.get_type_hints(Plan)
    effects = {name: kind for name, kind in hints.items() if type(None) in typing.get_args(kind)}
    assert effects.keys() == EFFECTS.keys()
    assert all(type(EFFECTS[name]) in typing.get_args(kind) for name, kind in effects.items())


def test_every_leaf_of_a_plan_is_a_number():
    """Nothing in a plan is an array unless the caller puts it there."""
    for plan in (Plan(), Plan(**EFFECTS, exposure=1.0), *(dataclasses.replace(PLAN, **knob) for knob in KNOBS)):
        assert all(type(leaf) is float for leaf in jax.tree.leaves(plan))
    assert len(jax.tree.leaves(BARE)) == 1


def test_turning_a_knob_compiles_nothing(caplog):
    draw(PLAN)
    compiled = differentiate._cache_size()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        frames = [draw(dataclasses.replace(PLAN, **knob)) for knob in KNOBS]
        assert not [record for record in caplog.records if "ompil" in record.message or "trac" in record.message]
        # The log does tell: this function is new.
        jax.jit(lambda x: x + 1.0)(2.0)
        assert [record for record in caplog.records if "ompil" in record.message]
    assert differentiate._cache_size() == compiled == 1
    # Every knob is connected: no two pictures are the same.
    images = [np.asarray(frame.image) for frame in (draw(PLAN), *frames)]
    assert all((a != b).any() for i, a in enumerate(images) for b in images[:i])


def test_an_array_in_a_float_s_place_retraces_once_and_a_switch_once():
    traced = []

    @jax.jit
    def count(scene, camera, plan):
        traced.append(plan)
        return render(scene, camera, plan).image

    def traces(*plans):
        before = len(traced)
        for plan in plans:
            count.trace(SCENE, CAMERA, plan)
        return len(traced) - before

    assert traces(BARE, dataclasses.replace(BARE, exposure=2.0)) == 1
    assert traces(*(dataclasses.replace(BARE, exposure=jnp.float32(ev)) for ev in (0.0, 1.0))) == 1
    assert traces(*(dataclasses.replace(BARE, emission=Emission(gain=gain)) for gain in (1.0, 2.0, 3.0))) == 1
    assert traces(dataclasses.replace(BARE, tonemap="clip"), dataclasses.replace(BARE, tonemap="clip")) == 1
    assert traces(BARE, dataclasses.replace(BARE, emission=None)) == 0


def scopes(plan) -> set[str]:
    """Every part of every operation's path in the program that a plan makes."""
    program = jax.jit(render).lower(GLOWING, CAMERA, plan).as_text(debug_info=True)
    paths = re.findall(r'loc\("(jit\(render\)/[^"]*)"', program)
    assert len(paths) > 100
    return {part for path in paths for part in path.split("/")}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_leaves_a_trace_only_where_it_is_on(name):
    """With one effect alone and with none, in the program that goes to the compiler."""
    assert scopes(BARE) & EFFECTS.keys() == set()
    # Occlusion alone darkens nothing.
    on = {name, "ambient"} if name == "occlusion" else {name}
    assert scopes(dataclasses.replace(BARE, **{one: EFFECTS[one] for one in on})) & EFFECTS.keys() == on


def test_lights_with_an_area_add_their_light():
    """Where nothing else shines, it is all the light there is, and twice of it with twice the gain."""
    plan = dataclasses.replace(BARE, light_kinds=(), area=EFFECTS["area"])
    draw = jax.jit(lambda plan: render(GLOWING, CAMERA, plan).hdr)
    lit = np.asarray(draw(plan))
    assert (lit > 0).any(axis=-1).mean() > 0.5
    np.testing.assert_allclose(
        draw(dataclasses.replace(plan, area=Area(kinds=("rectangle",), gain=2.0))), 2 * lit, rtol=1e-6
    )
    with pytest.raises(ValueError, match=r'Plan\.area must be None where Plan\.shading is "local"'):
        dataclasses.replace(BARE, shading="local", area=Area())


def test_a_plan_can_be_differentiated():
    """Knob by knob against central differences; what is None stays None."""
    gradient = differentiate(VALUES, CAMERA, PLAN)[1][1]
    assert type(gradient) is Plan and gradient.shadow_map is None and gradient.width == WIDTH
    leaves, treedef = jax.tree.flatten(PLAN)
    assert jax.tree.structure(gradient) == treedef and len(leaves) == 6

    def loss(i, step):
        turned = treedef.unflatten([*leaves[:i], leaves[i] + step, *leaves[i + 1 :]])
        return (np.asarray(draw(turned).image, np.float64) * WEIGHTS).mean()

    for i, slope in enumerate(jax.tree.leaves(gradient)):
        assert slope != 0
        np.testing.assert_allclose(slope, (loss(i, 0.01) - loss(i, -0.01)) / 0.02, rtol=2e-3, atol=1e-7)


def test_gradients_are_finite_on_the_whole_picture():
    """In all of mesh, materials, lights and surroundings, of all pixels at once."""
    gradient = differentiate(VALUES, CAMERA, PLAN)[1][0]
    assert len(gradient) == 24
    for name, slope in gradient.items():
        assert np.isfinite(slope).all(), name
    moving = {"mesh.vertices", "mesh.normals", "mesh.uvs", "mesh.tangents", "materials.base_color"}
    moving |= {"materials.roughness", "materials.emissive", "lights.directional.irradiance", "lights.point.position"}
    assert all((np.asarray(gradient[name]) != 0).any() for name in moving | {"environment.sky"})


def test_mapping_over_cameras_is_the_loop():
    cameras = [CAMERA, small.camera(eye=(-2.0, 3.0, 3.0), fov_y=70.0), small.camera(eye=(0.3, 0.2, 2.0))]
    mapped = jax.jit(jax.vmap(render, in_axes=(None, 0, None)))(SCENE, stack(*cameras), BARE)
    frames = [small.render(SCENE, camera, BARE) for camera in cameras]
    assert len({np.asarray(frame.visibility.face).tobytes() for frame in frames}) == 3
    for i, frame in enumerate(frames):
        assert_same_frame(jax.tree.map(lambda leaf: leaf[i], mapped), frame, 1e-5)  # noqa: B023


def test_mapping_over_scenes_is_the_loop():
    """Vertices, lights and all knobs at once, and the shadow that depends on them; jit changes nothing either."""
    other = small.scene(directional=[((0.3, -1.0, -0.5), 3.0)], places={small.BOX: (0.6, 0.4, 0.9)})
    vertices, lights = (SCENE.mesh.vertices, other.mesh.vertices), (SCENE.lights, other.lights)
    plan = dataclasses.replace(BARE, shadow_map=EFFECTS["shadow_map"], ambient=Ambient())
    plans = [plan, jax.tree.map(lambda knob: 0.7 * knob + 0.1, plan)]

    def compose(vertices, lights):
        return dataclasses.replace(SCENE, mesh=dataclasses.replace(SCENE.mesh, vertices=vertices), lights=lights)

    mapped = jax.jit(jax.vmap(lambda vertices, lights, plan: render(compose(vertices, lights), CAMERA, plan)))
    frames = mapped(jnp.stack(vertices), stack(*lights), stack(*plans))
    for i, plan in enumerate(plans):
        expected = small.render(compose(vertices[i], lights[i]), CAMERA, plan)
        assert_same_frame(jax.tree.map(lambda leaf: leaf[i], frames), expected, 1e-5)  # noqa: B023


def test_jit_sees_the_same_triangles():
    seen, expected = draw(PLAN).visibility, small.render(SCENE, CAMERA, BARE).visibility
    assert len(np.unique(seen.face)) > 8
    assert_same_frame(seen, expected, 1e-5)


def test_double_precision_stays_double():
    """Where a caller enables it, no stage falls back to single precision on the way to the image."""

    def widen(leaf):
        return leaf.astype(jnp.float64) if leaf.dtype == jnp.float32 else leaf

    with jax.enable_x64(True):
        frame = jax.eval_shape(render, *jax.tree.map(widen, (SCENE, CAMERA)), PLAN)
    floats = [leaf.dtype for leaf in jax.tree.leaves(frame) if jnp.issubdtype(leaf.dtype, jnp.floating)]
    assert set(floats) == {np.dtype(np.float64)} and len(floats) == 20


def test_supersampling_is_the_mean_of_the_larger_picture_s_light():
    plan = dataclasses.replace(BARE, background=Background(), exposure=0.5)
    fine = small.render(SCENE, CAMERA, dataclasses.replace(plan, width=2 * WIDTH, height=2 * HEIGHT))
    averaged = small.render(SCENE, CAMERA, dataclasses.replace(plan, supersample=2))
    light = np.asarray(fine.hdr, np.float64)
    expected = (light[::2, ::2] + light[::2, 1::2] + light[1::2, ::2] + light[1::2, 1::2]) / 4
    np.testing.assert_allclose(averaged.hdr, expected, rtol=2e-7, atol=1e-7)
    assert averaged.image.shape == (HEIGHT, WIDTH, 3)
    # The samples are those of the larger picture, and are averaged as light: their displayed values are not.
    for samples in ("visibility", "surface", "radiance"):
        for a, b in zip(jax.tree.leaves(getattr(averaged, samples)), jax.tree.leaves(getattr(fine, samples))):
            np.testing.assert_array_equal(a, b)
    shown = np.asarray(fine.image, np.float64)
    of_display = (shown[::2, ::2] + shown[::2, 1::2] + shown[1::2, ::2] + shown[1::2, 1::2]) / 4
    assert np.abs(np.asarray(averaged.image) - of_display).max() > 0.01


def test_local_shading_is_lambert_and_a_highlight_without_shadows():
    plan = dataclasses.replace(BARE, shading="local")
    frame = small.render(SCENE, CAMERA, plan)
    surface, lights = frame.surface, SCENE.lights.directional
    n_dot_l = np.maximum(-np.asarray(surface.normal, np.float64) @ np.asarray(lights.direction[0]), 0)[..., None]
    expected = np.asarray(surface.diffuse_color) / np.pi * n_dot_l * np.asarray(lights.irradiance[0])
    np.testing.assert_allclose(frame.radiance.direct_diffuse, expected, rtol=1e-5, atol=1e-6)
    standard = small.render(SCENE, CAMERA, BARE)
    assert_same_frame(frame.surface, standard.surface, 0)
    assert (np.asarray(frame.radiance.direct_specular) != standard.radiance.direct_specular).any()
    assert (np.asarray(frame.radiance.direct_specular) >= 0).all() and frame.radiance.direct_specular.max() > 0
    for unlit in ("indirect_diffuse", "indirect_specular", "emitted"):
        assert (np.asarray(getattr(frame.radiance, unlit)) == 0).all()


def test_light_adds_up():
    """The picture's light is the sum of its paths where there is a surface, and the background elsewhere."""
    frame = draw(PLAN)
    total = sum(np.asarray(path, np.float64) for path in jax.tree.leaves(frame.radiance))
    mask = np.asarray(frame.surface.mask)
    np.testing.assert_array_equal(mask, np.asarray(frame.visibility.face) >= 0)
    np.testing.assert_allclose(np.asarray(frame.hdr)[mask], total[mask], rtol=1e-6)
    behind = draw(PLAN, small.camera(eye=(1.0, 2.0, 4.0), target=(1.0, 2.8, 7.2)))
    assert mask.any() and (~mask).any() and not np.asarray(behind.surface.mask).any()
    assert (np.asarray(behind.hdr) > 0).all()


LACKS = [(lack, shadow) for lack in ("nothing", "lights", "faces") for shadow in (None, ShadowMap(resolution=32))]


@pytest.mark.parametrize(("missing", "shadow_map"), LACKS)
def test_shapes_do_not_depend_on_what_a_scene_lacks(missing, shadow_map):
    """An empty mesh and lights of count 0 make a frame of the same shapes."""
    scene = SCENE
    if missing == "faces":
        mesh = jax.tree.map(lambda leaf: leaf[:0], SCENE.mesh)
        scene = dataclasses.replace(SCENE, mesh=mesh)
    if missing == "lights":
        lights = jax.tree.map(lambda leaf: leaf[:0], SCENE.lights)
        scene = dataclasses.replace(SCENE, lights=lights)
    plan = dataclasses.replace(PLAN, texture_slots=TEXTURE_SLOTS, light_kinds=LIGHT_KINDS, shadow_map=shadow_map)
    frame = jax.eval_shape(render, scene, CAMERA, plan)
    assert frame.image.shape == frame.hdr.shape == frame.radiance.emitted.shape == (HEIGHT, WIDTH, 3)
    assert frame.visibility.face.shape == (HEIGHT, WIDTH)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("width", 0, r"Plan\.width must be a whole number of at least 1, got 0"),
        ("width", -3, r"Plan\.width must be .*, got -3"),
        ("height", True, r"Plan\.height must be .*, got True"),
        ("supersample", 0, r"Plan\.supersample must be .*, got 0"),
        ("shading", "toon", r"Plan\.shading must be one of standard, gltf, local, got 'toon'"),
        ("tonemap", "filmic", r"Plan\.tonemap must be one of .*pbr_neutral.*, got 'filmic'"),
        ("texture_slots", ("base", "normal"), r"Plan\.texture_slots may hold base_color, .*, got base$"),
        ("light_kinds", ("sun", "area"), r"Plan\.light_kinds may hold directional, .*, got area, sun"),
        ("light_kinds", (1,), r"Plan\.light_kinds may hold .*, got 1"),
        ("light_kinds", ("point", "point"), r"Plan\.light_kinds names point twice"),
        ("texture_slots", ("normal", "normal"), r"Plan\.texture_slots names normal twice"),
    ],
)
def test_a_plan_that_means_nothing_is_refused(field, value, message):
    """At construction and by `replace`, in one line, before anything is compiled."""
    for make in (lambda: Plan(**{field: value}), lambda: dataclasses.replace(PLAN, **{field: value})):
        with pytest.raises(ValueError, match=message) as caught:
            make()
        assert "\n" not in str(caught.value)


def test_local_shading_has_no_shadow_map():
    with pytest.raises(ValueError, match=r'Plan\.shadow_map must be None where Plan\.shading is "local"'):
        Plan(shading="local", shadow_map=ShadowMap())


def test_all_names_are_accepted():
    for tonemap in TONEMAPS:
        assert Plan(tonemap=tonemap).tonemap == tonemap
    assert Plan(shading="local", texture_slots=(), light_kinds=()).light_kinds == ()
