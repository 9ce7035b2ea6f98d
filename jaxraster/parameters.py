"""Choosing the numbers of a scene to differentiate: float leaves by path, out and back in.

A scene also holds integers, which `jax.grad` refuses, so gradients are taken in a dict of the chosen arrays.
"""

import difflib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Values = dict[str, Float[Array, "..."]]


def path_name(path: tuple) -> str:
    """A leaf's path in dots, such as `materials.base_color`."""
    return jax.tree_util.keystr(path, simple=True, separator=".")


def matches(name: str, pattern: str) -> bool:
    """Whether `pattern` is a run of whole components of `name`: `vertices` and `mesh` both find `mesh.vertices`."""
    return f".{pattern}." in f".{name}."


def parameters(tree: Any, paths: Sequence[str]) -> tuple[Values, Callable[[Values], Any]]:
    """The float leaves that any of `paths` finds, by full name, and the function that puts such values back.

    A path that finds none is an error that names the nearest ones. Gradient: the identity both ways.

    Example:
        >>> from jaxraster.scene import Directional
        >>> lamp = Directional(direction=jnp.array([[0.0, -1.0, 0.0]]), irradiance=jnp.ones((1, 3)))
        >>> values, rebuild = parameters(lamp, ("irradiance",))
        >>> rebuild({"irradiance": 2.0 * values["irradiance"]}).irradiance.tolist()
        [[2.0, 2.0, 2.0]]
    """
    paths = (paths,) if isinstance(paths, str) else tuple(paths)
    leaves, treedef = jax.tree_util.tree_flatten_with_path(tree)
    names = [path_name(path) for path, _ in leaves]
    floats = [name for name, (_, leaf) in zip(names, leaves) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating)]
    for pattern in paths:
        if not any(matches(name, pattern) for name in floats):
            near = difflib.get_close_matches(pattern, floats, n=3, cutoff=0.3) or floats[:3]
            hint = f"did you mean {', '.join(near)}?" if near else "there is none at all"
            raise ValueError(f"parameters: no float leaf is named {pattern!r}; {hint}")
    chosen = {name for name in floats if any(matches(name, pattern) for pattern in paths)}
    values = {name: jnp.asarray(leaf) for name, (_, leaf) in zip(names, leaves) if name in chosen}

    def rebuild(values: Values) -> Any:
        if set(values) != chosen:
            raise ValueError(f"rebuild: expected values for {sorted(chosen)}, got {sorted(values)}")
        return treedef.unflatten(values.get(name, leaf) for name, (_, leaf) in zip(names, leaves))

    return values, rebuild
