"""Arguments held against their annotations, when a call is traced and in one line.

What the records and functions document as shapes is what they check: `Float[Array, "*b v 3"]` demands a float array
whose last axis is 3, whose axis before it is `v` wherever else that name stands, and which may have leading axes.
Gradient: not touched.
"""

import dataclasses
import typing
from typing import Any

import jax
import numpy as np

HALF = ("float16", "bfloat16")  # too coarse for positions, and mixed with others in loops that keep their type


def _wanted(annotation: Any, sizes: dict[str, int], batched: bool) -> str:
    """The annotation in words: `float [..., v, 3] with v = 8`."""
    axes = ["..." if axis.startswith("*") else axis for axis in annotation.dim_str.split()]
    axes = [axis for axis in axes if batched or axis != "..."]
    known = ", ".join(f"{axis} = {sizes[axis]}" for axis in axes if axis in sizes)
    return f"{annotation.dtype.__name__.lower()} [{', '.join(axes)}]" + (f" with {known}" if known else "")


def fit(where: str, value: Any, annotation: Any, sizes: dict[str, int] | None = None, *, batched: bool = True) -> None:
    """Raise unless `value` is an array of the annotation's dtype and shape.

    `where` names function and argument. Named axes are bound in `sizes` for all calls that share it. Unless `batched`,
    leading axes are refused. A wrong type or dtype is a `TypeError`, a wrong shape a `ValueError`.
    """
    sizes = {} if sizes is None else sizes
    wanted = f"{where} must be {_wanted(annotation, sizes, batched)}"
    if not hasattr(value, "dtype") or not hasattr(value, "shape"):
        raise TypeError(f"{wanted}, got {type(value).__name__}; make it an array")
    got = f"got {value.dtype} {list(value.shape)}"
    if str(value.dtype) in HALF:
        raise TypeError(f"{where} must be float32 or float64, {got}")
    # An index is an index, signed or not.
    if str(value.dtype).removeprefix("u") not in annotation.dtypes:
        raise TypeError(f"{wanted}, {got}")
    axes = [axis for axis in annotation.dim_str.split() if not axis.startswith("*")]
    extra = len(value.shape) - len(axes)
    shape = value.shape[max(extra, 0) :]
    fits = all(size == (int(axis) if axis.isdigit() else sizes.get(axis, size)) for axis, size in zip(axes, shape))
    if extra > 0 and fits and batched and "*" not in annotation.dim_str:
        raise ValueError(f"{wanted}, {got}; a batch shares it: stack float leaves alone")
    if extra > 0 and fits and not batched:
        raise ValueError(f"{wanted}, {got}; map over a batch with jax.vmap")
    if extra < 0 or not fits:
        raise ValueError(f"{wanted}, {got}")
    sizes.update({axis: size for axis, size in zip(axes, shape) if not axis.isdigit()})


def fit_record(where: str, value: Any, kind: type, *, batched: bool = False) -> None:
    """Raise unless `value` is a record of this kind and every array in it fits its annotation."""
    if not isinstance(value, kind):
        raise TypeError(f"{where} must be a {kind.__name__}, got {type(value).__name__}")
    sizes: dict[str, int] = {}
    for field in dataclasses.fields(value):
        name, part = f"{where}.{field.name}", getattr(value, field.name)
        optional = typing.get_args(field.type)
        annotation: Any = optional[0] if optional else field.type
        if optional and part is None:
            continue
        if dataclasses.is_dataclass(annotation):
            fit_record(name, part, annotation, batched=batched)
        else:
            fit(name, part, annotation, sizes, batched=batched)


def fit_knobs(where: str, record: Any, kind: type) -> None:
    """Raise unless `record` is of this kind and each of its leaves is one number."""
    if not isinstance(record, kind):
        raise TypeError(f"{where} must be a {kind.__name__}, got {type(record).__name__}")
    for path, leaf in jax.tree_util.tree_leaves_with_path(record):
        if shape := list(np.shape(leaf)):
            name = f"{where}{jax.tree_util.keystr(path)}"
            raise ValueError(f"{name} must be one number, got {shape}; map over a batch with jax.vmap")


def below(where: str, indices: Any, count: int, of: str, *, least: int = 0) -> None:
    """Raise `ValueError` for an index outside of [least, count), where the values are known already."""
    if isinstance(indices, jax.core.Tracer) or indices.size == 0:
        return
    indices = np.asarray(indices)
    low, high = int(indices.min()), int(indices.max())
    if low < least or high >= count:
        worst = high if high >= count else low
        raise ValueError(f"{where} holds {worst}, but there are {count} {of}, counted from 0")
