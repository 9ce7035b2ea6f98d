"""Light on surfaces, one kind at a time: what photometry says of it, where it ends, and that it adds up."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_made import surface, towards

from jaxraster.brdf.blinn_phong import blinn_phong
from jaxraster.brdf.compensation import compensated_albedo
from jaxraster.brdf.standard import standard
from jaxraster.light import ambient as ambient_file
from jaxraster.light import punctual as punctual_file
from jaxraster.light.ambient import Ambient, sky_share
from jaxraster.light.background import Background, background, rays
from jaxraster.light.emission import Emission, emission
from jaxraster.math.transform import look_at, orthographic, perspective
from jaxraster.scene import Camera, Environment, Point, Spot
from jaxraster.stack import stack_lights
from jaxraster.visibility.project import project

INF = np.inf
single = np.float32
ambient = jax.jit(ambient_file.ambient)
point, spot = jax.jit(punctual_file.point), jax.jit(punctual_file.spot)


def close(actual, expected, rtol=1e-6, atol=0.0):
    np.testing.assert_allclose(np.asarray(actual), expected, rtol=rtol, atol=atol)


def first(kind):
    """One light of a kind, without leading count."""
    return jax.tree.map(lambda column: column[0], kind)


def a_point(position=(0.0, 0.0, 0.0), intensity=(1.0, 1.0, 1.0), range=INF) -> Point:
    return first(stack_lights(point=[(position, intensity, range)]).point)


def a_spot(direction=(0.0, 0.0, -1.0), inner=0.2, outer=0.5, range=INF) -> Spot:
    return first(stack_lights(spot=[((0, 0, 0), direction, (1, 1, 1), range, inner, outer)]).spot)


# -- Punctual lights ---------------------------------------------------------------------------------------------------


def test_a_point_light_fades_with_the_square():
    rng = np.random.default_rng(0)
    places = single(rng.normal(size=(64, 3)) * 10 ** rng.uniform(-3, 4, (64, 1)))
    centre = single([0.3, -0.2, 5.0])
    l, irradiance = point(surface(places), a_point(centre, (1.0, 2.0, 3.0)))
    away = centre.astype(np.float64) - places.astype(np.float64)
    square = (away**2).sum(axis=1, keepdims=True)
    close(l, away / np.sqrt(square), rtol=1e-6, atol=1e-6)
    close(irradiance, np.array([1.0, 2.0, 3.0]) / square, rtol=1e-6)


@pytest.mark.parametrize("brdf", [standard, blinn_phong])
def test_a_lambertian_plane_under_a_point_light(brdf):
    """Radiance albedo/π · I/d², for a light straight above; Lambert's cosine for one aside."""
    color, intensity = np.array([0.8, 0.5, 0.1]), np.array([100.0, 50.0, 10.0])
    add = jax.jit(lambda here, every: punctual_file.punctual(here, every, ("point",), brdf))
    for distance in (0.1, 1.0, 30.0):
        place = stack_lights(point=[((0.0, 0.0, distance), intensity, INF)])
        diffuse, specular = add(surface([[0.0, 0, 0]], diffuse=color, f90=0.0), place)
        close(diffuse[0], color / np.pi * intensity / distance**2)
        assert (specular == 0).all()
    aside = stack_lights(point=[((4.0, 0.0, 3.0), intensity, INF)])
    here = surface([[0.0, 0, 0]], view=[0.8, 0, 0.6], diffuse=color, f90=0.0)
    close(add(here, aside)[0][0], color / np.pi * intensity / 25 * 0.6, rtol=2e-6)


def test_the_window_of_a_limited_range():
    distance = single([0.5, 1.0, 1.8, 2.0, 2.1, 1e10])
    there = surface(np.stack([distance, 0 * distance, 0 * distance], axis=1))
    falloff = np.asarray(point(there, a_point(range=2.0))[1])[:, 0] * distance.astype(np.float64) ** 2
    close(falloff, [1 - 1 / 256, 1 - 1 / 16, 1 - 0.9**4, 0, 0, 0], rtol=1e-6, atol=1e-6)
    assert (falloff[3:] == 0).all()
    unlimited = np.asarray(point(there, a_point())[1])[:, 0] * distance.astype(np.float64) ** 2
    close(unlimited, np.ones(6))


def test_a_spot_is_full_inside_the_inner_and_dark_outside_the_outer_cone():
    inner, outer = 0.3, 0.8
    angle = np.array([0.0, 0.299, 0.5, 0.7, 0.8, 0.801, 1.5, np.pi])
    l, irradiance = spot(surface(-towards(angle)), a_spot(inner=inner, outer=outer))
    close(l, towards(angle), atol=1e-6)
    exact = np.clip((np.cos(angle) - np.cos(outer)) / (np.cos(inner) - np.cos(outer)), 0, 1) ** 2
    close(irradiance[:, 0], exact, rtol=1e-5, atol=1e-7)
    assert irradiance[0, 0] == 1 and irradiance[1, 0] == 1 and (irradiance[5:] == 0).all()


def test_a_spot_of_one_angle_has_a_soft_but_narrow_edge():
    angle = np.array([0.0, 0.49, 0.51])
    irradiance = spot(surface(-towards(angle)), a_spot(inner=0.5, outer=0.5))[1][:, 0]
    close(irradiance, [1, 1, 0], atol=1e-6)
    close(spot(surface(-towards(angle)), a_spot(inner=0.0, outer=0.0))[1][:, 0], [0, 0, 0])


@pytest.mark.parametrize(
    ("lights", "message"),
    [
        ({"directional": [((0, 0, 0), (1, 1, 1))]}, r"direction of directional\[0\] must be longer than 0"),
        (
            {"directional": [((0, 0, 1), (1, np.nan, 1))]},
            r"irradiance of directional\[0\] must be finite, got \[1.0, nan",
        ),
        (
            {"point": [((0, 0, 0), (1, 1, 1), INF), ((0, INF, 0), (1, 1, 1), 1)]},
            r"position of point\[1\] must be finite",
        ),
        ({"point": [((0, 0, 0), (1, 1, 1), -1.0)]}, r"range of point\[0\] must be 0 or more, got -1.0"),
        ({"spot": [((0, 0, 0), (0, 0, 1), (1, 1, 1), INF, 0.5, 0.4)]}, r"inner of spot\[0\] must be at most outer"),
        (
            {"spot": [((0, 0, 0), (0, 0, 1), (1, 1, 1), INF, -0.1, 0.4)]},
            r"inner of spot\[0\] must be a half angle from",
        ),
    ],
)
def test_numbers_that_make_no_light_are_refused_in_one_line(lights, message):
    with pytest.raises(ValueError, match=f"^stack_lights: {message}"):
        stack_lights(**lights)


def test_a_range_of_zero_reaches_nothing():
    """Also where the light sits on the surface, in value and gradient."""
    places = surface([[0.0, 0, 0], [1.0, 0, 0], [1e-6, 0, 0]])
    light = a_point(range=0.0)
    assert (point(places, light)[1] == 0).all()
    slope = jax.jit(jax.grad(lambda x: punctual_file.point(places, x)[1].sum()))(light)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


def test_a_negative_strength_takes_its_light_away():
    places = surface(np.random.default_rng(6).normal(size=(9, 3)))
    shown, taken = (point(places, a_point(intensity=(s, 2 * s, 3 * s)))[1] for s in (1.0, -1.0))
    np.testing.assert_array_equal(taken, -np.asarray(shown))


def test_a_light_behind_the_surface_lights_nothing():
    """As one inside of a closed mesh does: its surfaces face away from it."""
    below = stack_lights(
        point=[((0, 0, -0.1), (9, 9, 9), INF)], spot=[((0, 0, -1), (0, 0, 1), (9, 9, 9), INF, 0.1, 1.0)]
    )
    parts = jax.jit(lambda x: punctual_file.punctual(x, below, ("point", "spot"), standard))(
        surface([[0.0, 0, 0]], f0=1.0)
    )
    assert all((part == 0).all() for part in parts)


def test_gradients_at_cones_that_are_none_are_finite():
    """Cones of one angle, of no angle, and of all directions, on their axis, on their edge and behind."""
    places = surface(-towards(np.array([0.0, 0.5, 0.5001, 1.5, np.pi])))
    slopes = jax.jit(jax.grad(lambda x: punctual_file.spot(places, x)[1].sum()))
    for inner, outer in ((0.5, 0.5), (0.0, 0.0), (0.0, np.pi), (np.pi, np.pi)):
        slope = slopes(a_spot(inner=inner, outer=outer))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope)), (inner, outer)


UGLY_PLACES = {
    "on the light": (0.0, 0.0, 0.0),
    "within an atom": (0.0, 0.0, -1e-10),
    "a denormal away": (1e-40, 0.0, 0.0),
    "a micrometre away": (0.0, 1e-6, 0.0),
    "at the range": (2.0, 0.0, 0.0),
    "on the axis": (0.0, 0.0, -1.0),
    "behind": (0.0, 0.0, 1.0),
    "on the outer cone": tuple(-towards(0.5)),
    "on the inner cone": tuple(-towards(0.2)),
    "very far": (0.0, 0.0, -1e15),
    "absurdly far": (0.0, 1e18, 0.0),
}


def test_light_is_finite_with_finite_gradients_everywhere():
    places = jnp.array(list(UGLY_PLACES.values()), jnp.float32)

    def shine(place, normal, light):
        here = replace(surface(np.zeros(3), f0=0.04), position=place, normal=normal)
        l, irradiance = punctual_file.spot(here, light)
        diffuse, specular = standard(here, l)
        # Bare radiance too, or the cosine would hide the light on the surface.
        return jnp.concatenate([irradiance, (diffuse + specular) * irradiance])

    modes = [jax.vmap(shine, (0, 0, None))]
    modes += [jax.vmap(mode(shine, (0, 1, 2)), (0, 0, None)) for mode in (jax.jacrev, jax.jacfwd)]
    everything = jax.jit(lambda *arguments: [mode(*arguments) for mode in modes])
    dark = [name in ("on the light", "a denormal away", "behind") for name in UGLY_PLACES]
    axis = list(UGLY_PLACES).index("on the axis")
    # 1/d², within a range of 2 less d²/16: at d = 1 a step towards the light adds 2 or 2 + 2/16 of it.
    for limit, slope in ((INF, 2), (2.0, 2.125)):
        value, reverse, forward = everything(
            places, jnp.tile(jnp.array([[0.0, 0.0, 1.0]]), (11, 1)), a_spot(range=limit)
        )
        for leaf in jax.tree.leaves((value, reverse, forward)):
            fine = np.isfinite(np.asarray(leaf).reshape(len(places), -1)).all(axis=1)
            assert [name for name, good in zip(UGLY_PLACES, fine) if not good] == []
        assert (value[np.array(dark)] == 0).all()
        close(reverse[0][axis][0], [0, 0, slope], rtol=1e-5, atol=1e-6)
        # The light's own derivative is what it lights, per candela.
        close(reverse[2].intensity[axis][:3], value[axis, 0] * np.eye(3), rtol=1e-5, atol=1e-7)


def test_directional_light_is_the_same_everywhere():
    sun = first(stack_lights(directional=[((0.0, -3.0, -4.0), (3.0, 2.0, 1.0))]).directional)
    l, irradiance = punctual_file.directional(surface(np.random.default_rng(1).normal(size=(5, 3))), sun)
    close(l, [[0, 0.6, 0.8]] * 5)
    close(irradiance, [[3, 2, 1]] * 5)


@pytest.fixture(scope="module")
def many():
    """Places, six lights of all kinds, and the function that adds them up."""
    rng = np.random.default_rng(2)
    normal = towards(rng.uniform(0, 1, 50), rng.uniform(0, 7, 50))
    view = towards(rng.uniform(0, 1, 50), rng.uniform(0, 7, 50))
    here = surface(rng.normal(size=(50, 3)), normal, view, diffuse=rng.uniform(0, 1, (50, 3)), f0=0.3)
    rows = {
        "directional": [((0, 0, -1), (1, 2, 3)), ((0.5, 0, -1), (3, 0, 1))],
        "point": [((0, 0, 3), (10, 5, 1), INF), ((2, 2, 2), (1, 1, 1), 6)],
        "spot": [
            ((0, 1, 4), (0, 0, -1), (20, 20, 20), 9, 0.2, 0.9),
            ((3, 0, 3), (-1, 0, -1), (5, 5, 9), INF, 0.0, 1.2),
        ],
    }

    @jax.jit
    def add(every, shadow):
        shares = {"directional": jnp.stack([jnp.ones(50), shadow])}
        return punctual_file.punctual(here, every, ("directional", "point", "spot"), standard, shares)

    return rows, lambda every, shadow=1.0: add(every, jnp.full(50, shadow))


def total(parts) -> np.ndarray:
    return np.stack([np.asarray(p, np.float64) for p in parts])


def test_many_lights_are_the_sum_of_each(many):
    rows, add = many
    together = total(add(stack_lights(**rows)))
    apart = 0.0
    for kind in rows:
        for number, _ in enumerate(rows[kind]):
            alone = stack_lights(**rows)
            for other in rows:
                light = getattr(alone, other)
                field = "irradiance" if other == "directional" else "intensity"
                keep = jnp.array([[float(other == kind and i == number)] for i in range(2)])
                alone = replace(alone, **{other: replace(light, **{field: getattr(light, field) * keep})})
            apart = apart + total(add(alone))
    close(together, apart, rtol=4 * 2.0**-23, atol=1e-12)
    assert together.min() >= 0 and (together.max(axis=(1, 2)) > 0.1).all()


@pytest.mark.parametrize("power", [-20, 7])
def test_light_is_linear_and_by_powers_of_two_exactly_so(many, power):
    rows, add = many
    every = stack_lights(**rows)
    scaled = every
    for kind, field in (("directional", "irradiance"), ("point", "intensity"), ("spot", "intensity")):
        light = getattr(every, kind)
        scaled = replace(scaled, **{kind: replace(light, **{field: getattr(light, field) * 2.0**power})})
    for one, other in zip(add(scaled), add(every)):
        np.testing.assert_array_equal(one, np.asarray(other) * 2.0**power)


def test_a_shadow_falls_on_its_own_light_alone(many):
    rows, add = many
    lit, shaded = add(stack_lights(**rows)), add(stack_lights(**rows), 0.0)
    without = stack_lights(**rows)
    sun = without.directional
    without = replace(without, directional=replace(sun, irradiance=sun.irradiance * jnp.array([[1.0], [0.0]])))
    for one, other, full in zip(shaded, add(without), lit):
        np.testing.assert_array_equal(one, other)
        assert np.abs(np.asarray(full) - np.asarray(one)).max() > 0.1


def test_no_lights_is_dark():
    parts = punctual_file.punctual(
        surface(np.zeros((2, 3))), stack_lights(), ("directional", "point", "spot"), standard
    )
    assert all((part == 0).all() and part.shape == (2, 3) for part in parts)


# -- Ambient -----------------------------------------------------------------------------------------------------------

UP, SKY, GROUND = np.array([0.0, 1.0, 0.0]), np.array([1.0, 2.0, 4.0]), np.array([0.5, 0.1, 0.0])


def surroundings(sky=SKY, ground=GROUND, up=UP) -> Environment:
    return Environment(
        up=jnp.array(up, jnp.float32), sky=jnp.array(sky, jnp.float32), ground=jnp.array(ground, jnp.float32)
    )


def grid(side: int) -> tuple[np.ndarray, np.ndarray]:
    u = (np.arange(side) + 0.5) / side
    return tuple(x.ravel() for x in np.meshgrid(u, u, indexing="ij"))


def test_diffuse_ambient_light_is_the_hemispheres_mean():
    """Radiance c/π · ∫ L (n·l) dl, by cosine-weighted quadrature about the normal; f0 = 0 leaves B to the mirror."""
    u1, u2 = grid(512)
    local = towards(np.arcsin(np.sqrt(u1)), 2 * np.pi * u2)
    color = np.array([0.9, 0.5, 0.2])
    for tilt in (0.0, 0.4, 1.0, np.pi / 2, 2.5, np.pi):
        # The normal makes the angle `tilt` with up; in the frame about the normal up is tilted instead.
        mean = np.where((local @ towards(tilt) > 0)[:, None], SKY, GROUND).mean(axis=0)
        normal = np.array([np.sin(tilt), np.cos(tilt), 0.0])
        here = surface(np.zeros((1, 3)), normal, diffuse=color, alpha=1.0)
        diffuse, _ = ambient(here, surroundings(), Ambient())
        left = 1 - np.asarray(compensated_albedo(here.f0, jnp.ones(1), here.alpha))
        close(diffuse[0], color * mean * left[0], rtol=1e-3)


def prefiltered(cosine: float, alpha: float) -> float:
    """The sky's share of the GGX lobe seen head on (n = v = r), weighed by n·l; up at `cosine` to r."""
    s, u2 = grid(128)
    # More samples where the normals are few: u = s (2 - s).
    u, dense = s * (2 - s), 2 * (1 - s)
    theta = np.arccos(np.sqrt((1 - u) / (1 + (alpha * alpha - 1) * u)))
    l = towards(2 * theta, 2 * np.pi * u2)
    weight = np.maximum(l[:, 2], 0) * dense
    return (weight * (l @ towards(np.arccos(cosine)) > 0)).sum() / weight.sum()


def test_the_skys_share_at_both_ends():
    cosine = jnp.linspace(-1, 1, 201)
    np.testing.assert_array_equal(sky_share(cosine, jnp.ones(201)), 0.5 + 0.5 * cosine)
    mirror = sky_share(cosine, jnp.zeros(201))
    close(mirror, 0.5 + 0.5 * np.sign(np.asarray(cosine)), atol=1e-7)
    # The smallest alpha there is leaves the step as wide as itself.
    smooth = sky_share(jnp.array([-0.1, 0.0, 0.1]), jnp.full(3, 0.045**2))
    close(smooth, [0, 0.5, 1], atol=1e-3)


def test_the_skys_share_is_ordered_and_symmetric():
    half, alpha = np.linspace(0.01, 1, 100), jnp.array([0.0, 0.002, 0.1, 0.5, 1.0])
    cosine = jnp.asarray(np.concatenate([-half[::-1], [0], half]), jnp.float32)
    share = np.asarray(jax.vmap(lambda a: sky_share(cosine, jnp.full(201, a)))(alpha))
    assert (np.diff(share, axis=1) >= 0).all() and (share >= 0).all() and (share <= 1).all()
    close(share + share[:, ::-1], np.ones_like(share), atol=2e-7)
    # Above the horizon a wider lobe gathers less sky.
    assert (np.diff(share[:, 101:], axis=0) <= 1e-7).all()


def test_the_skys_share_is_as_close_to_the_lobe_as_it_says():
    cosine = np.linspace(0, 1, 21)
    worst = {}
    for alpha in (0.02, 0.1, 0.25, 0.36, 0.5, 0.75, 1.0):
        fit = np.asarray(sky_share(jnp.asarray(cosine, jnp.float32), jnp.full(21, alpha)))
        worst[alpha] = np.abs(fit - [prefiltered(c, alpha) for c in cosine]).max()
    print(worst)
    assert 0.008 < max(worst.values()) < 0.01


def test_gradients_of_ambient_light_are_finite():
    """At the horizon, along and against up, at grazing view, at the roughest and the smoothest."""
    normals = [UP, -UP, [1, 0, 0], [0, 0, 1], [0, np.sqrt(0.5), np.sqrt(0.5)]]
    views = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    cases = [(n, v, a) for n in normals for v in views for a in (0.045**2, 0.25, 1.0)]
    normal, view, alpha = (jnp.asarray(np.array(c, np.float32)) for c in zip(*cases))

    def shine(normal, view, alpha, environment):
        here = replace(surface(np.zeros(3), f0=0.5), normal=normal, view=view, alpha=alpha)
        return jnp.concatenate(ambient_file.ambient(here, environment, Ambient()))

    modes = [jax.vmap(mode(shine, (0, 1, 2, 3)), (0, 0, 0, None)) for mode in (jax.jacrev, jax.jacfwd)]
    reverse, forward = jax.jit(lambda *a: [mode(*a) for mode in modes])(normal, view, alpha, surroundings())
    for r, f in zip(jax.tree.leaves(reverse), jax.tree.leaves(forward)):
        assert jnp.isfinite(r).all() and jnp.isfinite(f).all()
        close(r, f, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_what_is_white_cannot_be_told_from_uniform_surroundings(metallic):
    """Metal or dielectric, of any roughness, whichever way it faces."""
    rng = np.random.default_rng(3)
    normal, view = towards(rng.uniform(0, 3, 40), rng.uniform(0, 7, 40)), towards(rng.uniform(0, 3, 40), 1.0)
    white = {"diffuse": 1 - metallic, "f0": 0.04 + 0.96 * metallic}
    here = surface(np.zeros((40, 3)), normal, view, alpha=rng.uniform(0.01, 1, 40), **white)
    diffuse, specular = ambient(here, surroundings(SKY, SKY), Ambient())
    close(diffuse + specular, np.broadcast_to(SKY, (40, 3)), rtol=1e-6)
    assert (diffuse == 0).all() or metallic == 0


def test_a_mirror_shows_the_tone_it_points_at():
    view = np.array([0.0, np.sin(0.5), np.cos(0.5)])
    normals = np.array([[0, 0, 1], [0, np.sin(0.4), np.cos(0.4)]])  # mirror directions below and above the horizon
    here = surface(np.zeros((2, 3)), normals, view, diffuse=0.0, f0=1.0, alpha=0.045**2)
    specular = np.asarray(ambient(here, surroundings(), Ambient())[1])
    albedo = np.asarray(compensated_albedo(here.f0, jnp.sum(here.normal * here.view, axis=-1), here.alpha))
    close(specular / albedo, [GROUND, SKY], atol=1e-3)


def test_the_roughest_metal_gathers_about_its_normal():
    """At alpha = 1 the lobe is the cosine's: the sky's share is (1 + n·up)/2, whatever the view."""
    rng = np.random.default_rng(12)
    normal, view = towards(rng.uniform(0, 0.7, 40), rng.uniform(0, 7, 40)), towards(rng.uniform(0, 0.7, 40), 1.0)
    here = surface(np.zeros((40, 3)), normal, view, diffuse=0.0, f0=1.0, alpha=1.0)
    cosine = (normal * view).sum(axis=1, keepdims=True)
    share = 0.5 + 0.5 * normal[:, 1:2]
    albedo = np.asarray(compensated_albedo(here.f0, jnp.asarray(cosine[:, 0], jnp.float32), here.alpha))
    close(ambient(here, surroundings(), Ambient())[1], albedo * (GROUND + (SKY - GROUND) * share), rtol=1e-5)


def test_ambient_light_follows_f90():
    """Between f90 = 0 and 1 the specular part is linear in it, and the diffuse part takes what is left."""
    view = np.array([[0.0, np.sin(1.2), np.cos(1.2)]])
    normal = np.array([[0.0, 0.0, 1.0]])
    parts = [
        ambient(
            surface(np.zeros((1, 3)), normal, view, diffuse=0.5, f0=0.02, f90=f90), surroundings(SKY, SKY), Ambient()
        )
        for f90 in (0.0, 0.25, 1.0)
    ]
    none, quarter, whole = (np.asarray(specular, np.float64) for _, specular in parts)
    assert (whole > 2 * none).all()
    close(quarter - none, 0.25 * (whole - none), rtol=1e-4)
    for diffuse, specular in parts:
        close(np.asarray(diffuse) / 0.5 + np.asarray(specular), np.broadcast_to(SKY, (1, 3)), rtol=1e-5)


def test_gain_and_occlusion_scale_ambient_light():
    plain = ambient(surface(np.zeros((3, 3)), UP, f0=0.04), surroundings(), Ambient())
    scaled = ambient(
        surface(np.zeros((3, 3)), UP, f0=0.04, occlusion=[0.0, 0.25, 1.0]), surroundings(), Ambient(gain=2.0)
    )
    for one, other in zip(scaled, plain):
        np.testing.assert_array_equal(one, np.asarray(other) * np.array([[0.0], [0.5], [2.0]], np.float32))


# -- Emission and background -------------------------------------------------------------------------------------------


def test_emission_is_the_materials_own_times_the_gain():
    here = replace(surface(np.zeros((2, 3))), emissive=jnp.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(emission(here, Emission(gain=4.0)), [[4, 8, 12], [0, 0, 0]])
    np.testing.assert_array_equal(jax.grad(lambda g: emission(here, Emission(gain=g)).sum())(1.0), 6)


SIZE = {"height": 9, "width": 13}
directions_of = jax.jit(lambda camera: rays(camera, **SIZE))
POSE = look_at(jnp.array([3.0, 2.0, 1.0]), jnp.array([0.0, 1.0, -2.0]))


def calibrated() -> Camera:
    """Skewed, off centre, and with pixels that are not square."""
    K = jnp.array([[11.0, 0.7, 4.0], [0.0, 9.0, 6.5], [0.0, 0.0, 1.0]])
    return Camera.from_opencv(K, POSE[:3, :3].T, jnp.array([0.1, 0.2, 0.3]), **SIZE)


CAMERAS = {
    "pinhole": Camera(world_from_view=POSE, clip_from_view=perspective(0.9)),
    "with a far plane": Camera(world_from_view=POSE, clip_from_view=perspective(2.5, 0.01, 100.0)),
    "calibrated": calibrated(),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_project_back_to_their_pixels(name):
    camera = CAMERAS[name]
    directions = directions_of(camera)
    close(np.linalg.norm(directions, axis=-1), 1, rtol=3e-7)
    points = camera.world_from_view[None, :3, 3] + 5.0 * directions.reshape(-1, 3)
    clip = np.asarray(project(points, camera, **SIZE), np.float64)
    assert (clip[:, 3] > 0).all()
    x = (clip[:, 0] / clip[:, 3]).reshape(9, 13)
    y = (clip[:, 1] / clip[:, 3]).reshape(9, 13)
    close(x, np.broadcast_to((np.arange(13) + 0.5) * 2 / 13 - 1, (9, 13)), atol=2e-6)
    close(y, np.broadcast_to(1 - (np.arange(9) + 0.5)[:, None] * 2 / 9, (9, 13)), atol=2e-6)


def test_the_middle_ray_looks_straight_ahead():
    middle = directions_of(CAMERAS["pinhole"])[4, 6]
    close(middle, -np.asarray(POSE)[:3, 2], atol=1e-6)
    # One row up and one column right of it turn by one pixel of 2 tan(0.45)/9 each.
    pixel = 2 * np.tan(0.45) / 9
    corner = np.asarray(directions_of(CAMERAS["pinhole"])[3, 7], np.float64) @ np.asarray(POSE, np.float64)[:3, :3]
    close(corner / -corner[2], [pixel, pixel, -1], atol=1e-6)


def test_rays_of_parallel_projections_are_parallel():
    camera = Camera(world_from_view=POSE, clip_from_view=orthographic(2.0, 0.1, 10.0))
    close(directions_of(camera), np.broadcast_to(-np.asarray(POSE)[:3, 2], (9, 13, 3)), atol=1e-6)


def test_the_background_shows_the_two_tones():
    ahead = Camera(world_from_view=look_at(jnp.zeros(3), jnp.array([0.0, 0.0, -1.0])), clip_from_view=perspective(1.0))
    hard = np.asarray(background(ahead, surroundings(), Background(blurriness=0.0), **SIZE))
    close(hard[:4], np.broadcast_to(SKY, (4, 13, 3)), atol=1e-6)
    close(hard[5:], np.broadcast_to(GROUND, (4, 13, 3)), atol=1e-6)
    # The horizon itself is half of each, at any blur.
    close(hard[4], np.broadcast_to((SKY + GROUND) / 2, (13, 3)), atol=1e-6)
    soft = np.asarray(background(ahead, surroundings(), Background(blurriness=1.0, gain=2.0), **SIZE))
    share = 0.5 + 0.5 * np.asarray(directions_of(ahead))[..., 1:2]
    close(soft, 2 * (GROUND + (SKY - GROUND) * share), rtol=1e-5)


def test_gradients_of_the_background_are_finite():
    def total(camera, environment, blurriness):
        return jnp.sum(background(camera, environment, Background(blurriness=blurriness), **SIZE) ** 2)

    slopes = jax.jit(jax.grad(total, (0, 1, 2)))
    for camera in CAMERAS.values():
        for blurriness in (0.0, 0.5, 1.0):
            gradients = slopes(camera, surroundings(), blurriness)
            assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))
            assert jnp.abs(gradients[1].sky).max() > 0
