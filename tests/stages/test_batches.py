"""Batches: mapped over cameras, vertices or both, inside `jit`, `grad` and `shard_map`, the bits of one by one.

And whole pictures mapped over lights and over materials: what a loop draws, and its gradients.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small
from devices import run_on_devices
from small import camera

import jaxraster as jr
from jaxraster.geometry import shapes

SIZE = {"height": 24, "width": 40}
BALL = shapes.icosphere(1.0, 1)
CAMERAS = [
    camera(eye, (0.0, 0.0, 0.0)) for eye in ((0.0, 0.3, 2.5), (2.0, 1.0, 2.0), (0.5, 0.2, 0.4))
]  # the last one is inside
SHAPES = [BALL.vertices * scale for scale in (0.3, 1.0, 1.4)]


def see(vertices, camera):
    return jr.rasterize(jr.project(vertices, camera, **SIZE), BALL.faces, **SIZE)


def stacked(trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


@pytest.fixture(scope="module")
def alone():
    """Every shape before every camera, one by one."""
    draw = jax.jit(see)
    return [[draw(vertices, camera) for camera in CAMERAS] for vertices in SHAPES]


def assert_same(batch, singles):
    for ours, theirs in zip(jax.tree.leaves(batch), jax.tree.leaves(stacked(singles))):
        np.testing.assert_array_equal(ours, theirs)


def test_over_cameras(alone):
    assert_same(jax.jit(jax.vmap(see, (None, 0)))(SHAPES[1], stacked(CAMERAS)), alone[1])


def test_over_vertices(alone):
    assert_same(jax.jit(jax.vmap(see, (0, None)))(jnp.stack(SHAPES), CAMERAS[0]), [row[0] for row in alone])


def test_over_both(alone):
    both = jax.jit(jax.vmap(jax.vmap(see, (None, 0)), (0, None)))(jnp.stack(SHAPES), stacked(CAMERAS))
    assert_same(both, [stacked(row) for row in alone])
    assert (np.asarray(both.face) >= 0).mean() > 0.2


def test_gradients_of_a_batch_are_those_of_its_members():
    def loss(vertices, camera):
        return jnp.sum(see(vertices, camera).depth ** 2)

    singles = [jax.jit(jax.grad(loss))(SHAPES[1], camera) for camera in CAMERAS]
    batch = jax.jit(jax.vmap(jax.grad(loss), (None, 0)))(SHAPES[1], stacked(CAMERAS))
    for ours, theirs in zip(batch, singles):
        # Sums over pixels may be formed in another order.
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-6 * float(jnp.abs(theirs).max()))


LIT = small.scene(
    [{"roughness": 0.4}, {"metallic": 0.5}, {"emissive": (0.5, 0.2, 0.1)}, {}, {}],
    directional=[((-0.4, -1.0, -0.3), 2.0)],
    spot=[((1.5, 2.5, 1.0), (-0.5, -0.8, -0.4), 5.0)],
)
PLAN = jr.Plan(
    width=small.WIDTH,
    height=small.HEIGHT,
    texture_slots=(),
    light_kinds=("directional", "spot"),
    shadow_map=jr.ShadowMap(resolution=64, filter="moments", directional=(0,), spot=()),
    **dict.fromkeys(("ambient", "background")),
)
WEIGHTS = np.random.default_rng(1).uniform(0.5, 1.5, (small.HEIGHT, small.WIDTH, 3)).astype(np.float32)
VALUES, rebuild = jr.parameters(LIT, ("lights.directional", "lights.spot", "materials"))


@jax.value_and_grad
def shine(values):
    """A weighted mean of the light, and its gradient in all of lights and materials."""
    return (jr.render(rebuild(values), small.camera(), PLAN).hdr * WEIGHTS).mean()


def test_pictures_and_their_gradients_mapped_over_lights_and_materials_are_the_loop_s():
    """Of three members the first has other lights, the second other materials, the last both."""

    def scaled(part, scale):
        return {name: value * (scale if name.startswith(part) else 1.0) for name, value in VALUES.items()}

    several = [scaled("lights", 0.8), scaled("materials", 0.9), scaled(("lights", "materials"), 0.7)]
    together, one_by_one = jax.jit(jax.vmap(shine))(stacked(several)), jax.jit(shine)
    loop = stacked([one_by_one(one) for one in several])
    assert len(np.unique(loop[0])) == 3
    for name in ("lights.directional.direction", "lights.spot.position", "materials.base_color"):
        assert (np.asarray(loop[1][name]) != 0).any(), name
    for (path, ours), theirs in zip(jax.tree_util.tree_leaves_with_path(together), jax.tree.leaves(loop), strict=True):
        # Sums over pixels may be formed in another order.
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5 * float(jnp.abs(theirs).max()), err_msg=str(path))


SHARDED = """
    import jaxraster as jr
    from jaxraster.geometry import shapes
    ball = shapes.icosphere(1.0, 1)
    camera = jr.Camera(world_from_view=jr.look_at((0, 0.3, 2.5), (0, 0, 0)), clip_from_view=jr.perspective(1.0, 0.1))
    turned = jnp.stack([ball.vertices * s for s in np.linspace(0.3, 1.2, 8)])
    see = lambda v: jr.rasterize(jr.project(v, camera, height=24, width=40), ball.faces, height=24, width=40)
    def loss(v):
        return jnp.sum(see(v).depth ** 2)
    whole = jax.jit(jax.vmap(see))(turned)
    slopes = jax.jit(jax.vmap(jax.grad(loss)))(turned)
    for count in (2, 4):
        mesh = Mesh(np.array(jax.devices()[:count]), ("b",))
        # Sums over pixels may be formed in another order.
        for function, expected, slack in ((see, whole, 0.0), (jax.grad(loss), slopes, 1e-6)):
            sharded = jax.jit(jax.shard_map(jax.vmap(function), mesh=mesh, in_specs=P("b"), out_specs=P("b")))
            program = sharded.lower(turned).compile()
            assert program.as_text().count("all-gather") == 0, count
            for ours, theirs in zip(jax.tree.leaves(sharded(turned)), jax.tree.leaves(expected)):
                np.testing.assert_allclose(ours, theirs, rtol=0, atol=slack)
"""


def test_shards_share_nothing_and_change_no_bit():
    """Over 2 and over 4 devices."""
    run_on_devices(4, SHARDED)
