"""The planner's rules: each fires, each misses by a hair, and the picture is never another than with everything on."""

import dataclasses
import functools
import re

import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from hypothesis import strategies as st
from small import AWAY, BOX, CARD, COLOUR_TEXTURE, FLOOR, HEIGHT, NORMAL_TEXTURE, WALL, WIDTH

from jaxraster.display.dither import Dither
from jaxraster.environment.prepare import prepare
from jaxraster.geometry import shapes
from jaxraster.light.ambient import Ambient
from jaxraster.light.shadow_map import ShadowMap
from jaxraster.parameters import parameters
from jaxraster.plan import Plan
from jaxraster.planner import Reason, explain, occluders, plan_for, shadow
from jaxraster.scene import BLEND, LIGHT_KINDS, MASK, TEXTURE_SLOTS, Directional, Scene
from jaxraster.scenes import SCENES, parts
from jaxraster.screen.horizon import HorizonAO
from jaxraster.stack import stack_lights
from jaxraster.visibility.layers import Layers

DOWN = (0.0, -1.0, 0.0)
SLANTED = (-0.4, -1.0, -0.3)
CAMERA = small.camera()
SIZE = {"width": WIDTH, "height": HEIGHT}
SLOT_FACTORS = {
    "base_color": {"base_color": (0.0, 1e-6, 0.0)},
    "metallic_roughness": {"metallic": 0.0, "roughness": 1e-6},
    "normal": {"normal_scale": 1e-6},
    "occlusion": {"occlusion_strength": 1e-6},
    "emissive": {"emissive": (0.0, 0.0, 1e-6)},
}


def rows(**of_floor) -> list[dict]:
    return [of_floor, {}, {}, {}, {}]


def needs(scene: Scene, **options) -> dict[str, Reason]:
    return plan_for(scene, CAMERA, **SIZE, **options)[1]


def zero(factors: dict) -> dict:
    return {name: np.zeros_like(value) for name, value in factors.items()}


def white(slot: str, strength: float = 1.0, **more) -> list[dict]:
    """The floor with a texture in one slot, and all its factors times `strength`."""
    factors = {name: np.multiply(strength, value) for name, value in SLOT_FACTORS[slot].items()}
    return rows(**{f"{slot}_texture": COLOUR_TEXTURE}, **factors, **more)


def on_unused(row: dict) -> list[dict]:
    return [{}, {}, {}, {}, row]


# (effect, scene in which it is needed, scene in which it is not, and why not)
RULES = {
    "cull": (
        "cull",
        {"rows": [{"double_sided": True}] * 3 + [{}] * 2},
        {"rows": [{"double_sided": True}] * 4 + [{}]},
        "no material in use is single-sided",
    ),
    **{
        f"{slot} with a black factor": (
            f"texture {slot}",
            {"rows": white(slot), "sky": 1.0},
            {"rows": white(slot, 0.0), "sky": 1.0},
            "every such texture is multiplied by .* of zero",
        )
        for slot in TEXTURE_SLOTS
        if slot != "normal"
    },
    **{
        f"{slot} on an unused material": (
            f"texture {slot}",
            {"rows": white(slot), "sky": 1.0},
            {"rows": on_unused(white(slot)[0]), "sky": 1.0},
            "no material in use has such a texture",
        )
        for slot in TEXTURE_SLOTS
    },
    "factor and texture on different materials": (
        "texture emissive",
        {"rows": [{"emissive_texture": 0, "emissive": (0, 1, 0)}, {}, {}, {}, {}]},
        {"rows": [{"emissive_texture": 0}, {"emissive": (0, 1, 0)}, {}, {}, {}]},
        "every such texture is multiplied by emissive of zero",
    ),
    "occlusion without ambient light": (
        "texture occlusion",
        {"rows": white("occlusion"), "ground": 1e-6},
        {"rows": white("occlusion"), "directional": [(DOWN, 1.0)]},
        "ambient light alone, and there is none",
    ),
    **{
        f"light {kind}": (
            f"light {kind}",
            {kind: [((0, 3, 0), *more, 0.0), ((0, 3, 0), *more, 1e-6)]},
            {kind: [((0, 3, 0), *more, 0.0)]},
            "2 in the scene, all black",
        )
        for kind, more in (("directional", ()), ("point", ()), ("spot", (DOWN,)))
    },
    "a black base color with an alpha that tells": (
        "texture base_color",
        {"rows": white("base_color", 0.0, alpha_mode=MASK)},
        {"rows": white("base_color", 0.0)},
        "every such texture is multiplied by base_color of zero",
    ),
    "layers of what is blended": (
        "layers",
        {"rows": rows(alpha_mode=BLEND, base_color=(1.0, 1.0, 1.0, 0.999))},
        {"rows": rows(alpha_mode=BLEND)},
        "every masked or blended material in use is opaque wherever it is",
    ),
    "layers of a blended texture": (
        "layers",
        {"rows": rows(alpha_mode=BLEND, base_color_texture=COLOUR_TEXTURE)},
        {"rows": rows(alpha_mode=BLEND, base_color_texture=NORMAL_TEXTURE)},
        "every masked or blended material in use is opaque wherever it is",
    ),
    "layers of what is masked": (
        "layers",
        {"rows": rows(alpha_mode=MASK, alpha_cutoff=0.4, base_color=(1.0, 1.0, 1.0, 0.39))},
        {"rows": rows(alpha_mode=MASK, alpha_cutoff=0.4, base_color=(1.0, 1.0, 1.0, 0.41))},
        "every masked or blended material in use is opaque wherever it is",
    ),
    "layers of an unused material": (
        "layers",
        {"rows": [{}, {}, {}, {"alpha_mode": BLEND, "base_color": (1.0, 1.0, 1.0, 0.0)}, {}]},
        {"rows": on_unused({"alpha_mode": BLEND, "base_color": (1.0, 1.0, 1.0, 0.0)})},
        "no material in use is masked or blended",
    ),
    "emission": (
        "emission",
        {"rows": [{}, {}, {}, {"emissive": (0, 0, 1e-6)}, {}]},
        {"rows": on_unused({"emissive": (1, 1, 1)})},
        "no material in use emits light",
    ),
    "emission of what is unlit": (
        "emission",
        {"rows": [{}, {}, {}, {"unlit": True}, {}]},
        {"rows": on_unused({"unlit": True})},
        "no material in use emits light",
    ),
    "ambient from the sky": ("ambient", {"sky": 1e-6}, {}, "the environment is black"),
    "ambient from the ground": ("ambient", {"ground": 1e-6}, {}, "the environment is black"),
    "background": ("background", {"ground": 1e-6}, {}, "the environment is black"),
    "shadow of a light": (
        "shadow_map",
        {"directional": [(SLANTED, 1e-6)]},
        {"directional": [(SLANTED, 0.0)]},
        "no light that throws shadows shines",
    ),
    **{
        f"shadow of a {kind}": ("shadow_map", {kind: [light(1e-6)]}, {kind: [light(0.0)]}, "no light that throws")
        for kind, light in {
            "point": lambda strength: ((0, 3, 0), strength),
            "spot": lambda strength: ((0, 3, 0), DOWN, strength),
        }.items()
    },
}


@pytest.mark.parametrize("case", RULES)
def test_each_rule_fires_and_misses_by_a_hair(case):
    effect, needed, not_needed, why = RULES[case]
    assert needs(small.scene(**needed))[effect].on
    reason = needs(small.scene(**not_needed))[effect]
    assert not reason.on
    assert re.search(why, reason.why), reason.why


def test_a_normal_map_is_never_dropped_for_its_scale():
    """Flattened to a scale of 0 it still turns the normal where its blue is below one half."""
    assert needs(small.scene(rows(normal_texture=NORMAL_TEXTURE, normal_scale=0.0)))["texture normal"].on


def meshed(*meshes, directional=((SLANTED, 1.0),)) -> Scene:
    """A scene of other meshes, all of row 0, for what is decided on the host alone."""
    return dataclasses.replace(small.scene(directional=directional), mesh=shapes.merge(meshes))


def plane(x=0.0, y=0.0, z=0.0, size=1.0, **turned):
    return parts.at(shapes.plane(size, size), x, y, z, FLOOR, **turned)


GROUND, HOVERING, HIGH, LOW = plane(size=4.0), plane(0.5, 1.0), plane(2.0, 20.0, 6.0), plane(0.5, -20.0)
FORWARD = (-0.1, -1.0, -0.3)  # carries the shadow of what is HIGH, behind the camera's back, to the middle of the floor
NOWHERE, POINT = (dataclasses.replace(HOVERING, vertices=jnp.full((4, 3), v)) for v in (np.nan, 50.0))
SHADOWS = {
    "a lone plane": (False, [GROUND], SLANTED),
    "a lone plane that faces away from the light": (False, [GROUND], (0.4, 1.0, 0.3)),
    "two halves of a plane": (False, [plane(-1.0, size=2.0), plane(1.0, size=2.0)], SLANTED),
    "a folded plane, light from behind": (True, [GROUND, plane(0.0, 1.0, -2.0, size=2.0, pitch=90.0)], (0, -1, 1)),
    "a lone box": (True, [parts.at(shapes.box(), 0.0, 0.5, 0.0, FLOOR)], SLANTED),
    "a caster above": (True, [GROUND, HOVERING], SLANTED),
    "a caster that faces away": (True, [GROUND, plane(0.5, 1.0, roll=180.0)], SLANTED),
    "a caster below": (False, [GROUND, LOW], (0, -1, 0)),
    "a caster below, light from below": (True, [GROUND, LOW], (0, 1, 0)),
    "a caster out of view, its shadow in view": (True, [GROUND, HIGH], FORWARD),
    "a caster out of view, its shadow too": (False, [GROUND, HIGH], (0.3, -1.0, -0.3)),
    "a caster out of view, beyond the receiver": (False, [GROUND, plane(-2.0, -20.0, -6.0)], FORWARD),
    "nothing at all": (False, [], SLANTED),
    "a broken caster": (False, [GROUND, NOWHERE], SLANTED),
    "a broken caster before the shadow of another": (True, [NOWHERE, HIGH, GROUND], FORWARD),
    "a caster without area": (False, [GROUND, POINT], SLANTED),
}


@pytest.mark.parametrize("case", SHADOWS)
def test_a_shadow_is_planned_where_something_can_stand_in_the_light(case):
    on, meshes, direction = SHADOWS[case]
    reason = needs(meshed(*meshes, directional=[(direction, 1.0)]))["shadow_map"]
    assert reason.on is on, reason.why


# The same for lamps: where they are, and what stands there.
LAMPS = {
    "a lone plane": (False, [GROUND], (1.0, 2.0, 0.0)),
    "a lamp in the plane": (False, [GROUND], (1.0, 0.0, 0.0)),
    "a caster between": (True, [GROUND, HOVERING], (0.5, 2.0, 0.0)),
    "a caster above the lamp": (False, [GROUND, plane(0.5, 3.0)], (0.5, 2.0, 0.0)),
    "a caster below the receiver": (False, [GROUND, LOW], (0.5, 2.0, 0.0)),
    "a lamp below the floor, and a receiver above": (True, [GROUND, HOVERING], (0.5, -2.0, 0.0)),
    "a caster out of view, its shadow in view": (True, [GROUND, plane(0.0, 10.0, 5.0)], (0.0, 20.0, 10.0)),
    "a caster out of view, its shadow too": (False, [GROUND, plane(0.0, 1.0, 30.0)], (0.0, 20.0, 10.0)),
    "a box around the lamp": (True, [GROUND, parts.at(shapes.box(), 0.0, 1.5, 0.0, FLOOR)], (0.0, 1.5, 0.0)),
    "nothing at all": (False, [], (0.5, 2.0, 0.0)),
}


@pytest.mark.parametrize("case", LAMPS)
@pytest.mark.parametrize("kind", ["point", "spot"])
def test_a_lamp_s_shadow_is_planned_where_something_can_stand_in_its_light(case, kind):
    on, meshes, place = LAMPS[case]
    light = (place, 1.0) if kind == "point" else (place, DOWN, 1.0)
    scene = dataclasses.replace(small.scene(**{kind: [light]}), mesh=shapes.merge(meshes))
    plan, reasons = plan_for(scene, CAMERA, **SIZE)
    assert reasons["shadow_map"].on is on, reasons["shadow_map"].why
    if on:
        rows = {name: getattr(plan.shadow_map, name) for name in LIGHT_KINDS}
        assert rows == {**dict.fromkeys(LIGHT_KINDS, ()), kind: (0,)}


def test_maps_are_as_fine_as_pixels_are():
    """Twice the pixels ask for twice the texels, a point light's six sides for half of a map each; from afar, for few;
    and where one map of the scene would have to be too fine, cascades share what is in view.
    """
    sun = meshed(GROUND, HOVERING)
    lamp = dataclasses.replace(small.scene(point=[((0.5, 2.0, 0.0), 1.0)]), mesh=sun.mesh)
    far, vast = small.camera(eye=(10.0, 20.0, 40.0)), plane(size=4000.0)

    def planned(scene, size, camera=CAMERA):
        return plan_for(scene, camera, width=size, height=size)[0].shadow_map

    assert [planned(sun, size).resolution for size in (24, 240, 480, 1600)] == [256, 512, 1024, 2048]
    assert planned(sun, 480, far).resolution == 256
    assert [planned(lamp, size).resolution for size in (24, 240, 960)] == [256, 1024, 2048]
    assert planned(sun, 480).cascades == 0
    wide = planned(meshed(GROUND, HOVERING, vast), 480)
    assert (wide.cascades, wide.resolution) == (4, 1024)


def test_too_many_faces_to_prove_are_presumed_to_shadow(monkeypatch):
    halves = meshed(*(plane(x, size=1.0) for x in (-1.5, -0.5, 0.5, 1.5)))
    assert not needs(halves)["shadow_map"].on
    monkeypatch.setattr(shadow, "MAX_PAIRS", 8)
    plan, reasons = plan_for(halves, CAMERA, **SIZE)
    assert plan.shadow_map is not None and "too many faces to prove" in reasons["shadow_map"].why


def test_every_light_that_shines_on_something_shadowed_has_a_map():
    for strengths, chosen in (((1.0, 2.0), (0, 1)), ((2.0, 0.0), (0,)), ((0.0, 1.0), (1,))):
        scene = small.scene(directional=[(SLANTED, strength) for strength in strengths])
        plan, reasons = plan_for(scene, CAMERA, **SIZE)
        assert plan.shadow_map.directional == chosen
        assert ", ".join(f"directional light {row}" for row in chosen) in reasons["shadow_map"].why
    # Light from above, and from below through a plane out of view.
    scene = meshed(GROUND, LOW, directional=[(DOWN, 1.0), ((0, 1, 0), 1.0)])
    assert plan_for(scene, CAMERA, **SIZE)[0].shadow_map.directional == (1,)


def test_a_shadow_s_filter_reaches_no_farther_than_planned():
    """A caster beside a receiver, as the light sees it, at distances about the filter's reach.

    Along this light the map's axes lie across the scene's box, and its texels are as large as they get: 1.7 / 1020 of
    the box's side. Whatever the filter darkens must have been planned.
    """
    towards = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    a, b = np.array([0.5, -0.5, -np.sqrt(0.5)]), np.array([-0.5, 0.5, -np.sqrt(0.5)])
    texel = 2 * (1 + np.sqrt(0.5)) / 1020
    square = np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) @ np.array([a, b]) * 0.1
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    scene = small.scene(directional=[(-towards, 1.0)])
    # Keep floor and card; let every other face be a point in a corner of the cube, which nothing can see.
    material = np.asarray(scene.mesh.material)
    faces = np.where(np.isin(material, (FLOOR, CARD))[:, None], scene.mesh.faces, np.asarray(scene.mesh.faces)[:, 2:])
    floor, card = (np.unique(faces[material == m]) for m in (FLOOR, CARD))
    vertices, points = np.zeros((len(scene.mesh.vertices), 3)), np.setdiff1d(faces, [*floor, *card])
    assert len(points) >= len(cube)
    vertices[points] = np.resize(cube, (len(points), 3))
    # The origin lies on a corner of texels: the caster just covers the centre at 1.5.
    vertices[card] = square + 1.49 * texel * (a + b) + 0.1 * towards
    darkened, planned = {}, {}
    for distance in (1.0, 1.7, 1.8, 2.5, 6.0):
        corner = (1.49 - distance) * texel * (a + b)
        vertices[floor] = corner - square
        camera = parts.camera(list(corner + 3 * towards), list(corner), np.degrees(texel))
        changes = {"vertices": jnp.asarray(vertices, jnp.float32), "faces": jnp.asarray(faces)}
        moved = dataclasses.replace(scene, mesh=dataclasses.replace(scene.mesh, **changes))
        plan, reasons = plan_for(moved, camera, cull=False, **SIZE)
        bare = dataclasses.replace(plan, shadow_map=None)
        lit = np.asarray(small.render(moved, camera, bare).hdr)
        shaded = np.asarray(small.render(moved, camera, dataclasses.replace(bare, shadow_map=ShadowMap())).hdr)
        assert (lit > 0).any()
        darkened[distance] = bool((shaded < (1 - 1e-6) * lit).any())
        planned[distance] = reasons["shadow_map"].on
    assert all(planned[distance] for distance in darkened if darkened[distance]), (darkened, planned)
    assert darkened[1.8] and not darkened[2.5] and not planned[6.0]


# What may hide the sky of what is in view.
BALL = parts.at(shapes.icosphere(0.5, 2), 0.0, 0.5, 0.0, FLOOR)
DARKENED = {
    "a lone plane": (False, [GROUND]),
    "a lone plane from below": (False, [plane(0.0, 4.0, size=4.0)]),
    "two halves of a plane": (False, [plane(-1.0, size=2.0), plane(1.0, size=2.0)]),
    "a lone box": (False, [parts.at(shapes.box(), 0.0, 0.5, 0.0, FLOOR)]),
    "a lone ball": (False, [BALL]),
    "a ball on a plane": (True, [BALL, GROUND]),
    "a folded plane": (True, [GROUND, plane(0.0, 1.0, -2.0, size=2.0, pitch=90.0)]),
    "a plane above": (True, [GROUND, plane(0.0, 0.24, size=2.0)]),
    "a plane too far above": (False, [GROUND, plane(0.0, 0.26, size=2.0)]),
    "a plane below, out of view": (False, [GROUND, plane(0.0, -20.0, 40.0)]),
    "nothing at all": (False, []),
    "a broken plane": (False, [GROUND, NOWHERE]),
}


@pytest.mark.parametrize("case", DARKENED)
def test_occlusion_is_planned_where_something_can_hide_the_sky(case):
    on, meshes = DARKENED[case]
    scene = dataclasses.replace(small.scene(sky=1.0), mesh=shapes.merge(meshes))
    plan, reasons = plan_for(scene, CAMERA, **SIZE)
    assert (reasons["occlusion"].on, plan.occlusion is not None) == (on, on), reasons["occlusion"].why
    dark = dataclasses.replace(scene, environment=small.scene().environment)
    assert not needs(dark)["occlusion"].on
    assert not plan_for(scene, CAMERA, **SIZE, ambient=None)[1]["occlusion"].on
    assert not plan_for(scene, CAMERA, **SIZE, shading="local")[1]["occlusion"].on
    assert needs(scene, wrt=("mesh.vertices",))["occlusion"].on
    # What moves a light moves nothing before the sky.
    assert needs(scene, wrt=("directional.direction",))["occlusion"].on == on


def test_too_many_faces_to_prove_are_presumed_to_hide_the_sky(monkeypatch):
    monkeypatch.setattr("jaxraster.planner.needs.may_darken", functools.partial(occluders.may_darken, pairs=8))
    scene = dataclasses.replace(small.scene(sky=1.0), mesh=BALL)
    assert "too many faces to prove" in needs(scene)["occlusion"].why


def surrounded(rows=({},) * 5, texels=1.0, suns=None, rotation=0.0) -> Scene:
    """The scene in surroundings of one colour, and perhaps suns."""
    made = small.scene(rows)
    texels = jnp.full((4, 8, 3), texels)
    return dataclasses.replace(
        made, environment=dataclasses.replace(made.environment, map=prepare(texels, suns, rotation))
    )


def test_a_map_lights_what_it_surrounds():
    reasons = needs(surrounded())
    assert reasons["ambient"].on and reasons["background"].on
    reasons = needs(surrounded(texels=0.0))
    assert not reasons["ambient"].on and not reasons["background"].on
    assert needs(surrounded(texels=0.0), wrt=("environment.map.texels",))["background"].on


def test_a_map_is_mirrored_by_what_is_smooth_alone():
    rough = [{"roughness": 1.0}] * 5
    for rows_of, on in {
        "rough": (rough, False),
        "hardly smoother": ([{"roughness": 0.979}, *rough[1:]], True),
        "textured": ([{"roughness": 1.0, "metallic_roughness_texture": 0}, *rough[1:]], True),
        "coated": ([{"roughness": 1.0, "clearcoat": (1e-6, 1.0)}, *rough[1:]], True),
        "unused": ([*rough[:4], {"roughness": 0.0}], False),
    }.values():
        plan, reasons = plan_for(surrounded(rows_of), CAMERA, **SIZE)
        assert (plan.ambient.specular, reasons["ambient specular"].on) == (on, on)
    # What is smooth must be in view, unless it may come into it.
    hidden = small.scene([*rough[:BOX], {"roughness": 0.1}, *rough[BOX + 1 :]], {BOX: AWAY})
    hidden = dataclasses.replace(hidden, environment=surrounded().environment)
    assert not needs(hidden)["ambient specular"].on
    assert needs(hidden, wrt=("mesh.vertices",))["ambient specular"].on
    assert needs(surrounded(rough), wrt=("materials.roughness",))["ambient specular"].on
    assert "no map" in needs(small.scene(sky=1.0))["ambient specular"].why
    assert "no ambient light" in needs(small.scene())["ambient specular"].why


def test_a_sun_of_the_surroundings_is_a_light_with_a_shadow():
    sun = Directional(direction=jnp.array([SLANTED]), irradiance=jnp.full((1, 3), 2.0))
    plan, reasons = plan_for(surrounded(suns=sun), CAMERA, **SIZE)
    alone = needs(surrounded(texels=0.0, suns=sun))
    assert alone["background"].on and not alone["ambient"].on
    assert reasons["light directional"].on and plan.shadow_map.directional == (2,)  # after the scene's own two
    faint = dataclasses.replace(sun, irradiance=jnp.zeros((1, 3)))
    assert not needs(surrounded(suns=faint))["light directional"].on
    assert needs(surrounded(suns=faint), wrt=("environment.map.suns.irradiance",))["light directional"].on


SMOOTH = white("metallic_roughness", 0.0)
WRT = {
    "zero emission": ("materials.emissive", {}, ["emission"]),
    "zero emission under a texture": ("emissive", {"rows": white("emissive", 0.0)}, ["emission", "texture emissive"]),
    "black base under a texture": ("base_color", {"rows": white("base_color", 0.0)}, ["texture base_color"]),
    "no roughness under a texture": (
        "roughness",
        {"rows": white("metallic_roughness", 0.0)},
        ["texture metallic_roughness"],
    ),
    "no metal under a texture": (
        "metallic",
        {"rows": white("metallic_roughness", 0.0)},
        ["texture metallic_roughness"],
    ),
    "no occlusion": ("occlusion_strength", {"rows": white("occlusion", 0.0), "sky": 1.0}, ["texture occlusion"]),
    "opaque alphas of what is blended or masked": (
        "base_color",
        {"rows": [{"alpha_mode": BLEND}, {"alpha_mode": MASK}, {}, {}, {}]},
        ["layers"],
    ),
    "opaque texels of what is blended": (
        "texels",
        {"rows": rows(alpha_mode=BLEND, base_color_texture=NORMAL_TEXTURE)},
        ["layers"],
    ),
    "a black sun": ("lights.directional", {}, ["light directional", "shadow_map"]),
    "black lamps": ("intensity", {}, ["light point", "light spot"]),
    "one black lamp": ("spot.intensity", {}, ["light spot"]),
    "a black sky": ("sky", {}, ["ambient", "background"]),
    "black ground and its occlusion": ("environment", {"rows": white("occlusion")}, ["ambient", "texture occlusion"]),
    "everything": ("scene", {}, ["emission", "ambient", "light directional", "light point", "light spot"]),
}


@pytest.mark.parametrize("case", WRT)
def test_what_is_differentiated_is_kept_though_it_is_zero(case):
    path, options, kept = WRT[case]
    scene = small.scene(**options)
    without, by_path, by_full_path = (needs(scene, wrt=wrt) for wrt in ((), (path,), f"scene.{path}"[-len(path) :]))
    assert not any(without[name].on for name in kept)
    assert all(by_path[name].on for name in kept)
    assert by_path == by_full_path


def test_lights_with_an_area_are_drawn_where_they_shine():
    def glowing(*radiances):
        spheres = stack_lights(sphere=[((0.0, 2.0, 0.0), 0.1, (radiance,) * 3) for radiance in radiances]).sphere
        scene = small.scene()
        return dataclasses.replace(scene, lights=dataclasses.replace(scene.lights, sphere=spheres))

    scene, dark = glowing(0.0, 1.0), glowing(0.0)
    plan, reasons = plan_for(scene, CAMERA, **SIZE)
    assert plan.area.kinds == ("sphere",) and reasons["area"] == Reason(True, "lights with an area: sphere")
    assert plan_for(dark, CAMERA, **SIZE)[0].area is None
    assert plan_for(dark, CAMERA, **SIZE, wrt="lights.sphere.radiance")[0].area.kinds == ("sphere",)
    assert plan_for(scene, CAMERA, **SIZE, shading="local")[0].area is None


@pytest.mark.parametrize("path", ["scene.materials.emissive", "scene.materials", "scene", "materials", "emissive"])
def test_paths_may_begin_with_the_scene(path):
    assert needs(small.scene(), wrt=(path,))["emission"].on


@pytest.mark.parametrize("path", ["vertices", "texels", "camera", "direction", "position", "normal_scale", "up"])
def test_other_paths_keep_nothing_more(path):
    """A direction of black light or a texel under a black factor has no gradient."""
    scene = small.scene(white("emissive", 0.0))
    assert needs(scene, wrt=(path,)) == needs(scene)


@pytest.mark.parametrize(
    ("wrt", "near"), [(("vertices", "emisive"), "emissive"), ("lights.sun", "lights."), ("faces", "")]
)
def test_an_unknown_path_names_the_nearest(wrt, near):
    with pytest.raises(ValueError, match=rf"no float leaf is named .*; did you mean .*{near}"):
        needs(small.scene(), wrt=wrt)


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap, lambda f: jax.grad(lambda v: f(v) * 0.0)])
def test_traced_input_raises_one_line(transform):
    scene = small.scene()

    def plan(vertices):
        moved = dataclasses.replace(scene, mesh=dataclasses.replace(scene.mesh, vertices=vertices))
        return plan_for(moved, CAMERA, **SIZE)[0].exposure

    vertices = jnp.stack([scene.mesh.vertices] * 2) if transform is jax.vmap else scene.mesh.vertices
    with pytest.raises(TypeError, match=r"^plan_for looks at concrete values: call it outside of jit") as e:
        transform(plan)(vertices)
    assert "\n" not in str(e.value)


def test_layers_are_as_many_as_may_lie_in_front_of_each_other():
    """Four at most, and of one plane's two triangles two; a mask without holes is not looked up."""
    blend, mask = {"alpha_mode": BLEND, "base_color": (1.0, 1.0, 1.0, 0.5)}, {"alpha_mode": MASK}
    for materials, blended, masked in (
        ([blend, {}, {}, {}, {}], 2, False),
        ([blend, mask, {}, blend, {}], 4, False),
        ([mask, {**mask, "base_color": (1.0, 1.0, 1.0, 0.2)}, {}, {}, {}], 0, True),
    ):
        planned = plan_for(small.scene(materials), CAMERA, **SIZE)[0].layers
        assert (planned.blended, planned.masked) == (blended, masked)


def test_what_is_asked_for_is_taken_as_it_is():
    scene = small.scene(white("base_color"), directional=[(SLANTED, 1.0)])
    asked = {
        "cull": False,
        "shadow_map": None,
        "ambient": Ambient(gain=2.0),
        "dither": Dither(),
        "texture_slots": ("normal",),
        "light_kinds": (),
        "exposure": 1.5,
        "supersample": 2,
    }
    plan, reasons = plan_for(scene, CAMERA, **SIZE, **asked)
    assert {name: getattr(plan, name) for name in asked} == asked
    assert plan.emission is None and not reasons["emission"].on
    of_request = {name: reason.on for name, reason in reasons.items() if reason.why == "as asked for"}
    textures = {f"texture {slot}": slot == "normal" for slot in TEXTURE_SLOTS}
    kinds = {f"light {kind}": False for kind in LIGHT_KINDS}
    effects = {"cull": False, "shadow_map": False, "ambient": True, "ambient specular": True, "dither": True}
    assert of_request == {**effects, **textures, **kinds}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 0}, r"Plan\.width must be a whole number of at least 1, got 0"),
        ({"height": -3}, r"Plan\.height must be"),
        ({"shading": "toon"}, r"Plan\.shading must be one of standard, gltf, local, got 'toon'"),
        ({"shading": "local", "shadow_map": ShadowMap()}, r"Plan\.shadow_map must be None"),
    ],
)
def test_a_plan_that_means_nothing_is_refused_first(options, message):
    with pytest.raises(ValueError, match=message):
        plan_for(small.scene(directional=[(SLANTED, 1.0)]), CAMERA, **{**SIZE, **options})


def test_local_shading_plans_no_shadow():
    scene = small.scene(directional=[(SLANTED, 1.0)])
    plan, reasons = plan_for(scene, CAMERA, **SIZE, shading="local")
    assert plan.shadow_map is None and "no visibility of lights" in reasons["shadow_map"].why
    assert plan_for(scene, CAMERA, **SIZE)[0].shadow_map is not None


def test_a_batch_gets_the_union():
    """Leading axes of cameras, lights, materials and vertices: what any member needs is planned."""
    caster = meshed(GROUND, plane(1.5, 1.0, 1.5), directional=[(DOWN, 1.0)])
    sees, sees_not = small.camera(), small.camera(eye=(-1.5, 3.0, -1.5), target=(-1.5, 0.0, -1.4), fov_y=20.0)

    def stack(*records):
        """One record of several that share their integers."""
        return jax.tree.map(lambda a, *b: jnp.stack([a, *b]) if a.dtype == jnp.float32 else a, *records)

    verdicts = [plan_for(caster, c, **SIZE)[1]["shadow_map"].on for c in (sees, sees_not, stack(sees_not, sees))]
    assert verdicts == [True, False, True]

    dark, sun = small.scene(), small.scene(directional=[(DOWN, 1.0), (DOWN, 3.0)])
    batch = dataclasses.replace(dark, lights=stack(dark.lights, sun.lights))
    plan, reasons = plan_for(batch, CAMERA, **SIZE)
    assert plan.light_kinds == ("directional",) and plan.shadow_map.directional == (0, 1)
    assert reasons["light directional"].why == "2 in the scene"

    glowing = small.scene(white("emissive"))
    black = dataclasses.replace(glowing.materials, emissive=dark.materials.emissive)
    batch = dataclasses.replace(glowing, materials=stack(black, glowing.materials))
    plan, reasons = plan_for(batch, CAMERA, **SIZE)
    assert plan.emission is not None and plan.texture_slots == ("emissive",)
    assert reasons["texture emissive"].why == "fetched by 1 material"

    far = dataclasses.replace(caster, mesh=meshed(GROUND, plane(9.0, 1.0)).mesh)
    for members, on in (((far, far), False), ((far, caster), True)):
        batch = dataclasses.replace(far, mesh=stack(*(member.mesh for member in members)))
        assert plan_for(batch, CAMERA, **SIZE)[1]["shadow_map"].on is on


def test_the_reasons_in_words():
    scene = small.scene(white("emissive", 0.0), directional=[(SLANTED, 1.0)], sky=1.0)
    lines = explain(needs(scene, emission=None)).splitlines()
    assert len({line.index(name) for line, name in zip(lines, ("cull", "layers"))}) == 1
    assert lines == [
        "on   cull                        some material in use is single-sided",
        "off  layers                      no material in use is masked or blended",
        "off  texture base_color          no material in use has such a texture",
        "off  texture metallic_roughness  no material in use has such a texture",
        "off  texture normal              no material in use has such a texture",
        "off  texture occlusion           no material in use has such a texture",
        "off  texture emissive            every such texture is multiplied by emissive of zero",
        "on   light directional           2 in the scene",
        "off  light point                 2 in the scene, all black",
        "off  light spot                  2 in the scene, all black",
        "on   shadow_map                  something stands between a surface in view and directional light 0; "
        "256 texels, as most pixels ask for",
        "off  area                        no light with an area shines",
        "off  emission                    as asked for",
        "on   occlusion                   what rises within 0.25 m of a surface in view hides some of its sky",
        "on   ambient                     the environment has light",
        "off  ambient specular            the environment has no map to mirror",
        "on   background                  the environment has light",
        "off  dither                      only on request",
    ]
    assert explain({}) == ""


@pytest.mark.parametrize("name", SCENES)
def test_every_effect_of_a_built_in_scene_has_a_reason(name):
    scene, camera = SCENES[name]()
    plan, reasons = plan_for(scene, camera, width=64, height=48)
    assert all(isinstance(reason, Reason) and reason.why and "\n" not in reason.why for reason in reasons.values())
    for field in ("layers", "shadow_map", "area", "occlusion", "emission", "ambient", "background", "dither"):
        assert (getattr(plan, field) is not None) == reasons[field].on
    assert plan.cull == reasons["cull"].on
    assert plan.texture_slots == tuple(slot for slot in TEXTURE_SLOTS if reasons[f"texture {slot}"].on)
    assert plan.light_kinds == tuple(kind for kind in LIGHT_KINDS if reasons[f"light {kind}"].on)
    assert (plan.width, plan.height) == (64, 48)


def full(scene: Scene) -> Plan:
    """Everything on, and a map of every light."""
    layers = None if scene.materials.alpha_mode is None else Layers()
    return Plan(**SIZE, shadow_map=ShadowMap(resolution=256), layers=layers, occlusion=HorizonAO())


EVERY = {f"{slot}_texture": NORMAL_TEXTURE if slot == "normal" else COLOUR_TEXTURE for slot in TEXTURE_SLOTS}
BLACK = {"base_color": (0.0, 0.0, 0.0), "emissive": (0.0, 0.0, 0.0), "occlusion_strength": 0.0}
TURNED = ((0.6, 0.8, 0.3), (-0.8, 0.6, -0.2))
GLOWS = {"emissive": (0.3, 0.2, 0.1)}
# Few ways to combine textures, for each costs a compilation: rows for the floor and the others.
MATERIALS = {
    "bare": [{}, GLOWS, {}, {}, {}],
    "textured": [{**EVERY, **GLOWS}, {}, EVERY, EVERY, EVERY],
    "black under textures": [{**EVERY, **BLACK}] * 5,
    "textures unused": [{}, {}, {}, {}, {**EVERY, **GLOWS}],
    "of every rare kind": [
        {**EVERY, "uv_sets": (0, 1, 0, 1, 1), "ior": 1.8},
        {**EVERY, "uv_transforms": (TURNED,) * 5, "specular": (1.0, 0.5, 0.2, 0.6)},
        {"unlit": True, "base_color_texture": COLOUR_TEXTURE},
        {"specular": (0.0, 0.0, 0.0, 0.0)},
        {"unlit": True},
    ],
    "seen through": [
        {**EVERY, "alpha_mode": BLEND},
        {},
        {"alpha_mode": MASK, "base_color_texture": COLOUR_TEXTURE, "double_sided": True},
        {"alpha_mode": BLEND, "base_color": (0.5, 0.6, 0.7, 0.4), "double_sided": True},
        {},
    ],
}
unit = st.floats(-1.0, 1.0, width=32)
scenes = st.fixed_dictionaries(
    {
        "materials": st.sampled_from(sorted(MATERIALS)),
        "knobs": st.fixed_dictionaries(
            {"metallic": st.sampled_from([0.0, 0.4, 1.0]), "double_sided": st.booleans()},
        ),
        "sun": st.sampled_from([0.0, 0.0, 2.0, 3.0, 4.0]),
        "second": st.sampled_from([0.0, 3.5]),
        "aim": st.tuples(unit, st.sampled_from([-1.0, -1.0, -1.0, 1.0]), unit),
        "lamps": st.sampled_from([0.0, 5.0]),
        "sky": st.sampled_from([0.0, 0.4]),
        "ground": st.sampled_from([0.0, 0.2]),
        "box": st.sampled_from([(-0.6, 0.7, 0.0), (-4.0, 0.5, 0.0), (0.3, -1.0, 0.0), (0.0, 9.0, 3.0), AWAY]),
        "card": st.sampled_from([(1.5, 0.6, 0.5), (3.0, 0.5, 3.0), (0.0, -2.0, 0.0), AWAY]),
        "wall": st.sampled_from([(0.0, 2.0, -2.0), (0.0, -2.5, -1.0), AWAY]),
        "shift": st.tuples(unit, unit, unit),
        "fov_y": st.sampled_from([12.0, 45.0]),
    }
)


def build(values: dict):
    def near(place):
        return tuple(np.add(place, np.multiply(0.2, values["shift"])))

    tilt = (values["aim"][0] * 0.8, values["aim"][1], values["aim"][2] * 0.8)
    scene = small.scene(
        [{**row, **values["knobs"]} for row in MATERIALS[values["materials"]]],
        {WALL: near(values["wall"]), CARD: near(values["card"]), BOX: near(values["box"])},
        directional=[(tilt, values["sun"]), ((0.3, -1.0, 0.1), values["second"])],
        point=[((0.5, 2.0, 1.5), values["lamps"])],
        spot=[((-1.0, 2.5, 1.0), (0.3, -1.0, -0.4), values["lamps"])],
        sky=values["sky"],
        ground=values["ground"],
    )
    if values["materials"] == "of every rare kind":
        count = scene.mesh.vertices.shape[0]
        colors = np.random.default_rng(8).uniform(0.2, 1.0, (count, 4)).astype(np.float32)
        mesh = dataclasses.replace(scene.mesh, colors=jnp.asarray(colors), second_uvs=2.0 * scene.mesh.uvs)
        scene = dataclasses.replace(scene, mesh=mesh)
    return scene, small.camera(eye=near((1.0, 2.0, 4.0)), target=(0.2, 0.3, 0.0), fov_y=values["fov_y"])


def assert_same_picture(scene, camera, plan):
    # Maps of one size compile once; those that the planner would make finer reach less far.
    if plan.shadow_map is not None:
        plan = dataclasses.replace(plan, shadow_map=dataclasses.replace(plan.shadow_map, resolution=256, cascades=0))
    seen, expected = small.render(scene, camera, plan), small.render(scene, camera, full(scene))
    np.testing.assert_array_equal(seen.visibility.face, expected.visibility.face)
    np.testing.assert_allclose(seen.hdr, expected.hdr, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(seen.image, expected.image, rtol=0, atol=1e-6)


def test_the_picture_is_that_with_everything_on():
    """Over random scenes; and in these, every effect is planned in some and left out in others."""
    met = set()

    @hypothesis.settings(max_examples=30, derandomize=True, deadline=None, database=None)
    @hypothesis.given(scenes)
    def check(values):
        scene, camera = build(values)
        plan, reasons = plan_for(scene, camera, **SIZE)
        met.update((name, reason.on) for name, reason in reasons.items())
        assert_same_picture(scene, camera, plan)

    check()
    missing = {(name, on) for name in needs(small.scene()) for on in (True, False)} - met
    # Lights with an area and maps have tests of their own.
    assert missing == {(name, True) for name in ("dither", "area", "ambient specular")}


def test_the_gradient_is_that_with_everything_on():
    """In leaves whose value is zero, for which the plan without `wrt` would have none."""
    wrt = ("base_color", "materials.emissive", "occlusion_strength", "intensity", "ground")
    scene = small.scene([{**EVERY, **BLACK}] * 5, directional=[(SLANTED, 2.0)], sky=0.4)
    values, rebuild = parameters(scene, wrt)
    assert all((np.asarray(value)[..., :3] == 0).all() for value in values.values())
    without, plan = (plan_for(scene, CAMERA, **SIZE, wrt=paths)[0] for paths in ((), wrt))
    assert without.emission is None and without.light_kinds == ("directional",) and len(without.texture_slots) == 2
    weights = jnp.asarray(np.random.default_rng(5).uniform(0.5, 1.5, (HEIGHT, WIDTH, 3)), jnp.float32)

    def gradient(plan):
        return jax.grad(lambda v: (small.render(rebuild(v), CAMERA, plan).hdr * weights).sum())(values)

    planned, expected = gradient(plan), gradient(full(scene))
    for name in values:
        scale = np.abs(expected[name]).max()
        assert scale > 0, name
        np.testing.assert_allclose(planned[name], expected[name], atol=1e-5 * scale, err_msg=name)
