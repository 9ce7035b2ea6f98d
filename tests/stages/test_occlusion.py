"""Ambient occlusion on the screen against exact answers, and where it must not be seen."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from height_fields import FLOOR, SIDE, WALL, camera, cast, pit
from pointwise import check_calls, check_finite, check_slopes

import jaxraster as jr
from jaxraster.screen.arc import arc, arccos, mean_direction
from jaxraster.screen.horizon import HorizonAO, horizon
from jaxraster.screen.ssao import SSAO, ssao
from jaxraster.surface.gather import gather
from jaxraster.surface.material import material

SIZE = 256
NEAR = slice(SIZE // 2 - 2, SIZE // 2 + 2)  # two pixels to either side of the middle
HORIZON, CLASSIC = jax.jit(horizon), jax.jit(ssao)
FAR = HorizonAO(radius=jnp.inf, falloff=0.0)
FINE, LONG = replace(FAR, slices=4, steps=48), replace(FAR, slices=1, steps=16)
PROJECTIONS = pytest.mark.parametrize("half_height", [None, 1.0], ids=["perspective", "parallel"])


def visibility(surface, seen_by, settings=FAR) -> np.ndarray:
    """Of either method, held against what is true of any."""
    found = (CLASSIC if isinstance(settings, SSAO) else HORIZON)(surface, seen_by, settings)
    shown = np.asarray(found.visibility)
    assert np.isfinite(shown).all() and shown.min() >= 0 and shown.max() <= 1
    np.testing.assert_allclose(np.linalg.norm(found.bent_normal, axis=-1), 1, atol=1e-5)
    return shown


# -- Exact answers -----------------------------------------------------------------------------------------------------


@PROJECTIONS
def test_the_foot_of_a_wall_sees_one_half(half_height):
    """Within two pixels of it, less what the end of the picture cuts off; the bent normal leans halfway away."""
    above = camera((0, 2.5, 2.5), half_height=half_height)
    surface = cast([FLOOR, WALL], above, SIZE)
    shown = visibility(surface, above)
    np.testing.assert_allclose(shown[NEAR, SIZE // 4 : -SIZE // 4], 0.5, atol=0.03)
    # A single slice knows only its own share of the hemisphere, and is as right with its neighbours.
    shown = visibility(surface, above, LONG)
    np.testing.assert_allclose(shown[NEAR, SIZE // 4 : -SIZE // 4], 0.5, atol=0.03)
    # ∫ ω (n·ω) over the quarter of a sphere between both planes is along 2/3 n + 2/(3π) … of the other plane's.
    bent = np.asarray(HORIZON(surface, above, FAR).bent_normal)[NEAR, SIZE // 2]
    wall, floor = bent[1], bent[2]
    assert abs(floor[0]) < 0.05 and floor[1] > floor[2] > 0.4 and wall[2] > wall[1] > 0.4


def test_a_corner_sees_a_quarter():
    """Within two pixels of it; the planes end with the picture, which leaves some light."""
    above = camera((2.5, 2.5, 2.5))
    shown = visibility(cast([FLOOR, WALL, SIDE], above, SIZE), above)
    np.testing.assert_allclose(shown[NEAR, NEAR], 0.25, atol=0.03)


@pytest.mark.parametrize(
    ("settings", "off"), [(FINE, 0.03), (LONG, 0.09), (FAR, 0.16)], ids=["fine", "one slice", "default"]
)
@pytest.mark.parametrize(("radius", "depth"), [(1, 1), (1, 2), (2, 1)])
def test_the_middle_of_a_pit_sees_its_mouth(radius, depth, settings, off):
    """R² / (R² + D²), by steps fine enough to meet the rim where it is; fewer go beyond it, to where it seems lower."""
    surface, above = pit(radius, depth, SIZE, 2.5 * radius)
    found = visibility(surface, above, settings)[NEAR, NEAR] - radius**2 / (radius**2 + depth**2)
    np.testing.assert_allclose(found, 0, atol=off)


def test_the_whole_pipeline_sees_one_half_at_the_foot_of_a_wall():
    mesh = jr.scenes.parts.at(jr.geometry.shapes.plane(20.0, 20.0), 0.0, 0.0, 0.0, 0)
    wall = jr.scenes.parts.at(jr.geometry.shapes.plane(20.0, 20.0), 0.0, 0.0, 0.0, 0, pitch=90.0)
    scene = replace(small.scene(), mesh=jr.geometry.shapes.merge([mesh, wall]))
    above = camera((0, 2.5, 2.5))

    @jax.jit
    def seen(scene, above):
        clip = jr.project(scene.mesh.vertices, above, height=SIZE, width=SIZE)
        fragment = gather(scene, jr.rasterize(clip, scene.mesh.faces, height=SIZE, width=SIZE), clip, above)
        return material(fragment, scene.materials, scene.textures, ())

    shown = visibility(seen(scene, above), above)
    np.testing.assert_allclose(shown[NEAR, SIZE // 4 : -SIZE // 4], 0.5, atol=0.03)


@pytest.mark.parametrize(
    ("settings", "most"),
    [(FAR, (0.08, 0.08, 0.09, 0.15)), (LONG, (0.05, 0.04, 0.05, 0.08))],
    ids=["default", "one slice"],
)
def test_what_is_within_the_radius_is_found_from_near_to_far(settings, most):
    """1 - (acos t - t √(1 - t²)) / π at t radii from a wall, also if a near pixel elsewhere makes all lines long."""
    above = camera((1.0, 1.0, 0.0), (1.0, 0.6, -3.0), 60.0)
    corner = cast([FLOOR, SIDE], above, SIZE)
    eye = np.array([1.0, 1.0, 0.0])
    near = corner.position.at[-1, -1].set(eye + 0.01 * (np.asarray(corner.position)[-1, -1] - eye))
    x, y, z = np.moveaxis(np.asarray(corner.position), -1, 0)
    for (radius, least, end), off in zip(((0.25, 1.5, 3), (0.25, 3, 6), (1.0, 6, 12), (1.0, 12, 25)), most):
        t = np.minimum(np.maximum(x, y) / radius, 1)
        exact = 1 - (np.arccos(t) - t * np.sqrt(1 - t * t)) / np.pi
        band = np.asarray(corner.mask) & (-z >= least) & (-z < end) & (t < 1)
        band[-16:, -16:] = False
        for position in (corner.position, near):
            shown = visibility(replace(corner, position=position), above, replace(settings, radius=radius))
            assert np.abs(shown - exact)[band].mean() < off


def test_lines_end_at_half_of_the_longer_side():
    """Whatever the radius: what a wall at the left hides ends there, and a tile's width later."""
    above = camera((0, 2, 0), half_height=1.0)
    surface = cast([FLOOR], above, SIZE)
    wall = replace(surface, position=surface.position.at[:, :4, 1].set(1.0))
    shown = visibility(wall, above)[SIZE // 4 : -SIZE // 4]
    assert shown[:, SIZE // 2 - 16].max() < 0.999 and (shown[:, SIZE // 2 + 16 :] > 1 - 1e-6).all()


@pytest.mark.parametrize("method", [FAR, SSAO(radius=0.5)], ids=["horizon", "ssao"])
def test_light_falls_towards_an_edge(method):
    above = camera((0, 2.5, 2.5))
    shown = visibility(cast([FLOOR, WALL], above, SIZE), above, replace(method, radius=0.5))[
        SIZE // 2 + 2 :: 24, SIZE // 2
    ]
    assert (np.diff(shown) > -0.02).all() and shown[0] < 0.8 and shown[-1] > 0.99


# -- What does not matter ----------------------------------------------------------------------------------------------


def test_occlusion_ends_at_the_radius_and_fades_before():
    above = camera((0, 2.5, 2.5))
    surface = cast([FLOOR, WALL], above, SIZE)
    near = np.asarray(surface.position)[:, SIZE // 2, 2]
    hard, soft = (visibility(surface, above, replace(FAR, radius=0.5, falloff=f))[:, SIZE // 2] for f in (0.0, 1.0))
    floor = np.arange(SIZE) > SIZE // 2
    assert (hard[floor & (near > 0.55)] > 0.999).all() and (hard[floor & (near < 0.3)] < 0.97).all()
    assert (soft >= hard - 0.01).all() and soft[floor].mean() > hard[floor].mean()


def test_thickness_lets_light_behind_what_stands_in_front():
    """A bar before a floor: light passes between them, the more the thinner it is taken to be."""
    above = camera((0, 4, 0.01))
    surface = cast([FLOOR], above, SIZE)
    bar = np.s_[:, SIZE // 2 - 8 : SIZE // 2 + 8]
    raised = surface.position.at[bar].multiply(jnp.array([0.7, 1.0, 0.7])).at[*bar, 1].set(1.2)
    surface, beside = replace(surface, position=raised), np.s_[60:-60, SIZE // 2 + 12 : SIZE // 2 + 52]
    behind = [visibility(surface, above, replace(FAR, thickness=t))[beside].mean() for t in (0.0, 0.2, 1.0)]
    assert behind[0] < behind[1] - 0.01 < behind[2] - 0.1 and behind[2] > 0.9


def test_no_light_passes_behind_what_is_not_there():
    """The foot of a wall before the sky: a thickness of next to nothing changes next to nothing."""
    seen_by = camera((0, 2, 2))
    surface = cast([FLOOR, WALL], seen_by, SIZE)
    sky = surface.position[..., 1] > 0.5
    surface = replace(surface, mask=surface.mask & ~sky)
    none, little, some = (visibility(surface, seen_by, replace(FAR, thickness=t)) for t in (0.0, 1e-5, 0.5))
    np.testing.assert_allclose(little, none, atol=1e-3)
    assert some.mean() > none.mean() + 0.01


# -- Formulas ----------------------------------------------------------------------------------------------------------

ANGLES = np.concatenate([[0.0, 1e-4], np.linspace(0.05, 3.1, 40), [np.pi - 1e-4, np.pi]])


def test_the_polynomial_arccosine_is_exact_to_rounding():
    cosine = np.concatenate([np.cos(ANGLES), np.linspace(-1, 1, 2000)]).astype(np.float32)
    np.testing.assert_allclose(check_finite(arccos, cosine), np.arccos(np.float64(cosine)), atol=4e-7)
    check_calls(arccos, cosine)
    check_slopes(arccos, np.cos(ANGLES[2:-2]), rtol=1e-4)


def test_arcs_are_the_integrals_that_they_stand_for():
    """By the middles of 20,000 steps, in double precision; and as Jimenez writes them, with γ."""
    gamma, h = (x.ravel() for x in np.meshgrid(np.linspace(-1.5, 1.5, 9), ANGLES[::4]))
    theta = h[:, None] * (np.arange(20000) + 0.5) / 20000
    lit = np.cos(theta - gamma[:, None]) * np.sin(theta) * (h / 20000)[:, None]
    inputs = np.cos(gamma), np.sin(gamma), np.cos(h)
    found = np.asarray(jax.jit(arc)(*map(jnp.float32, inputs)))
    np.testing.assert_allclose(found, lit.sum(axis=1), atol=2e-6)
    jimenez = 0.25 * (-np.cos(2 * h - gamma) + np.cos(gamma) + 2 * h * np.sin(gamma))
    np.testing.assert_allclose(found, jimenez, atol=2e-6)
    v, d = jax.jit(mean_direction)(*map(jnp.float32, inputs))
    np.testing.assert_allclose(v, (lit * np.cos(theta)).sum(axis=1), atol=2e-6)
    np.testing.assert_allclose(d, (lit * np.sin(theta)).sum(axis=1), atol=2e-6)


# -- Calls -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [HorizonAO(radius=0.5), SSAO(radius=0.5)], ids=["horizon", "ssao"])
def test_leading_axes_are_pictures_of_their_own(settings):
    """Layers, one of them empty: as if each were drawn alone."""
    above = camera((0, 2.5, 2.5))
    one = cast([FLOOR, WALL], above, 32)
    other = cast([FLOOR], above, 32)
    empty = replace(one, mask=jnp.zeros_like(one.mask))
    stacked = jax.tree.map(lambda *parts: jnp.stack(parts)[:, None], one, empty, other)
    method = ssao if isinstance(settings, SSAO) else horizon
    found = jax.jit(method)(stacked, above, settings)
    assert found.visibility.shape == (3, 1, 32, 32) and (found.visibility[1] == 1).all()
    for k, alone in ((0, one), (2, other)):
        expected = jax.jit(method)(alone, above, settings)
        np.testing.assert_allclose(found.visibility[k, 0], expected.visibility, atol=1e-5)
        np.testing.assert_allclose(found.bent_normal[k, 0], expected.bent_normal, atol=1e-4)


@pytest.mark.parametrize(
    ("make", "settings", "message"),
    [
        (HorizonAO, {"slices": 0}, r"HorizonAO\.slices must be a whole number from 1 to 64, got 0"),
        (HorizonAO, {"steps": 65}, r"HorizonAO\.steps must be a whole number from 1 to 64, got 65"),
        (SSAO, {"samples": 0}, r"SSAO\.samples must be a whole number from 1 to 1024, got 0"),
    ],
)
def test_counts_that_mean_nothing_are_refused(make, settings, message):
    with pytest.raises(ValueError, match=message):
        make(**settings)
