"""The one decorator: frozen, keyword-only records that are JAX pytrees.

Annotated fields are leaves (arrays, floats, other records, or None); fields made with `static(...)` belong to the
treedef, so that they key compilation and never trace.
"""

import dataclasses
from typing import Any, TypeVar, dataclass_transform

import jax
from jaxtyping import Array, Float

Scalar = float | Float[Array, "*b"]  # the type of a knob: a plain number, or an array to differentiate or batch
T = TypeVar("T")
_ALLOWED = (int, str, bool, type(None))


def static(default: Any = dataclasses.MISSING) -> Any:
    """A field of the treedef: an int, str, bool, None, or tuple of these. Changing it compiles anew."""
    return dataclasses.field(default=default, metadata={"static": True})


def is_static(field: dataclasses.Field) -> bool:
    """Whether a record's field belongs to the treedef."""
    return field.metadata.get("static", False)


def _strangers(value: Any) -> set[str]:
    """Names of the types in a static value that have no place there."""
    if isinstance(value, tuple):
        return {name for part in value for name in _strangers(part)}
    return set() if isinstance(value, _ALLOWED) else {type(value).__name__}


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(static,))
def record(cls: type[T]) -> type[T]:
    """Make `cls` a frozen keyword-only dataclass and a pytree.

    Rebuilding from leaves skips `__init__`, so that `jax.tree.map` may put anything (None, shapes, tracers) in a
    leaf's place. Static fields are checked at construction, because JAX itself notices an array there only on the
    second call. A plain int given for a leaf becomes a float: as an int it would retrace and break `grad`. A method
    `validate`, where the class has one, runs after that.

    Example:
        >>> @record
        ... class Fog:
        ...     density: float = 0.1
        ...     steps: int = static(default=16)
        >>> jax.tree.leaves(Fog(density=2))
        [2.0]
    """

    def check(self):
        for field in fields:
            value = getattr(self, field.name)
            if is_static(field):
                if strangers := _strangers(value):
                    raise TypeError(
                        f"{cls.__name__}.{field.name} is static: expected int, str, bool or a tuple of these, "
                        f"got {', '.join(sorted(strangers))}"
                    )
            elif field.type == Scalar and (value is None or isinstance(value, bool | str)):
                raise TypeError(f"{cls.__name__}.{field.name} must be a number, got {value!r}")
            elif type(value) is int:
                object.__setattr__(self, field.name, float(value))
        validate(self)

    def flatten(self):
        return [getattr(self, n) for n in leaves], tuple(getattr(self, n) for n in treedef)

    def flatten_with_keys(self):
        children, aux = flatten(self)
        return [(jax.tree_util.GetAttrKey(n), c) for n, c in zip(leaves, children, strict=True)], aux

    def unflatten(aux, children):
        self = object.__new__(cls)
        for name, value in (*zip(leaves, children), *zip(treedef, aux)):
            object.__setattr__(self, name, value)
        return self

    validate = getattr(cls, "validate", lambda self: None)
    cls.__post_init__ = check
    made: Any = dataclasses.dataclass(frozen=True, kw_only=True, eq=False)(cls)
    fields = dataclasses.fields(made)
    leaves = [f.name for f in fields if not is_static(f)]
    treedef = [f.name for f in fields if is_static(f)]
    jax.tree_util.register_pytree_with_keys(made, flatten_with_keys, unflatten, flatten)
    return made
