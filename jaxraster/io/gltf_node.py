"""glTF's node hierarchy: where everything stands in the world.

Source: Khronos Group, "glTF 2.0 Specification", 2021, section 3.5.
"""

import math

import numpy as np
from jaxtyping import Float

from .asset import LARGEST
from .pointer import Json, fail, indices, numbers, reference, rows
from .reading import Reading, exceed

Matrix = Float[np.ndarray, "4 4"]
ROUNDED = 1e-5  # how far a matrix's last row may be from 0, 0, 0, 1: products of float32 round further than their eps
UNIT = 1e-2  # how far a quaternion's length may be from 1: codes of 8 bits are half of that off
_IDENTITY = np.eye(4)
_MOVES = {"matrix", "translation", "rotation", "scale"}


def local_matrix(node: Json, reading: Reading) -> Matrix:
    """A node's own transform: its column-major `matrix`, or translation · rotation · scale."""
    matrix = _IDENTITY.copy()
    if "matrix" in node.value:
        matrix = np.array(numbers(node, "matrix", tuple(_IDENTITY.ravel()))).reshape(4, 4).T
        if not np.allclose(matrix[3], _IDENTITY[3], rtol=0, atol=ROUNDED):
            fail(node, f"its matrix ends in the row {matrix[3].tolist()}, not in 0, 0, 0, 1; export the scene again")
        matrix[3] = _IDENTITY[3]
        return matrix
    if "translation" in node.value:
        matrix[:3, 3] = numbers(node, "translation", (0.0, 0.0, 0.0))
    if "rotation" not in node.value and "scale" not in node.value:
        return matrix
    x, y, z, w = numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0))
    norm = math.hypot(x, y, z, w)
    if abs(norm - 1) > UNIT:
        what = "scaled to one" if norm else "taken as none"
        reading.mend(node.file, node.where, f"a rotation that is no unit quaternion is {what}")
    x, y, z, w = (x / norm, y / norm, z / norm, w / norm) if norm else (0.0, 0.0, 0.0, 1.0)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    scale = numbers(node, "scale", (1.0, 1.0, 1.0))
    if 0.0 in scale:
        reading.ignore("a scale of 0 flattens what hangs on a node", node.where)
    matrix[:3, :3] = np.array(rotation) * scale
    return matrix


def _parents(nodes: list[Json]) -> dict[int, int]:
    parents = {}
    for i, node in enumerate(nodes):
        for child in indices(node, "children", len(nodes)) if "children" in node.value else ():
            if child in parents:
                fail(node, f"node {child} is a child of both {parents[child]} and {i}; export the scene again")
            parents[child] = i
    # Walk up from every node, and stop at one that an earlier walk has shown to hang from a root.
    safe = set()
    for start in range(len(nodes)):
        trail, node = {}, start
        while node in parents and node not in safe and node not in trail:
            trail[node] = None
            node = parents[node]
        if node in trail:
            cycle = [*list(trail)[list(trail).index(node) :], node]
            loop = " → ".join(map(str, cycle[::-1]))
            fail(nodes[node], f"is its own ancestor: {loop}; export the scene again")
        safe.update(trail)
    return parents


def place_nodes(root: Json, reading: Reading) -> list[tuple[Json, Matrix]]:
    """Every node of the file's scene with its world transform (float64), in the order of the file."""
    nodes, scenes = rows(root, "nodes"), rows(root, "scenes")
    if len(nodes) > (most := reading.limits.nodes):
        exceed("nodes", most, root.file, f"{root.where}/nodes", f"has {len(nodes)} nodes")
    parents = _parents(nodes)
    scene = reference(root, "scene", scenes) or (scenes[0] if scenes else None)
    roots = indices(scene, "nodes", len(nodes)) if scene else [i for i in range(len(nodes)) if i not in parents]
    if len(set(roots)) < len(roots):
        fail(scene or root, "names a root node twice; export the scene again")
    for i in roots:
        if i in parents:
            fail(scene or root, f"its root node {i} is a child of node {parents[i]}; export the scene again")
    children = {}
    for child, parent in parents.items():
        children.setdefault(parent, []).append(child)

    world, waiting = {}, [(i, _IDENTITY) for i in roots]
    with np.errstate(over="ignore", invalid="ignore"):
        while waiting:
            i, above = waiting.pop()
            world[i] = above if nodes[i].value.keys().isdisjoint(_MOVES) else above @ local_matrix(nodes[i], reading)
            waiting.extend((child, world[i]) for child in children.get(i, ()))
    # Check all at once, and name the first on the way down; what overflows on the way is infinite or no number here.
    largest = np.abs(np.stack(list(world.values()))).max(axis=(1, 2)) if world else np.zeros(0)
    for i, size in zip(world, largest):
        if not size <= LARGEST:
            fail(nodes[i], f"its world transform holds {size:.3g}; at most {LARGEST:g} is drawn")
    return [(nodes[i], world[i]) for i in sorted(world)]
