"""Masked and blended materials in `render`, against a twin that sorts every pixel's fragments in double precision."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import layers as layers_twin
from reference import texture as texture_twin

import jaxraster as jr
from jaxraster.scene import BLEND, MASK, OPAQUE
from jaxraster.surface.opacity import Holes, alpha_modes
from jaxraster.visibility.layers import layers

SIZE, QUADS, KEPT = 32, 14, 3
SKY = (0.2, 0.3, 0.4)
PLAN = jr.Plan(
    width=SIZE,
    height=SIZE,
    layers=jr.Layers(blended=KEPT),
    texture_slots=("base_color",),
    light_kinds=(),
    ambient=None,
    background=jr.Background(),
)
CAMERA = jr.Camera(world_from_view=jr.look_at((0, 0, 2), (0, 0, 0)), clip_from_view=jr.orthographic(1.0, 0.1, 4.0))
LEAVES = ("base_color", "texels", "colors", "vertices")
WEIGHTS = np.random.default_rng(5).uniform(0.5, 1.5, (SIZE, SIZE, 3)).astype(np.float32)
IMAGES = [np.random.default_rng(i).uniform(0, 1, (size, size, 4)).astype(np.float32) for i, size in ((1, 8), (2, 4))]
CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def quads(seed: int, **changes) -> dict[str, np.ndarray]:
    """Quads that face the camera, each of a material of its own: what the scene and its twin are made of."""
    rng = np.random.default_rng(seed)
    low = rng.integers(-4, 20, (QUADS, 2)) + 0.25
    rows = {
        "low": low,  # pixels from the top left; no corner is near a pixel's centre
        "high": low + rng.integers(8, 30, (QUADS, 2)),
        "z": rng.permutation(QUADS) / QUADS,  # greater is nearer
        "color": rng.uniform(0.1, 1.0, (QUADS, 4)),
        "corner_color": rng.uniform(0.3, 1.0, (QUADS, 4)),
        "texture": rng.integers(-1, 2, QUADS),
        "repeats": rng.uniform(0.3, 3.0, QUADS),
        "mode": rng.integers(0, 3, QUADS),
        "cutoff": rng.uniform(0.1, 0.6, QUADS),
        "away": np.zeros(QUADS, bool),  # turned away from the camera, and seen from the front alone
    }
    return {**rows, **{name: np.broadcast_to(value, rows[name].shape) for name, value in changes.items()}}


def build(rows: dict[str, np.ndarray]) -> jr.Scene:
    """The scene of these quads; all scenes have one shape."""
    places = rows["low"][:, None] + CORNERS * (rows["high"] - rows["low"])[:, None]
    places = np.concatenate(
        [places * [2, -2] / SIZE + [-1, 1], np.broadcast_to(rows["z"][:, None, None], (QUADS, 4, 1))], -1
    )
    front, back = np.array([[0, 2, 1], [0, 3, 2]]), np.array([[0, 1, 2], [0, 2, 3]])
    faces = np.where(rows["away"][:, None, None], back, front) + 4 * np.arange(QUADS)[:, None, None]
    mesh = jr.Mesh(
        vertices=jnp.asarray(places.reshape(-1, 3), jnp.float32),
        normals=jnp.zeros((4 * QUADS, 3)),
        tangents=jnp.zeros((4 * QUADS, 4)),
        uvs=jnp.asarray((CORNERS * rows["repeats"][:, None, None]).reshape(-1, 2), jnp.float32),
        faces=jnp.asarray(faces.reshape(-1, 3), jnp.int32),
        material=jnp.arange(QUADS, dtype=jnp.int32).repeat(2),
        colors=jnp.asarray(rows["corner_color"].repeat(4, axis=0), jnp.float32),
    )
    materials = jr.stack_materials([{"unlit": True, "alpha_mode": MASK, "alpha_cutoff": 0.1}] * QUADS)
    materials = replace(
        materials,
        base_color=jnp.asarray(rows["color"], jnp.float32),
        base_color_texture=jnp.asarray(rows["texture"], jnp.int32),
        alpha_mode=jnp.asarray(rows["mode"], jnp.int32),
        alpha_cutoff=jnp.asarray(rows["cutoff"], jnp.float32),
        double_sided=jnp.asarray(~rows["away"]),
    )
    dark = jnp.zeros(3)
    sky = jnp.array(SKY)
    return jr.Scene(
        mesh=mesh,
        materials=materials,
        textures=jr.pack_textures(IMAGES),
        lights=jr.stack_lights(directional=[((0, 0, -1), dark)]),
        environment=jr.Environment(up=jnp.array([0.0, 1, 0]), sky=sky, ground=sky),
    )


@functools.partial(jax.jit, static_argnames="layered")
def _draw(scene, camera, layered=True):
    """A frame, and the gradient of a weighted sum of its light."""
    values, rebuild = jr.parameters(scene, LEAVES)

    def light(values):
        frame = jr.render(rebuild(values), camera, PLAN if layered else replace(PLAN, layers=None))
        return jnp.sum(frame.hdr * WEIGHTS), frame

    (_, frame), gradient = jax.value_and_grad(light, has_aux=True)(values)
    return frame, gradient


def draw(rows, layered=True):
    """The same of the scene of these quads, as NumPy arrays."""
    return jax.device_get(_draw(build(rows), CAMERA, layered=layered))


def expected(rows, textures):
    """(light, face's quad, fragments left out, pixels that no rounding decides) of the twin."""
    line, column = np.mgrid[:SIZE, :SIZE] + 0.5
    place = np.stack([column, line], -1)[None]
    low, high = rows["low"][:, None, None], rows["high"][:, None, None]
    cover = ((place > low) & (place < high)).all(-1) & ~rows["away"][:, None, None]
    uv = (place - low) / (high - low) * rows["repeats"][:, None, None, None]
    step = (rows["repeats"][:, None] / (rows["high"] - rows["low"]))[:, None, None, :, None] * np.eye(2)
    index = np.broadcast_to(rows["texture"][:, None, None], cover.shape)
    texel = texture_twin.texture(textures, index, uv, np.broadcast_to(step, (*cover.shape, 2, 2)))
    color = texel * np.float32(rows["color"] * 1.0)[:, None, None] * np.float32(rows["corner_color"])[:, None, None]
    order = np.lexsort((np.arange(QUADS), -rows["z"]))
    light, first, left_out = np.zeros((SIZE, SIZE, 3)), np.full((SIZE, SIZE), -1), 0
    near = np.abs(color[..., 3] - rows["cutoff"][:, None, None]) < 1e-5  # alphas differ by float32's rounding
    sure = ~(near & cover & (rows["mode"] == MASK)[:, None, None]).any(0)
    for y in range(SIZE):
        for x in range(SIZE):
            ids = order[cover[order, y, x]]
            alpha = color[ids, y, x, 3]
            kept, beyond = layers_twin.layers(ids, alpha, rows["mode"][ids], rows["cutoff"][ids], KEPT)
            solid = np.where(rows["mode"][ids] == BLEND, alpha, 1.0)
            light[y, x] = layers_twin.over(color[ids[kept], y, x, :3], solid[kept], np.array(SKY))
            first[y, x] = ids[kept[0]] if kept else -1
            left_out += beyond
    return light, first, left_out, sure


STACKS = {
    "of all kinds": quads(0),
    "of all kinds, others": quads(1),
    "blended, deeper than the layers": quads(2, mode=BLEND),
    "masked": quads(3, mode=MASK, texture=0),
    "opaque": quads(4, mode=OPAQUE),
    "at one depth": quads(5, z=0.5),
    "at two depths": quads(6, z=np.arange(QUADS) % 2 / 2),
    "some turned away": quads(7, away=np.arange(QUADS) % 3 == 0),
}


@pytest.mark.parametrize("name", STACKS)
def test_a_stack_is_what_its_sorted_fragments_make(name):
    """Light, the foremost surface, and how many blended fragments found no layer."""
    rows = STACKS[name]
    frame, gradient = draw(rows)
    light, first, left_out, sure = expected(rows, jax.device_get(build(rows).textures))
    assert sure.mean() > 0.99
    np.testing.assert_allclose(frame.hdr[sure], light[sure], rtol=0, atol=3e-6)
    assert (np.where(frame.visibility.face < 0, -1, frame.visibility.face // 2) == first)[sure].all()
    if sure.all():
        assert frame.stats.beyond_layers == left_out
    assert left_out > 1000 or not name.startswith("blended")
    assert (frame.surface.mask == (first >= 0))[sure].all() and (first < 0).any()
    assert all(np.isfinite(slope).all() for slope in gradient.values())


def test_an_opaque_scene_is_what_it_is_without_layers():
    """The same triangles to the bit; the same light but for the rounding of a differently fused program."""
    rows = STACKS["opaque"]
    (layered, gradient), (plain, without) = draw(rows), draw(rows, layered=False)
    for name in ("face", "nearness", "depth", "barycentric"):
        np.testing.assert_array_equal(getattr(layered.visibility, name), getattr(plain.visibility, name))
    np.testing.assert_allclose(layered.hdr, plain.hdr, rtol=2e-7)
    assert plain.stats.beyond_layers is None and plain.surface.opacity is None
    assert layered.stats.beyond_layers == 0 and (layered.surface.opacity == 1).all()
    for name, slope in without.items():
        np.testing.assert_allclose(gradient[name], slope, rtol=1e-5, atol=1e-5, err_msg=name)


def test_what_is_cut_out_everywhere_is_not_there():
    """Masked with an alpha of 0: the background alone is seen, and nothing has a gradient."""
    rows = quads(8, mode=MASK, color=[1.0, 1.0, 1.0, 0.0])
    frame, gradient = draw(rows)
    assert (frame.visibility.face == -1).all() and not frame.surface.mask.any()
    np.testing.assert_allclose(frame.hdr, np.broadcast_to(np.float32(SKY), frame.hdr.shape), rtol=1e-6)
    assert (gradient["materials.base_color"] == 0).all()


def test_the_order_of_the_faces_does_not_matter():
    """Where no two are at the same depth."""
    rows = STACKS["of all kinds"]
    order = np.random.default_rng(0).permutation(QUADS)
    shuffled = {name: values[order] for name, values in rows.items()}
    one, other = draw(rows)[0], draw(shuffled)[0]
    np.testing.assert_array_equal(one.hdr, other.hdr)
    np.testing.assert_array_equal(one.visibility.nearness, other.visibility.nearness)
    assert one.stats.beyond_layers == other.stats.beyond_layers


def test_the_gradient_of_a_blended_alpha_is_a_difference():
    """Light is linear in the alpha of each quad, so that a wide step is exact; a masked one's alpha has none."""
    rows = quads(9, color=np.random.default_rng(9).uniform(0.3, 0.7, (QUADS, 4)))
    slopes = draw(rows)[1]["materials.base_color"][:, 3]
    blended = rows["mode"] == BLEND
    assert np.count_nonzero(slopes[blended]) > 3 and (slopes[~blended] == 0).all()
    for quad in np.flatnonzero(blended):
        ends = []
        for step in (0.25, -0.25):
            color = rows["color"].copy()
            color[quad, 3] += step
            ends.append((draw({**rows, "color": color})[0].hdr.astype(np.float64) * WEIGHTS).sum())
        np.testing.assert_allclose(slopes[quad], (ends[0] - ends[1]) / 0.5, rtol=1e-3, atol=1e-3)


def test_broken_triangles_are_counted_once():
    """Those of either pass: opaque and others."""
    rows = quads(10, mode=np.arange(QUADS) % 3)
    scene = build(rows)
    faces = scene.mesh.faces.at[0].set(0).at[2].set(5).at[4].set(9)  # without area, opaque, masked and blended
    vertices = scene.mesh.vertices.at[4 * 3].set(jnp.nan).at[4 * 4].set(jnp.inf)
    broken = replace(scene, mesh=replace(scene.mesh, faces=faces, vertices=vertices))
    stats, plain = (_draw(broken, CAMERA, layered=layered)[0].stats for layered in (True, False))
    for name in ("non_finite", "degenerate", "out_of_range"):
        assert getattr(stats, name) == getattr(plain, name), name
    assert plain.degenerate == 3 and plain.non_finite == 4


def test_over_cameras_one_by_one_or_at_once():
    scene = build(STACKS["blended, deeper than the layers"])
    poses = jnp.stack([jr.look_at((x, 0.1, 2), (0, 0, 0)) for x in (-0.5, 0.0, 0.6)])
    cameras = jr.Camera(world_from_view=poses, clip_from_view=jnp.stack([CAMERA.clip_from_view] * 3))
    plan = replace(PLAN, supersample=2, width=SIZE // 2, height=SIZE // 2)
    together = jax.jit(jax.vmap(lambda camera: jr.render(scene, camera, plan)))(cameras)
    for i in range(3):
        alone = _draw(scene, jax.tree.map(lambda leaf: leaf[i], cameras), layered=True)[0]  # noqa: B023
        np.testing.assert_array_equal(together.visibility.face[i], alone.visibility.face)
        assert together.stats.beyond_layers[i] == alone.stats.beyond_layers > 0
        samples = np.asarray(alone.hdr).reshape(SIZE // 2, 2, SIZE // 2, 2, 3).mean((1, 3))
        np.testing.assert_allclose(together.hdr[i], samples, rtol=1e-5, atol=1e-6)


def test_the_helmet_is_seen_through_its_lenses(assets):
    """The first layer is what is nearest, and behind the lenses the second is what peeling finds."""
    scene, camera = jr.load(assets / "FlightHelmet" / "FlightHelmet.gltf")
    size, faces, modes = {"height": 96, "width": 96}, scene.mesh.faces, alpha_modes(scene)
    clip = jr.project(scene.mesh.vertices, camera, **size)
    cull = ~scene.materials.double_sided[scene.mesh.material]
    holes = Holes(scene=scene, camera=camera, clip=clip, slots=())
    found = layers(clip, faces, modes, holes, cull, jr.Layers(blended=2, masked=False), **size)
    nearest = jr.rasterize(clip, faces, cull=cull, **size)
    behind = jr.peel(clip, faces, nearest, cull=cull)
    lenses = np.asarray((nearest.face >= 0) & (modes[jnp.maximum(nearest.face, 0)] == BLEND))
    assert lenses.sum() > 50 and (found.stats.beyond_layers == 0).all()
    for name in ("face", "nearness", "barycentric", "depth"):
        np.testing.assert_array_equal(getattr(found, name)[0], getattr(nearest, name))
        np.testing.assert_array_equal(getattr(found, name)[1][lenses], getattr(behind, name)[lenses])
    assert (np.asarray(found.face[1])[lenses] >= 0).all() and (np.asarray(found.face[1])[~lenses] == -1).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"blended": -1}, r"Layers\.blended must be a whole number, 0 or more, got -1"),
        ({"blended": True}, r"Layers\.blended must be a whole number, 0 or more, got True"),
    ],
)
def test_layers_that_cannot_be_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        jr.Layers(**settings)
