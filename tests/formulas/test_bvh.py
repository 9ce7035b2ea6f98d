"""Trees hold every triangle once, in boxes that contain it, and are built in time."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxraster.geometry import bvh_sah
from jaxraster.geometry.bvh import DENSE, NONE, build, build_morton
from jaxraster.geometry.intersect import Rays
from jaxraster.visibility.trace import trace

BUILDERS = pytest.mark.parametrize("build", [build, build_morton], ids=["sah", "morton"])


def grid(count, rng, spread=0.01):
    vertices = rng.uniform(size=(count, 1, 3)) + spread * rng.normal(size=(count, 3, 3))
    return jnp.asarray(vertices.reshape(-1, 3), jnp.float32), jnp.arange(3 * count, dtype=jnp.int32).reshape(-1, 3)


def walk(tree):
    """Of each face in the tree the boxes above it, and the depth of the deepest leaf."""
    nodes, leaves = np.asarray(tree.nodes), np.asarray(tree.leaves)
    boxes_of = nodes.view(np.float32)
    above, deepest, level, seen = {}, 0, [(0, [])], 0
    while level:
        deepest, following = deepest + 1, []
        for node, boxes in level:
            seen += 1
            child = nodes[node, 24:28]
            for k in range(4):
                inside = [*boxes, boxes_of[node, 6 * k : 6 * k + 6]]
                if child[k] >= 0:
                    following.append((child[k], inside))
                elif child[k] != NONE:
                    for face in leaves[-1 - child[k], 36:]:
                        if face >= 0:
                            assert face not in above
                            above[face] = inside
        level = following
    assert seen <= len(nodes)
    return above, deepest


@BUILDERS
@pytest.mark.parametrize("count", [DENSE + 1, 500, 1025])
def test_each_triangle_is_in_one_leaf_and_in_all_boxes_above_it(build, count):
    vertices, faces = grid(count, np.random.default_rng(count))
    # Some of no area: they are in no leaf.
    faces = faces.at[::7].set(0)
    tree = build(vertices, faces)
    above, deepest = walk(tree)
    assert sorted(above) == sorted(set(range(count)) - set(range(0, count, 7)))
    assert int(tree.stats.degenerate) == len(range(0, count, 7)) and deepest <= 8
    corners = np.asarray(vertices)[np.asarray(faces)]
    for face, boxes in above.items():
        for box in boxes:
            assert np.all(corners[face] >= box[:3]) and np.all(corners[face] <= box[3:])


@BUILDERS
@pytest.mark.parametrize("left", [0, 1, 2, 4, 5])
def test_trees_of_few_triangles_among_many_without_area(build, left):
    vertices, faces = grid(200, np.random.default_rng(1))
    tree = build(vertices, faces.at[left:].set(0))
    assert sorted(walk(tree)[0]) == list(range(left))
    rays = Rays(origin=jnp.mean(vertices[faces[:4]], axis=1) - 1.0, direction=jnp.ones((4, 3)))
    hits = trace(rays, tree)
    assert np.all(np.asarray(hits.face)[left:] < left)
    for k in range(min(left, 4)):
        assert int(hits.face[k]) >= 0


@pytest.mark.slow
def test_a_hundred_thousand_triangles_take_two_seconds():
    vertices, faces = grid(100_000, np.random.default_rng(2))
    build(vertices, faces)
    # Compiled now. The processor's time, for others may be at work.
    began = time.process_time()
    jax.block_until_ready(build(vertices, faces))
    assert time.process_time() - began <= 2.0


def test_a_chain_of_ever_larger_triangles_is_no_deeper_than_the_bound(monkeypatch):
    """Each split by area would part off a few of them: after so many levels nodes are halved."""
    # So few that this tree would have 23 levels otherwise.
    monkeypatch.setattr(bvh_sah, "STEEP", 5)
    count = 4000
    size = 1.02 ** np.arange(-1000.0, 3000.0)[:count] * 1e-12
    boxes = np.concatenate([np.repeat(size[:, None], 3, 1), 1.01 * np.repeat(size[:, None], 3, 1)], axis=1).astype(
        np.float32
    )
    _, children, slots = bvh_sah.wide_tree(boxes, NONE)
    level, depth = np.array([0]), 0
    while len(level):
        depth, level = depth + 1, children[level][children[level] >= 0]
    assert depth <= (bvh_sah.STEEP + 12) / 2 + 1
    assert sorted(slots[slots >= 0]) == list(range(count))


def test_splits_by_area_cost_less_than_neighbours_on_a_curve():
    """What rays cost goes with the sum of the boxes' areas."""
    vertices, faces = grid(2000, np.random.default_rng(3))

    def cost(tree):
        boxes = np.asarray(tree.nodes).view(np.float32)[:, :24].reshape(-1, 6)
        side = np.where(np.isfinite(boxes[:, :1]), boxes[:, 3:] - boxes[:, :3], 0.0)
        return (side[:, 0] * side[:, 1] + side[:, 1] * side[:, 2] + side[:, 2] * side[:, 0]).sum()

    splits, curve = cost(build(vertices, faces)), cost(build_morton(vertices, faces))
    assert splits < 0.9 * curve and curve < 4 * splits


def test_trees_of_moving_geometry_are_mapped_and_compiled_once():
    vertices, faces = grid(300, np.random.default_rng(4))
    several = jnp.stack([vertices, 2.0 * vertices, vertices - 5.0])
    together = jax.vmap(lambda v: build_morton(v, faces))(several)
    for i in range(3):
        alone = build_morton(several[i], faces)
        np.testing.assert_array_equal(together.nodes[i], alone.nodes)
        np.testing.assert_array_equal(together.leaves[i], alone.leaves)
    gradient = jax.grad(lambda v: build_morton(v, faces).nodes.view(jnp.float32)[0, 0])(vertices)
    assert not np.any(gradient)


def test_positions_that_are_traced_are_refused_in_one_line():
    vertices, faces = grid(DENSE + 1, np.random.default_rng(5))
    with pytest.raises(TypeError, match=r"^build: vertices are traced, and more than 128 .*; use build_morton"):
        jax.jit(lambda v: build(v, faces))(vertices)
