"""Rays find what a test of every triangle in double precision finds; nothing leaks, and nothing runs on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import rays as twin

import jaxraster as jr
from jaxraster.geometry import bvh, shapes
from jaxraster.geometry.bvh import DENSE
from jaxraster.geometry.intersect import Rays, intersection, strike
from jaxraster.math.pair import unpair
from jaxraster.visibility import trace as module
from jaxraster.visibility import trace_dense, trace_tree
from jaxraster.visibility.trace import occluded, trace


def build(vertices, faces):
    return bvh.build(jnp.asarray(vertices), jnp.asarray(faces))


def build_morton(vertices, faces):
    return bvh.build_morton(jnp.asarray(vertices), jnp.asarray(faces))


BUILDERS = pytest.mark.parametrize("build", [build, build_morton], ids=["sah", "morton"])
COUNT = 2048  # rays of most tests: one shape, compiled once


def rays_of(origin, direction, **limits) -> Rays:
    return Rays(origin=jnp.asarray(origin, jnp.float32), direction=jnp.asarray(direction, jnp.float32), **limits)


def steps(rays, tree, any_hit=False) -> int:
    return int(module._hits("test", rays, tree, any_hit, "jax")[2])


def with_dust(vertices, faces):
    """The same triangles and, far away, so many more that a tree is built."""
    corner = np.float32([3e4, 5e4, 7e4])
    dust = corner + np.random.default_rng(9).uniform(size=(3 * (DENSE + 1), 3)).astype(np.float32)
    more = len(vertices) + np.arange(len(dust)).reshape(-1, 3)
    return np.concatenate([vertices, dust]), np.concatenate([faces, more]).astype(np.int32)


def soup(count, rng):
    """Triangles of sizes from 1e-3 to 1e6, the small ones within some units of the origin, large ones farther off."""
    size = 10 ** (-3 + 9 * rng.uniform(size=(count, 1, 1)) ** 4)
    centre = rng.normal(size=(count, 1, 3)) * 4 * np.maximum(size, 1.0)
    vertices = (centre + size * rng.normal(size=(count, 3, 3))).astype(np.float32).reshape(-1, 3)
    return vertices, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def at_soup(vertices, faces, rng, count=COUNT):
    """Rays from about the origin to points on triangles, and to anywhere."""
    origin = rng.normal(size=(count, 3))
    weights = rng.dirichlet([1, 1, 1], count)[..., None]
    direction = (vertices[faces[rng.integers(0, len(faces), count)]] * weights).sum(axis=1) - origin
    direction[::4] = rng.normal(size=direction[::4].shape)
    return origin.astype(np.float32), direction.astype(np.float32)


@BUILDERS
@pytest.mark.parametrize("count", [100, 1000])
def test_soups_of_very_large_and_very_small_triangles_are_hit_as_in_double_precision(build, count):
    rng = np.random.default_rng(count)
    vertices, faces = soup(count, rng)
    origin, direction = at_soup(vertices, faces, rng)
    face, t, doubtful = twin.cast(vertices, faces, origin, direction)
    assert doubtful.mean() < 0.2 and (face[~doubtful] >= 0).mean() > 0.5 and (face[~doubtful] < 0).any()
    hits = trace(rays_of(origin, direction), build(vertices, faces))
    np.testing.assert_array_equal(np.asarray(hits.face)[~doubtful], face[~doubtful])
    np.testing.assert_allclose(np.asarray(hits.t)[~doubtful], t[~doubtful], rtol=3e-3)


@BUILDERS
@pytest.mark.parametrize("count", [100, 1000])
def test_any_hit_is_closest_hit_within_the_same_limits(build, count):
    """t_max at the hit itself excludes it, a rounding more includes it, and t_min the same."""
    rng = np.random.default_rng(5)
    vertices, faces = soup(count, rng)
    origin, direction = at_soup(vertices, faces, rng)
    tree = build(vertices, faces)
    free = trace(rays_of(origin, direction), tree)
    found = free.face >= 0
    after = jnp.nextafter(free.t, jnp.inf)
    limits = [{}, {"t_max": free.t}, {"t_max": after}, {"t_min": free.t}, {"t_min": 0.5 * free.t, "t_max": 2 * free.t}]
    for limit in limits:
        limit = {name: jnp.where(found, value, 1.0) for name, value in limit.items()}
        rays = rays_of(origin, direction, **limit)
        hits = trace(rays, tree)
        np.testing.assert_array_equal(occluded(rays, tree), hits.face >= 0)
        if limit.keys() == {"t_max"}:
            same = limit["t_max"] > free.t
            np.testing.assert_array_equal(hits.face, jnp.where(same & found, free.face, hits.face))
            assert not np.any((hits.face >= 0) & ~same & found)
        if limit.keys() == {"t_min"}:
            assert not np.any(found & (hits.face >= 0) & (hits.t <= free.t))


def fan(count, rng, offset):
    """A closed fan about a hub, its rim neither round nor flat, but never seen edge-on from within 45° of above."""
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.5, count)) / count
    rim = np.stack([np.cos(angle), np.sin(angle), rng.uniform(-0.3, 0.3, count) / count], axis=-1)
    rim *= rng.uniform(0.5, 2.0, (count, 1))
    vertices = (np.concatenate([[[0, 0, 0]], rim]) + offset).astype(np.float32)
    faces = np.stack([np.zeros(count), 1 + np.arange(count), 1 + np.roll(np.arange(count), -1)], axis=-1)
    # Faces begin at any corner and run either way: neighbours name their edge in any order.
    faces = np.take_along_axis(faces, rng.permuted(np.tile(np.arange(3), (count, 1)), axis=1), axis=1)
    return vertices, faces.astype(np.int32)


@pytest.mark.parametrize("tree", [False, True], ids=["dense", "tree"])
@pytest.mark.parametrize("offset", [0.0, 1e2, 1e4])
@pytest.mark.parametrize("count", [4, 16, 127, 1024])
def test_no_ray_slips_through_the_spokes_or_the_hub_of_a_closed_fan(count, offset, tree):
    if count > DENSE and not tree:
        pytest.skip("so many triangles are always in a tree")
    rng = np.random.default_rng(count)
    vertices, faces = fan(count, rng, offset)
    hub, rim = vertices[0].astype(np.float64), vertices[1:].astype(np.float64)
    # Aim at points of the spokes: many at the hub, and elsewhere within some roundings.
    along = rng.uniform(0, 0.9, (COUNT, 1)) * (rng.uniform(size=(COUNT, 1)) < 0.8)
    target = hub + along * (rim[rng.integers(0, count, COUNT)] - hub)
    above = np.array([0.0, 0.0, 3.0]) + rng.normal(size=(COUNT, 3)) * np.float64([[0.0], [0.5]]).repeat(COUNT // 2, 0)
    origin = (target + above).astype(np.float32)
    if tree:
        vertices, faces = with_dust(vertices, faces)
    hits = trace(rays_of(origin, target - origin), build(vertices, faces))
    assert int((hits.face < 0).sum()) == 0 and int(hits.face.max()) < count


@BUILDERS
def test_no_ray_leaves_a_sphere_far_from_the_origin(build):
    """Embree's far-away sphere, where neighbouring floats are 1/64 apart."""
    rng = np.random.default_rng(0)
    centre = np.array([148376.0, 1234.0, -223423.0])
    sphere = shapes.uv_sphere(2.0, 40, 20)
    vertices, faces = np.asarray(sphere.vertices) + centre.astype(np.float32), np.asarray(sphere.faces)
    direction = rng.normal(size=(COUNT, 3))
    direction[:1024] = vertices[rng.integers(0, len(vertices), 1024)] - centre
    hits = trace(rays_of(np.broadcast_to(centre, direction.shape), direction), build(vertices, faces))
    assert int((hits.face < 0).sum()) == 0


def cube_grid(n=4):
    """The six sides of a cube as n × n squares of two triangles, at whole numbers."""
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    square = np.stack([u, v], axis=-1).reshape(-1, 1, 2) + np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]])
    sides = []
    for axis in range(3):
        for level in (0, n):
            sides.append(np.insert(square, axis, level, axis=-1).reshape(-1, 3))
    vertices = np.concatenate(sides).astype(np.float32)
    return vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)


@BUILDERS
@pytest.mark.parametrize("zero", [0.0, -0.0])
@pytest.mark.parametrize(("offset", "length"), [(0, 1), (100, 1), (1000, 1), (0, 2.0**-30), (100, 2.0**66)])
def test_axis_aligned_rays_hit_every_face_edge_and_corner_of_a_cube_grid(build, zero, offset, length):
    """Components of either zero, origins in the planes of the boxes, and t exact: lengths are powers of two."""
    vertices, faces = cube_grid()
    tree = build(vertices + np.float32(offset), faces)
    places = np.linspace(0, 4, 17)
    u, v = (axis.reshape(-1) for axis in np.meshgrid(places, places))
    for axis in range(3):
        for start, way in ((-1.0, 1.0), (5.0, -1.0), (2.0, 1.0), (2.0, -1.0)):
            origin = np.insert(np.stack([u, v], axis=-1), axis, start, axis=-1)
            direction = np.full_like(origin, zero)
            direction[:, axis] = way * length
            hits = trace(rays_of(origin + offset, direction), tree)
            expected = (1.0 if start != 2.0 else 2.0) / length
            inner = (u % 4 != 0) & (v % 4 != 0)
            assert np.all(np.asarray(hits.t)[inner] == expected)
            # In a side's plane the ray may meet that side's own edge sooner, never later.
            assert np.all(np.asarray(hits.t) <= expected)


@pytest.mark.parametrize("length", [2e-30, 1e-9, 1.0, 1e20, 5e29])
def test_distances_to_boxes_are_finite_along_directions_of_any_length(length):
    """An infinite inverse of a component would make 0 · inf in a box's plane."""
    rays = tuple(jnp.array([number], jnp.float32) for number in (0.0, 0, 0, length, 0.0, -0.0, 0.0, 1.0))
    boxes, _ = jax.jit(trace_tree._rows)(rays)
    inverse = np.asarray(boxes)[0, 3:6]
    assert inverse[0] == 1 and 1e30 < inverse[1] < np.inf and -np.inf < inverse[2] < -1e30


@pytest.mark.parametrize("tree", [False, True], ids=["dense", "tree"])
def test_invalid_rays_hit_nothing_cost_nothing_and_change_nothing(tree):
    vertices, faces = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32)
    if tree:
        vertices, faces = with_dust(vertices, faces)
    built = build(vertices, faces)
    good = rays_of(np.zeros((64, 3)), np.ones((64, 3)))
    bad = {
        "origin": [np.nan, np.inf, -np.inf, 2e12],
        "direction": [np.nan, np.inf, -np.inf, 0.0, 1e-31],
        "t_min": [np.nan, np.inf, 2.0],
        "t_max": [np.nan, -1.0, 0.0],
    }
    reference = trace(good, built)
    assert np.all(np.asarray(reference.face) == 0) and steps(good, built) > 0
    fields = {"origin": good.origin, "direction": good.direction, "t_min": np.zeros(64), "t_max": np.ones(64)}
    for name, values in bad.items():
        for value in values:
            spoilt = {key: np.array(field, np.float32) for key, field in fields.items()}
            whole = dict(spoilt, **{name: np.full_like(spoilt[name], value)})
            all_bad = Rays(**{key: jnp.asarray(field) for key, field in whole.items()})
            hits = trace(all_bad, built)
            assert np.all(np.asarray(hits.face) == -1) and np.all(np.isinf(hits.t))
            assert steps(all_bad, built) == 0 and steps(all_bad, built, any_hit=True) == 0
            # A single bad one among good ones.
            spoilt[name][5] = value
            some = Rays(**{key: jnp.asarray(field) for key, field in spoilt.items()})
            hits = trace(some, built)
            assert int(hits.face[5]) == -1
            np.testing.assert_array_equal(np.delete(hits.face, 5), np.delete(reference.face, 5))
            np.testing.assert_array_equal(np.delete(hits.t, 5), np.delete(reference.t, 5))
            assert steps(some, built) <= steps(good, built)


@BUILDERS
@pytest.mark.parametrize("count", [1, 2, 100_000])
def test_trees_of_coincident_triangles_give_the_lowest_and_end(build, count):
    vertices, faces = np.eye(3, dtype=np.float32), np.tile(np.array([[0, 1, 2]], np.int32), (count, 1))
    faces[1::2] = faces[1::2, ::-1]
    tree = build(vertices, faces)
    rays = rays_of(np.zeros((8, 3)), np.ones((8, 3)))
    hits = trace(rays, tree)
    assert np.all(np.asarray(hits.face) == 0) and np.all(np.asarray(occluded(rays, tree)))
    # All have to be looked at, for the lowest one is asked for; each of them once.
    assert steps(rays, tree) <= 8 * (count + 1)


@BUILDERS
@pytest.mark.parametrize("count", [1, 2, 100_000])
def test_trees_of_collinear_triangles_hit_nothing(build, count):
    vertices = np.arange(3 * count, dtype=np.float32)[:, None] * np.float32([1.0, 2.0, -4.0])
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    tree = build(vertices, faces)
    assert int(tree.stats.degenerate) == count
    rays = rays_of(np.tile([[0.0, 0.0, 4.0]], (8, 1)), np.float32([1.0, 2.0, -4.0]) * np.ones((8, 1)))
    assert np.all(np.asarray(trace(rays, tree).face) == -1)


@pytest.mark.parametrize("boxes", ["apart", "all in one place"])
def test_a_stack_without_room_loses_nothing(monkeypatch, boxes):
    """With no room to spare pairs are taken one by one, and found is the same, also where each ray meets each box."""
    rng = np.random.default_rng(2)
    vertices, faces = soup(1000, rng) if boxes == "apart" else (np.eye(3), np.tile(np.arange(3), (1000, 1)))
    origin, direction = at_soup(vertices, faces, rng, 64)
    tree = build(jnp.asarray(vertices, jnp.float32), jnp.asarray(faces, jnp.int32))
    rays = rays_of(origin, direction)
    expected, usual = trace(rays, tree), steps(rays, tree)
    assert np.any(expected.face >= 0)
    monkeypatch.setattr(trace_tree, "SPARE", 0)
    columns = (*rays.origin.T, *rays.direction.T, jnp.zeros(64), jnp.full(64, jnp.inf))
    hits, more = jax.jit(lambda rays: trace_tree.trace_tree(tree.nodes, tree.leaves, rays, jnp.int32(64), False))(
        columns
    )
    np.testing.assert_array_equal(unpair(hits)[1], expected.face)
    assert int(more) > 2 * usual


def bundle(rng, width, size):
    """Rays that share their main axis, with origins and slopes in ranges of a width, and triangles of a size."""
    corners = (rng.normal(size=(120, 1, 3)) * 4 + size * rng.normal(size=(120, 3, 3))).astype(np.float32)
    origin = (rng.normal(size=3) + width * rng.uniform(-1, 1, (256, 3))).astype(np.float32)
    direction = np.concatenate(
        [rng.uniform(-0.7, 0.7, 2) + width * rng.uniform(-0.3, 0.3, (256, 2)), np.ones((256, 1))], 1
    )
    return corners, origin, (direction * rng.choice([1.0, -1.0]) * rng.uniform(0.1, 10, (256, 1))).astype(np.float32)


@pytest.mark.parametrize(("width", "size", "most"), [(1.0, 1.0, 1.0), (0.1, 0.3, 0.2), (0.0, 0.01, 0.05)])
def test_triangles_are_left_out_only_where_no_ray_meets_them(width, size, most):
    """Of narrow bundles most are; among the wide ones are rays through corners."""
    left = []
    for seed in range(40):
        corners, origin, direction = bundle(np.random.default_rng(seed), width, size)
        if width == 1.0:
            direction[:120] = corners[:, seed % 3] - origin[:120]
        direction = np.where(np.abs(direction).argmax(axis=1)[:, None] == 2, direction, [0, 0, direction[-1, 2]])
        shear, up = direction[:, :2] / direction[:, 2:], direction[:, 2] > 0
        table, columns = (
            jnp.asarray(corners.reshape(-1, 9)),
            [jnp.asarray(v, jnp.float32) for v in (*origin.T, *shear.T)],
        )
        ends = [(jnp.min(v), jnp.max(v)) for v in columns]
        missed = trace_dense._missed(table.T, ends[:3], ends[3:], jnp.any(up), jnp.any(~up))
        per_z = jnp.asarray(1.0 / direction[:, 2], jnp.float32)
        met, t = jax.vmap(strike, in_axes=(0, None, None, None))(table, columns[:3], columns[3:], per_z)
        assert not np.any(np.asarray(met & (t > 0)).any(axis=1) & np.asarray(missed))
        left.append(1.0 - np.mean(missed))
    assert np.mean(left) < most


@pytest.mark.parametrize("make", [build, build_morton], ids=["sah", "morton"])
def test_what_a_tree_finds_has_the_gradient_of_its_place(make):
    """t by `intersection` of the face that was found, against central differences of the whole search."""
    sphere = shapes.icosphere(1.0, 2)
    origin = jnp.array([[0.1, -0.2, 3.0], [0.4, 0.3, 3.0], [5.0, 0.0, 0.0]])
    towards = jnp.array([[0.05, 0.02, -1.0], [-0.1, 0.05, -1.0], [0.0, 1.0, 0.0]])

    def reach(scale, towards):
        vertices = sphere.vertices * scale[None, :]
        rays = Rays(origin=origin, direction=towards)
        face = trace(rays, make(jax.lax.stop_gradient(vertices), sphere.faces)).face
        return jnp.sum(jnp.where(face >= 0, intersection(vertices, sphere.faces, face, rays)[0], 0.0))

    scale, step = jnp.array([1.0, 1.1, 0.9]), 1e-3
    by_scale, by_direction = jax.grad(reach, argnums=(0, 1))(scale, towards)
    for axis, one in enumerate(np.eye(3, dtype=np.float32) * step):
        difference = (reach(scale + one, towards) - reach(scale - one, towards)) / (2 * step)
        np.testing.assert_allclose(by_scale[axis], difference, rtol=2e-2, atol=2e-3)
    moved = jnp.zeros((3, 3)).at[0, 0].set(step)
    difference = (reach(scale, towards + moved) - reach(scale, towards - moved)) / (2 * step)
    np.testing.assert_allclose(by_direction[0, 0], difference, rtol=2e-2, atol=2e-3)
    assert np.all(np.isfinite(by_direction)) and np.all(np.asarray(by_direction[2]) == 0)


@BUILDERS
def test_nothing_that_is_not_a_number_is_made_on_the_way(build):
    vertices, faces = with_dust(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32))
    rays = rays_of(np.zeros((8, 3)), np.repeat([[1.0], [0.0]], 4, axis=0) * np.ones((8, 3)))
    with jax.debug_nans(True):
        tree = build(vertices, faces)
        assert trace(rays, tree).face.tolist() == [0] * 4 + [-1] * 4
        assert occluded(rays, tree).tolist() == [True] * 4 + [False] * 4


@pytest.mark.parametrize("tree", [False, True], ids=["dense", "tree"])
def test_batches_equal_one_by_one(tree):
    """By vmap over rays, over geometry, over both; and with leading axes."""
    rng = np.random.default_rng(3)
    vertices, faces = soup(1000 if tree else 50, rng)
    origin, direction = at_soup(vertices, faces, rng, 3 * 64)
    rays = rays_of(origin.reshape(3, 64, 3), direction.reshape(3, 64, 3))
    built = build(vertices, faces)
    alone = [trace(rays_of(rays.origin[i], rays.direction[i]), built) for i in range(3)]
    together = trace(rays, built)
    mapped = jax.vmap(lambda o, d: trace(Rays(origin=o, direction=d), built))(rays.origin, rays.direction)
    for i in range(3):
        for several in (together, mapped):
            np.testing.assert_array_equal(several.face[i], alone[i].face)
            np.testing.assert_array_equal(several.t[i], alone[i].t)
    moved = jnp.stack([jnp.asarray(vertices), 2.0 * jnp.asarray(vertices)])
    scaled = jax.jit(jax.vmap(lambda v, o, d: trace(Rays(origin=o, direction=d), build_morton(v, faces))))(
        moved, jnp.stack([rays.origin[0], 2.0 * rays.origin[0]]), jnp.stack([rays.direction[0]] * 2)
    )
    np.testing.assert_array_equal(scaled.face[0], alone[0].face)
    np.testing.assert_array_equal(scaled.face[1], alone[0].face)
    np.testing.assert_array_equal(scaled.t[1], 2.0 * alone[0].t)


@pytest.mark.parametrize("few", [False, True], ids=["tree", "dense"])
@pytest.mark.parametrize("count", [64, 65, 128, 130])
def test_the_last_chunk_begins_earlier_and_changes_nothing(monkeypatch, count, few):
    """Of rays in chunks of 64, some of which are none, each has the hit that it has alone, and costs no more steps."""
    rng = np.random.default_rng(count)
    vertices, faces = soup(100 if few else 300, rng)
    origin, direction = at_soup(vertices, faces, rng, count)
    direction[rng.uniform(size=count) < 0.3] = 0.0
    tree, rays = build(vertices, faces), rays_of(origin, direction)
    expected = trace(rays, tree)
    monkeypatch.setattr(trace_tree, "RAYS", 64)
    monkeypatch.setattr(trace_dense, "CHUNK", 64)
    module._core.cache_clear()
    try:
        hits, any_hits = trace(rays, tree), occluded(rays, tree)
    finally:
        module._core.cache_clear()
    np.testing.assert_array_equal(hits.face, expected.face)
    np.testing.assert_array_equal(hits.t, expected.t)
    np.testing.assert_array_equal(any_hits, expected.face >= 0)


def test_a_second_call_does_not_compile():
    rng = np.random.default_rng(4)
    vertices, faces = soup(200, rng)
    tree = build_morton(vertices, faces)
    call = jax.jit(trace)
    for seed in range(3):
        origin, direction = at_soup(vertices, faces, np.random.default_rng(seed), 64)
        call(rays_of(origin, direction), tree)
    assert call._cache_size() == 1


def test_nothing_has_a_gradient():
    vertices, faces = jnp.eye(3), jnp.array([[0, 1, 2]])

    def t(vertices, direction):
        return trace(Rays(origin=jnp.zeros(3), direction=direction), build(vertices, faces)).t

    direction = jnp.array([1.0, 1.0, 2.0])
    assert t(vertices, direction) == 0.25
    for gradient in jax.grad(t, argnums=(0, 1))(vertices, direction):
        assert np.all(np.asarray(gradient) == 0)


def test_empty_inputs_give_empty_results():
    vertices, none = jnp.eye(3), jnp.zeros((0, 3), jnp.int32)
    some = rays_of(np.zeros((2, 3)), np.ones((2, 3)))
    for make in (build, build_morton):
        assert trace(some, make(vertices, none)).face.tolist() == [-1, -1]
        assert trace(some, make(jnp.zeros((0, 3)), none)).face.tolist() == [-1, -1]
    assert trace(rays_of(np.zeros((0, 3)), np.ones((0, 3))), build(vertices, jnp.array([[0, 1, 2]]))).face.shape == (0,)


SIZE = 96


@pytest.mark.parametrize("scene", ["cornell", "sphere"])
def test_primary_rays_see_what_the_rasterizer_draws(scene):
    """The same face at every pixel, but within 3/256 px of an edge, where positions are snapped."""
    room, camera = jr.scenes.cornell_box()
    if scene == "sphere":
        translation = jnp.eye(4).at[:3, 3].set(2.8)
        room = dataclasses.replace(room, mesh=shapes.place(shapes.icosphere(2.5, 3), translation))
    vertices, faces = room.mesh.vertices, room.mesh.faces
    clip = jr.project(vertices, camera, height=SIZE, width=SIZE)
    drawn = np.asarray(jr.rasterize(clip, faces, height=SIZE, width=SIZE).face)
    pose, lens = np.asarray(camera.world_from_view, np.float64), np.asarray(camera.clip_from_view, np.float64)
    centre = (np.arange(SIZE) + 0.5) * 2 / SIZE - 1
    x, y = np.meshgrid(centre, -centre)
    direction = np.stack([x / lens[0, 0], y / lens[1, 1], -np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    rays = rays_of(np.broadcast_to(pose[:3, 3], direction.shape), direction)
    seen = np.asarray(trace(rays, build(vertices, faces)).face)
    other = np.argwhere(seen != drawn)
    assert len(other) < 0.02 * SIZE**2 and (seen >= 0).mean() > 0.3
    corners = np.asarray(clip, np.float64)[np.asarray(faces)]
    screen = corners[..., :2] / corners[..., 3:] * [SIZE / 2, -SIZE / 2] + SIZE / 2
    for row, column in other:
        # An edge of one of the two faces is near.
        point, near = np.array([column + 0.5, row + 0.5]), []
        for face in {int(seen[row, column]), int(drawn[row, column])} - {-1}:
            for a, b in zip(screen[face], np.roll(screen[face], -1, axis=0)):
                (x, y), (u, v) = b - a, point - a
                near.append(abs(x * v - y * u) / np.hypot(x, y))
        assert min(near) <= 3 / 256


def test_embree_finds_the_same():
    pytest.importorskip("embreex", reason="an optional backend")
    rng = np.random.default_rng(6)
    sphere = shapes.icosphere(1.0, 3)
    tree = build(sphere.vertices, sphere.faces)
    origin, direction = 0.5 * rng.normal(size=(COUNT, 3)), rng.normal(size=(COUNT, 3))
    rays = rays_of(origin, direction, t_max=jnp.asarray(rng.uniform(0, 3, COUNT), jnp.float32))
    ours, theirs = trace(rays, tree), trace(rays, tree, backend="embree")
    assert 0.2 < (np.asarray(ours.face) >= 0).mean() < 0.9
    assert (np.asarray(ours.face) != np.asarray(theirs.face)).mean() < 0.002
    same = np.asarray(ours.face == theirs.face)
    np.testing.assert_allclose(np.asarray(theirs.t)[same], np.asarray(ours.t)[same], rtol=1e-4)
    np.testing.assert_array_equal(np.asarray(occluded(rays, tree, backend="embree")), np.asarray(theirs.face) >= 0)
    nothing = dataclasses.replace(
        rays,
        origin=rays.origin.at[::4].set(jnp.nan),
        direction=rays.direction.at[1::4].set(0.0),
        t_min=jnp.where(jnp.arange(COUNT) % 4 == 2, rays.t_max, 0.0),
    )
    found = trace(nothing, tree, backend="embree")
    assert np.all(np.asarray(found.face).reshape(-1, 4)[:, :3] == -1) and np.any(np.asarray(found.face) >= 0)
    np.testing.assert_array_equal(occluded(nothing, tree, backend="embree"), found.face >= 0)
    batch = jax.tree.map(lambda v: v.reshape(2, -1, *v.shape[1:]), dataclasses.replace(rays, t_min=jnp.zeros(COUNT)))
    mapped = jax.vmap(lambda rays: trace(rays, tree, backend="embree").face)(batch)
    np.testing.assert_array_equal(mapped.reshape(-1), theirs.face)


def test_embree_absent_is_said_in_one_line(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "embreex", None)
    jax.clear_caches()
    vertices, faces = with_dust(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32))
    with pytest.raises(ImportError, match=r"^backend 'embree' needs the package embreex: pip install 'jaxraster\[rays"):
        trace(rays_of(np.zeros((2, 3)), np.ones((2, 3))), build(vertices, faces), backend="embree")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rays": 3}, r"^trace: rays must be a Rays, got int$"),
        ({"tree": 3}, r"^trace: tree must be a Tree, got int$"),
        ({"backend": "gpu"}, r"^trace: backend must be one of \('jax', 'embree'\), got 'gpu'$"),
        ({"origin": np.zeros((3, 3), np.float32)}, r"^trace: rays: .* must be one for each ray, got \[3\], \[2\]"),
        ({"direction": np.ones((2, 2), np.float32)}, r"^trace: rays.direction must be float \[..., 3\], got"),
        ({"direction": np.ones((2, 3), np.int32)}, r"^trace: rays.direction must be float .*, got int32 \[2, 3\]"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(change, message):
    fields = {"origin": np.zeros((2, 3), np.float32), "direction": np.ones((2, 3), np.float32)}
    fields |= {name: value for name, value in change.items() if name in fields}
    rays = object.__new__(Rays)
    for name, value in {**fields, "t_min": 0.0, "t_max": np.inf}.items():
        object.__setattr__(rays, name, value)
    arguments = {"rays": rays, "tree": build(jnp.eye(3), jnp.array([[0, 1, 2]])), "backend": "jax"}
    arguments |= {name: value for name, value in change.items() if name not in fields}
    with pytest.raises((TypeError, ValueError), match=message):
        module._hits("trace", any_hit=False, **arguments)
