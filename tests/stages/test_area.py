"""Lights with an area: closed forms of what they give, limits, and that nothing breaks them.

Gradients of the lights take long to compile, so that all cases of a kind are handed to one program, in chunks of one
size, each surface with a light of its own.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_made import surface, towards
from reference import area_light

from jaxraster.brdf.compensation import compensated_albedo
from jaxraster.brdf.standard import standard
from jaxraster.light import punctual
from jaxraster.light.area import Area, area
from jaxraster.light.area_fit import fit
from jaxraster.scene import AREA_KINDS
from jaxraster.stack import stack_lights

UP, WHITE, INF = np.array([0.0, 0.0, 1.0]), (1.0, 1.0, 1.0), np.inf
NONE = stack_lights()
CHUNK = 512
# What runs once need not run fast: without fusion and LLVM's passes gradients compile in a fifth of the time.
QUICK = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


def lone(here, kind, light, brdf=standard, albedo=compensated_albedo):
    """Diffuse and specular radiance `[2, 3]` of one surface under one light."""
    lights = dataclasses.replace(NONE, **{kind: jax.tree.map(lambda x: x[None], light)})
    return jnp.stack(area(here, lights, brdf, albedo, Area()))


def matte(here, l):
    """Lambert alone."""
    n_dot_l = jnp.sum(here.normal * l, axis=-1, keepdims=True)
    return here.diffuse_color * n_dot_l / jnp.pi, jnp.zeros_like(l)


def plain(f0, *_):
    """The albedo of a lobe without Fresnel."""
    return f0


@functools.partial(jax.jit, static_argnums=1)
def shine_of_chunk(seen, kind, light):
    return jax.vmap(lambda here, light: lone(here, kind, light))(seen, light)


@functools.partial(jax.jit, static_argnums=1, compiler_options=QUICK)
def slopes_of_chunk(seen, kind, light):
    """Of all radiance, added up; with the simplest BRDF, others have tests of their own."""

    def total(seen, light):
        return jax.vmap(lambda here, light: lone(here, kind, light, matte, plain))(seen, light).sum()

    return jax.grad(total, (0, 1), allow_int=True)(seen, light)


def in_chunks(program, seen, lights):
    """What `program` makes of n surfaces, each under its own light, all of one kind; one serves all of the other."""
    (kind,) = (kind for kind in AREA_KINDS if getattr(lights, kind) is not None)
    seen, light = jax.tree.map(np.asarray, (seen, getattr(lights, kind)))
    count = max(len(seen.alpha), len(light.radiance))
    parts = []
    for first in range(0, count, CHUNK):
        rows = first + np.arange(CHUNK)
        here, one = jax.tree.map(lambda x, rows=rows: jnp.asarray(x[np.minimum(rows, len(x) - 1)]), (seen, light))
        parts.append(program(here, kind, one))
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count], *parts)


def shine(seen, lights):
    """Diffuse and specular radiance of the standard BRDF, `[n, 2, 3]`."""
    return in_chunks(shine_of_chunk, seen, lights)


def slopes(seen, lights):
    """Of `matte` and `plain`, in surfaces and lights."""
    return in_chunks(slopes_of_chunk, seen, lights)


def factors(seen, lights):
    """Form factors `[n]`: what a white surface that mirrors nothing makes of a light of radiance 1."""
    black = jnp.zeros_like(seen.alpha)
    return shine(dataclasses.replace(seen, f0=jnp.zeros_like(seen.f0), f90=black), lights)[:, 0, 0]


def close(actual, expected, rtol=1e-6, atol=0.0):
    np.testing.assert_allclose(np.asarray(actual, np.float64), expected, rtol=rtol, atol=atol)


def a_sphere(position, radius):
    return (position, radius, WHITE)


def a_disc(position, direction, radius, two_sided=False):
    return (position, direction, radius, WHITE, two_sided)


def a_rectangle(position, right, up, two_sided=False):
    return (position, right, up, WHITE, two_sided)


def here(position=(0.0, 0.0, 0.0), normal=UP, **rest):
    return surface(np.atleast_2d(position), normal, **rest)


# -- Closed forms ------------------------------------------------------------------------------------------------------


def test_a_sphere_at_and_above_the_horizon():
    tilt, radius, expected = np.array(
        [(30, 20, 0.1013057278), (80, 30, 0.0546958164), (90, 30, 0.0288344428), (100, 30, 0.0112837720)]
    ).T
    rows = [a_sphere(3.0 * towards(t), 3.0 * np.sin(r)) for t, r in zip(np.radians(tilt), np.radians(radius))]
    close(factors(here(), stack_lights(sphere=rows)), expected, rtol=5e-6)


def test_a_sphere_far_above_is_its_square_sine_times_the_cosine():
    rng = np.random.default_rng(0)
    theta, distance = rng.uniform(0, 1.0, 40), 10 ** rng.uniform(-3, 6, 40)
    places = np.float32(-distance[:, None] * towards(theta, rng.uniform(0, 7, 40)))
    size = np.linalg.norm(np.float64(places), axis=1)
    for sine in (0.5, 1e-3):
        rows = [a_sphere((0, 0, 0), d * sine) for d in distance]
        close(
            factors(here(places), stack_lights(sphere=rows)), (distance * sine / size) ** 2 * -places[:, 2] / size, 2e-6
        )


def test_a_disc_on_its_axis():
    radius, height = np.array([(1.0, 1.0), (3.0, 0.01), (1e-4, 5.0), (1.0, 1e4), (1e6, 2.0)]).T
    rows = [a_disc((0, 0, h), (0, 0, -1), r) for r, h in zip(radius, height)]
    close(factors(here(), stack_lights(disc=rows)), radius**2 / (radius**2 + height**2))


def gauss(count):
    x, weight = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * x, 0.5 * weight


def test_coaxial_discs_see_each_other_by_the_closed_form():
    """Two of radius 1 at distance 1: (3 - √5)/2."""
    r, weight = gauss(20)
    places = np.stack([r, 0 * r, 0 * r], axis=1)
    other = stack_lights(disc=[a_disc((0, 0, 1), (0, 0, -1), 1.0)])
    close((factors(here(places), other) * 2 * r * weight).sum(), (3 - np.sqrt(5)) / 2)


def test_unit_squares_see_each_other_by_the_closed_forms():
    """Of a cube's faces the opposite one 0.1998, four neighbours 0.2000 each, and all of them 1 together."""
    x, weight = gauss(48)
    places = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((48, 48))], axis=-1).reshape(-1, 3)
    weight = np.outer(weight, weight).ravel()
    opposite, beside = (
        (factors(here(places), stack_lights(rectangle=[a_rectangle(*light)])) * weight).sum()
        for light in (((0.5, 0.5, 1), (0, 0.5, 0), (0.5, 0, 0)), ((0.5, 0, 0.5), (0, 0, 0.5), (0.5, 0, 0)))
    )
    close(opposite, 0.1998248957, rtol=1e-6)
    close(beside, 0.2000437761, rtol=1e-4)
    close(opposite + 4 * beside, 1.0, rtol=1e-4)


RECTANGLES = [
    (((0, 0, 1), (0, 1, 0), (1, 0, 0)), UP, 1.7408395027 / np.pi),
    (((0, 0, 1), (0, 1, 0), (1, 0, 0)), (0.6, 0, 0.8), 1.3926716022 / np.pi),
    (((0.5, 0.5, 1), (0, 0.5, 0), (0.5, 0, 0)), UP, 0.1385316060),
    (((1, 0.5, 0.5), (0, 0, 0.5), (0, 0.5, 0)), UP, 0.0557341970),
    (((1, 1, 1.5), (0, 0, 1.5), (0, 1, 0)), UP, 0.1478254024),
    (((0, 0, 1), (0, 1, 0), (1, 0, 0)), (0, 0, -1), 0.0),
    (((1, 0, 0), (0, 1, 0), (0, 0, -1)), (1, 0, 0), 1.7408395027 / np.pi),
]


def test_rectangles_have_their_closed_forms():
    lights, normals, expected = zip(*RECTANGLES)
    rows = [a_rectangle(*light, two_sided=True) for light in lights]
    close(factors(here(np.zeros((7, 3)), np.array(normals)), stack_lights(rectangle=rows)), expected, rtol=2e-6)


def any_place(kind, trial, rng):
    """A light, a normal, and the corners of the polygon that it looks like."""
    center, n = rng.normal(size=(2, 3))
    n, direction = n / np.linalg.norm(n), -center / np.linalg.norm(center)
    axis = direction if trial % 4 == 0 else rng.normal(size=3)
    axis = axis / np.linalg.norm(axis) * (1 if axis @ direction > 0 else -1)
    n = -axis if trial % 4 == 1 else n
    size = 10 ** rng.uniform(-1.5, 1.0)
    if kind == "sphere":
        size = min(size, 0.9)
        corners = area_light.rim(-direction * np.sqrt(1 - size**2), direction, size)
        return a_sphere(center, size * np.linalg.norm(center)), n, corners
    if kind == "disc":
        return a_disc(center, axis, size), n, area_light.rim(center, axis, size)
    right = size * np.cross(axis, [0.3, 0.5, -0.8])
    up = np.cross(axis, right) + 0.3 * right
    corners = center + np.array([right + up, up - right, -right - up, right - up])
    return a_rectangle(center, right, up, two_sided=True), n, corners


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_lights_in_any_place_equal_lamberts_polygons(kind):
    """Half of them are cut by the horizon; those that are lose what float32 must, 1e-7 of distance over size."""
    rng = np.random.default_rng(1)
    rows, normals, corners = zip(*(any_place(kind, trial, rng) for trial in range(60)))
    heights = [around @ n for around, n in zip(corners, normals)]
    assert sum(height.min() < 0 < height.max() for height in heights) > 15
    expected = [area_light.polygon(around, n) for around, n in zip(corners, normals)]
    close(factors(here(np.zeros((60, 3)), np.array(normals)), stack_lights(**{kind: rows})), expected, 1e-4, 2e-7)


BESIDE = {
    "sphere": a_sphere((2, 0, 0), 1.0),
    "disc": a_disc((2, 0, 0), (-1, 0, 0), 1.0),
    "rectangle": a_rectangle((2, 0, 0), (0, 1, 0), (0, 0, -1)),
}


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_half_of_a_light_is_above_the_horizon_of_a_plane_through_its_middle(kind):
    """Turning the normal over shows the other half."""
    above, below = factors(here(np.zeros((2, 3)), np.array([UP, -UP])), stack_lights(**{kind: [BESIDE[kind]]}))
    close(above, below, rtol=1e-6)
    assert above > 0.01


def test_a_light_of_two_halves_is_the_sum_of_them():
    whole, *halves = (
        stack_lights(rectangle=[a_rectangle((0.3, 0.2 + side, 1), (0, half, 0), (1.5, 0, 0.2))])
        for side, half in ((0.0, 1.0), (-0.5, 0.5), (0.5, 0.5))
    )
    places = np.random.default_rng(2).normal(size=(50, 3)) * [1, 1, 0.3]
    seen = here(places, f0=0.3, alpha=0.3)
    close(sum(factors(seen, half) for half in halves), factors(seen, whole), rtol=1e-5, atol=1e-6)
    close(sum(shine(seen, half)[:, 1] for half in halves), shine(seen, whole)[:, 1], rtol=1e-4, atol=1e-6)


# -- Limits ------------------------------------------------------------------------------------------------------------

FAR = 300.0
ASIDE = np.array([0.3, 0.2, 0.0])
# A light of size 1 at a place in direction l, and its area.
FARAWAY = {
    "sphere": (lambda at, l: a_sphere(at, 1.0), np.pi),
    "disc": (lambda at, l: a_disc(at, ASIDE - l, 1.0), np.pi),
    "rectangle": (lambda at, l: a_rectangle(at, *flat(ASIDE - l)), 4.0),
}


def flat(direction):
    """Two half sides of length 1 whose product is along a direction."""
    direction = direction / np.linalg.norm(direction)
    right = np.cross(direction, [0.3, 0.5, -0.8])
    right /= np.linalg.norm(right)
    return right, np.cross(direction, right)


@jax.jit
def under_points(seen, points):
    def lone(here, light):
        lights = dataclasses.replace(NONE, point=jax.tree.map(lambda x: x[None], light))
        return jnp.stack(punctual.punctual(here, lights, ("point",), standard))

    return jax.vmap(lone)(seen, points)


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_far_away_a_light_is_a_point_of_its_intensity(kind):
    """L A cos θ', in its diffuse part by 1e-4; what the lobe is off by stays."""
    make, size = FARAWAY[kind]
    ways = towards(np.array([0.0, 0.8, 1.4]), 0.7)
    tilts = [1.0 if kind == "sphere" else l @ (l - ASIDE) / np.linalg.norm(l - ASIDE) for l in ways]
    seen = here(np.zeros((3, 3)), view=towards(0.3), f0=0.5, alpha=0.3, diffuse=0.8)
    whole = shine(seen, stack_lights(**{kind: [make(FAR * l, l) for l in ways]}))
    points = stack_lights(point=[(FAR * l, np.full(3, size * tilt), INF) for l, tilt in zip(ways, tilts)]).point
    parts = under_points(seen, points)
    close(whole[:, 0], parts[:, 0], rtol=1e-4)
    assert abs(whole[0, 1, 0] / parts[0, 1, 0] - 1) < 0.1


ENDLESS = {
    "disc": a_disc((0, 0, 1e-3), (0, 0, -1), 1e3),
    "rectangle": a_rectangle((0, 0, 1e-3), (0, 1e3, 0), (1e3, 0, 0)),
}


@pytest.mark.parametrize("kind", ENDLESS)
def test_under_an_endless_ceiling_white_surfaces_return_all(kind):
    """One of a kilometre 1 mm above: diffuse and specular light add up to about the radiance, at all angles.

    Too bright are dielectrics, whose light is weighed as if all came from straight above, and grazing views of metals.
    """
    theta, alpha = (x.ravel() for x in np.meshgrid(np.linspace(0, 1.5, 12), np.linspace(0.05, 1, 6) ** 2))
    for f0 in (1.0, 0.04):
        seen = here(np.zeros((72, 3)), view=towards(theta), f0=f0, diffuse=float(f0 < 1), alpha=alpha)
        total = shine(seen, stack_lights(**{kind: [ENDLESS[kind]]})).sum(axis=1)
        assert total.min() > 0.97 and total.max() < (1.28 if f0 == 1 else 1.16), (total.min(), total.max())


def scaled(kind, s):
    return {
        "sphere": a_sphere((s, 2 * s, 3 * s), 0.7 * s),
        "disc": a_disc((2 * s, 0, 0.5 * s), (-1, 0, 0), 2 * s),
        "rectangle": a_rectangle((2 * s, 0, 0.5 * s), (0, s, 0), (0, 0, -s)),
    }[kind]


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_scaling_the_world_by_powers_of_two_changes_nothing(kind):
    lights = stack_lights(**{kind: [scaled(kind, 2.0**power) for power in (0, -20, 13)]})
    one, *others = shine(here(view=towards(0.4), f0=0.5, diffuse=0.5), lights)
    close(others, np.stack([one, one]), rtol=3e-6)


@pytest.mark.parametrize("kind", ["disc", "rectangle"])
def test_flat_lights_shine_to_one_side_or_both(kind):
    make, shape = {
        "disc": (a_disc, ((0, 0, -1), 0.7)),
        "rectangle": (a_rectangle, ((0, 1, 0), (1, 0, 0))),
    }[kind]
    one, both = (stack_lights(**{kind: [make((0, 0, 1), *shape, two_sided)]}) for two_sided in (False, True))
    seen = here([(0, 0, 0), (0.4, 0.1, 2.0)], np.array([UP, -UP]), f0=0.5)
    once, twice = shine(seen, one), shine(seen, both)
    assert (twice > 0).all() and (once[1] == 0).all()
    np.testing.assert_array_equal(once[0], twice[0])


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_below_the_horizon_there_is_nothing(kind):
    light = FARAWAY[kind][0](np.array([3.0, 0, -1.01]), np.array([0.0, 0, 1]))
    assert (shine(here(view=towards(1.2), f0=1.0, alpha=1.0), stack_lights(**{kind: [light]})) == 0).all()


# -- The lobe ----------------------------------------------------------------------------------------------------------


def test_the_lobe_of_a_smooth_surface_has_its_closed_form():
    """δ = 1/(1 + c), a = 2c, and k, b without effect: the mirror's own cosine."""
    c = np.array([0.3, 0.5, 0.8, 0.97])
    delta, k, a, b, gain = fit(np.full(4, 1e-4), c).T
    close(delta, 1 / (1 + c), rtol=2e-3)
    close(k, 0, atol=1e-3)
    close(a + b * c, 2 * c, rtol=2e-3)
    close(gain, 1, rtol=1e-3)


WORST = {0.1: 0.006, 0.3: 0.02, 0.6: 0.04, 1.0: 0.02}  # of a light's albedo, as docs/guide/lights.md says


@pytest.mark.parametrize("roughness", WORST)
def test_highlights_are_as_far_off_as_the_guide_says(roughness):
    """Against quadrature of the BRDF, in shares of what the lobe returns of uniform light."""
    angles = (0.0, 0.7, 1.2)
    cases = [(size, v, 2.0 * towards(phi, np.pi)) for size in (0.1, 0.6) for v in towards(angles) for phi in angles]
    views = np.array([v for _, v, _ in cases])
    seen = here(np.zeros((len(cases), 3)), view=views, f0=0.5, alpha=roughness**2)
    albedo = np.asarray(compensated_albedo(seen.f0, seen.view[:, 2], seen.alpha))[:, 0]
    sides = [[2 * size * x for x in flat(-center)] for size, _, center in cases]
    made = {
        "sphere": [(a_sphere(at, 2 * size), area_light.ball(at, 2 * size)) for size, _, at in cases],
        "rectangle": [(a_rectangle(at, *side), area_light.quad(at, *side)) for (_, _, at), side in zip(cases, sides)],
    }
    errors = []
    for kind, lights in made.items():
        rows, twins = zip(*lights)
        exact = np.array([area_light.specular(v, roughness**2, 0.5, twin) for v, twin in zip(views, twins)])
        errors.append((shine(seen, stack_lights(**{kind: rows}))[:, 1, 0] - exact) / albedo)
    assert WORST[roughness] / 2 < np.abs(errors).max() < WORST[roughness], np.abs(errors).max()


# -- Many lights, gradients, and ugly places ---------------------------------------------------------------------------


def some(kind, count=3):
    rng = np.random.default_rng(3)
    place = rng.normal(size=(count, 3)) * [1, 1, 0.2] + [0, 0, 1.5]
    shape = {"sphere": (0.5,), "disc": ((0.2, 0.1, -1), 0.6), "rectangle": ((0, 0.5, 0.1), (0.4, 0, 0.2))}[kind]
    return [(p, *shape, rng.uniform(1, 2, 3), *(() if kind == "sphere" else (True,))) for p in place]


def floats(tree) -> list[np.ndarray]:
    return [np.asarray(x) for x in jax.tree.leaves(tree) if x.dtype in (jnp.float32, jnp.float64)]


def places(count=7):
    return np.random.default_rng(4).normal(size=(count, 3)) * 0.3


SEEN = {"view": towards(0.5), "f0": 0.4, "diffuse": 0.5, "alpha": 0.2}


def test_many_lights_are_the_sum_of_each_and_so_are_their_gradients():
    """With rectangles, each of whose lights has been seen alone; of kinds together, there is a test below."""
    every, seen = stack_lights(rectangle=some("rectangle")), here(places(), **SEEN)
    apart = [jax.tree.map(lambda x, i=i: x[i : i + 1], every) for i in range(3)]
    sums = functools.partial(area, brdf=standard, albedo=compensated_albedo, settings=Area())
    together = jax.jit(lambda *both: jnp.stack(sums(*both), axis=1), compiler_options=QUICK)(seen, every)
    close(together, sum(shine(seen, light) for light in apart), rtol=1e-5)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def of_all(seen, lights):
        total = lambda *both: jnp.stack(area(*both, matte, plain, Area())).sum()  # noqa: E731
        return jax.grad(total, (0, 1), allow_int=True)(seen, lights)

    of_surface, of_lights = of_all(seen, every)
    each = [slopes(seen, light) for light in apart]
    for all_of_it, *parts in zip(floats(of_surface), *(floats(one[0]) for one in each)):
        close(all_of_it, sum(parts), rtol=1e-4, atol=1e-4)
    for i, (_, of_light) in enumerate(each):
        for all_of_it, part in zip(floats(of_lights.rectangle), floats(of_light)):
            close(all_of_it[i], part.sum(axis=0), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_a_broken_pixel_changes_no_other(kind):
    every, broken = stack_lights(**{kind: some(kind, 1)}), places()
    broken[2] = np.nan
    keep = np.arange(7) != 2
    whole, hurt = (here(p, **SEEN) for p in (places(), broken))
    np.testing.assert_array_equal(shine(whole, every)[keep], shine(hurt, every)[keep])
    for a, b in zip(floats(slopes(whole, every)), floats(slopes(hurt, every))):
        np.testing.assert_array_equal(a[keep], b[keep])


STANDING = ((0.3, 0.2, 1.1), (1.2, 0.5, 0.2), (0.0, 0.0, 1.0))  # high, through the horizon, and straight above
TILTED = {
    "sphere": lambda at: a_sphere(at, 0.6),
    "disc": lambda at: a_disc(at, (-0.3, 0, -1), 0.6),
    "rectangle": lambda at: a_rectangle(at, (0, 0.5, 0.1), (0.4, 0, 0.2), True),
}


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_gradients_are_exact(kind):
    """Along random directions in everything, against central differences in double precision."""
    rng = np.random.default_rng(5)
    with jax.enable_x64(True):
        seen = here(np.zeros((3, 3)), view=towards(0.5, 1.0), f0=0.4, diffuse=0.5, alpha=0.2)
        every = getattr(stack_lights(**{kind: [TILTED[kind](place) for place in STANDING]}), kind)
        leaves, treedef = jax.tree.flatten((seen, every))
        leaves = [x.astype(jnp.float64) if x.dtype == jnp.float32 else x for x in leaves]
        steps = [jnp.asarray(rng.normal(size=x.shape)) for x in leaves]

        def moved(t):
            both = treedef.unflatten(x if x.dtype == bool else x + t * step for x, step in zip(leaves, steps))
            return jax.vmap(lambda here, light: lone(here, kind, light, matte, plain))(*both)

        both = jax.jit(lambda t: jax.jvp(moved, (t,), (jnp.ones_like(t),)), compiler_options=QUICK)
        h = 1e-6
        below, (_, slope), above = (both(jnp.asarray(t)) for t in (-h, 0.0, h))
        close(slope, (above[0] - below[0]) / (2 * h), rtol=1e-5, atol=1e-7)


UGLY = {
    "in its middle": (0.0, 0.0, 0.0),
    "nearly in its middle": (1e-9, 0.0, 0.0),
    "a denormal away": (0.0, 0.0, 1e-40),
    "on its rim": (1.0, 0.0, 0.0),
    "at its corner": (1.0, 1.0, 0.0),
    "on its edge": (1.0, 0.25, 0.0),
    "in its plane beside it": (2.0, 0.5, 0.0),
    "behind it": (0.0, 0.0, 1.0),
    "just in front": (0.1, 0.2, -1e-7),
    "on the axis": (0.0, 0.0, -2.0),
    "on a side's normal": (1.0, 0.0, -2.0),
    "far": (3.0, 1.0, -1e15),
    "absurdly far": (0.0, 1e18, -1e17),
    "inside a sphere": (0.2, 0.3, 0.1),
    "on a sphere": (0.6, 0.0, -0.8),
}


ABOUT_THE_ORIGIN = {
    "sphere": lambda size: a_sphere((0, 0, 0), size),
    "disc": lambda size: a_disc((0, 0, 0), (0, 0, -1), size, True),
    "rectangle": lambda size: a_rectangle((0, 0, 0), (0, size, 0), (size, 0, 0), True),
}


@pytest.mark.parametrize("kind", AREA_KINDS)
def test_value_and_gradient_are_finite_everywhere(kind):
    """Lights of half size 1, and of none, about the origin, seen from each place with all normals, views and alphas."""
    normals = [UP, -UP, np.array([1.0, 0, 0]), np.array([0.6, 0, 0.8]), np.array([0.0, np.sqrt(0.5), np.sqrt(0.5)])]
    cases = [
        (place, n, v, alpha)
        for place in UGLY.values()
        for n in normals
        for v in (n, np.array([0.48, 0.6, 0.64]), np.array([0.0, 1.0, 0.0]))
        for alpha in (0.045**2, 0.3, 1.0)
    ]
    place, normal, view, alpha = (np.array(column) for column in zip(*cases))
    seen = surface(place, normal, view, f0=0.5, diffuse=0.5, alpha=alpha)
    for size in (1, 0):
        lights = stack_lights(**{kind: [ABOUT_THE_ORIGIN[kind](size)]})
        value, (of_surface, of_lights) = shine(seen, lights), slopes(seen, lights)
        for leaf in (value, *floats(of_surface), *floats(of_lights)):
            fine = np.isfinite(leaf).reshape(len(cases), -1).all(axis=1)
            assert fine.all(), [cases[i] for i in np.flatnonzero(~fine)[:3]]
        assert (value >= 0).all() and value.max() < 6.0
        # A light without size gives nothing.
        assert size or (value == 0).all()


def test_what_is_no_light_is_said_in_one_line():
    for rows_of, message in (
        ({"sphere": [((0, 0, 0), -1.0, WHITE)]}, r"radius of sphere\[0\] must be 0 or more, got -1"),
        ({"disc": [((0, 0, 0), (0, 0, 0), 1.0, WHITE)]}, r"direction of disc\[0\] must be longer than 0"),
        ({"rectangle": [((0, 0, INF), (0, 1, 0), (1, 0, 0), WHITE)]}, r"position of rectangle\[0\] must be finite"),
    ):
        with pytest.raises(ValueError, match=message):
            stack_lights(**rows_of)
    with pytest.raises(ValueError, match=r"Area\.kinds must be a tuple of sphere, disc, rectangle, got \('cube',\)"):
        Area(kinds=("cube",))


def test_kinds_and_gain_choose_what_is_added():
    seen, every = here(**SEEN), stack_lights(**{kind: some(kind, 1) for kind in AREA_KINDS})
    chosen = functools.partial(area, seen, every, matte, plain)
    total = functools.partial(jax.jit, static_argnums=0, compiler_options=QUICK)(
        lambda kinds, gain: jnp.stack(chosen(Area(kinds=kinds, gain=gain)))
    )
    parts = [total((kind,), 1.0) for kind in AREA_KINDS]
    assert all((part > 0).all() for part in parts)
    close(total(AREA_KINDS, 1.0), sum(parts), rtol=1e-5)
    close(total(AREA_KINDS, 2.0), 2 * sum(parts), rtol=1e-5)
    assert all((x == 0).all() for x in area(seen, stack_lights(), matte, plain, Area()))
