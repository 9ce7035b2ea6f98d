"""glTF accessors: typed, strided, possibly sparse arrays in the bytes of a buffer.

Source: Khronos Group, "glTF 2.0 Specification", 2021, section 3.6.2.
"""

import numpy as np
from jaxtyping import Float32, Shaped

from .gltf_container import Document, read_buffer
from .pointer import Json, fail, integer, member, reference, table

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def read_view(document: Document, at: Json) -> tuple[memoryview, int | None]:
    """The bytes of the buffer view that `at` names, and its stride if it states one."""
    view = reference(at, "bufferView", document.views) or fail(at, "bufferView is missing")
    data = read_buffer(document, reference(view, "buffer", document.buffers) or fail(view, "buffer is missing"))
    start, length = integer(view, "byteOffset", 0), integer(view, "byteLength", low=1)
    if start + length > len(data):
        fail(view, f"ends at byte {start + length} of a buffer of {len(data)}; the file may be damaged")
    stride = integer(view, "byteStride", low=1) if "byteStride" in view.value else None
    return data[start : start + length], stride


def _elements(document: Document, at: Json, count: int, dtype: np.dtype, size: int) -> Shaped[np.ndarray, "n c"]:
    """`count` elements of `size` components from the buffer view that `at` names."""
    data, stride = read_view(document, at)
    element = dtype.itemsize * size
    stride = stride or element
    if stride < element:
        fail(at, f"its view's byteStride is {stride}, less than an element's {element} bytes; the file may be damaged")
    start = integer(at, "byteOffset", 0)
    if (end := start + (count - 1) * stride + element) > len(data):
        fail(at, f"needs {end} bytes of its view, which has {len(data)}; the file may be damaged")
    return np.ndarray((count, size), dtype, data, start, (stride, dtype.itemsize))


def read_accessor(document: Document, accessor: Json) -> Shaped[np.ndarray, "n c"]:
    """An accessor's elements as they are stored; those without data are zeros."""
    kind, component = member(accessor, "type", str), member(accessor, "componentType", int)
    if kind.value not in _SIZES:
        fail(kind, f"is {kind.value[:20]!r}, but only {', '.join(_SIZES)} are supported")
    if component.value not in _COMPONENTS:
        fail(component, f"is {component.value}, not one of {', '.join(map(str, _COMPONENTS))}")
    dtype, size, count = np.dtype(_COMPONENTS[component.value]), _SIZES[kind.value], integer(accessor, "count", low=1)
    if "bufferView" in accessor.value:
        values = _elements(document, accessor, count, dtype, size)
    else:
        claimed = count * size * dtype.itemsize
        document.reading.count("claimed_bytes", claimed, accessor.file, accessor.where, "what it claims without data")
        values = np.zeros((count, size), dtype)
    if "sparse" not in accessor.value:
        return values
    # Put the few elements that differ over those of the view.
    sparse = table(accessor, "sparse")
    changed, where, what = integer(sparse, "count", low=1), table(sparse, "indices"), table(sparse, "values")
    component = member(where, "componentType", int)
    if component.value not in (5121, 5123, 5125):
        fail(component, f"is {component.value}, not one of 5121, 5123, 5125")
    places = _elements(document, where, changed, np.dtype(_COMPONENTS[component.value]), 1)[:, 0]
    if places.max() >= count:
        fail(where, f"index {places.max()} but only {count} elements; the file may be damaged")
    values = values.copy()
    values[places] = _elements(document, what, changed, dtype, size)
    return values


def read_floats(document: Document, accessor: Json, *sizes: int) -> Float32[np.ndarray, "n c"]:
    """An accessor of one of these numbers of components as floats, integers normalized where it says so."""
    values = read_accessor(document, accessor)
    if values.shape[1] not in sizes:
        fail(accessor, f"has {values.shape[1]} components, but {' or '.join(map(str, sizes))} are needed")
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    integers = values.astype(np.float32)
    if not member(accessor, "normalized", bool, False).value:
        return integers
    # The lowest signed code stands for -1, like the one above it, so that zero has a code.
    return np.maximum(integers / np.float32(np.iinfo(values.dtype).max), np.float32(-1))
