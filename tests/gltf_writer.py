"""A tiny glTF exporter for tests: plain dicts and NumPy arrays in, .gltf with files or data URIs, or .glb, out.

A document is the glTF's own JSON as a dict, plus the bytes of its one buffer under "bytes".
"""

import base64
import json
import pathlib
import struct
import zlib

import numpy as np

COMPONENT = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


def new() -> dict:
    return {"asset": {"version": "2.0"}, "bytes": bytearray()}


def put(gltf: dict, key: str, item: dict) -> int:
    """Append to one of the document's arrays; the new item's index."""
    gltf.setdefault(key, []).append(item)
    return len(gltf[key]) - 1


def view(gltf: dict, data: bytes, **members) -> int:
    """A buffer view of new bytes, aligned to 4."""
    gltf["bytes"] += b"\0" * (-len(gltf["bytes"]) % 4)
    start = len(gltf["bytes"])
    gltf["bytes"] += data
    return put(gltf, "bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data), **members})


def accessor(gltf: dict, array: np.ndarray, **members) -> int:
    """An accessor of `[n]` or `[n, c]`, in a view of its own unless `members` name one."""
    item = {"componentType": COMPONENT[array.dtype.name], "count": len(array), "type": KIND[array[0].size]}
    if "bufferView" not in members:
        members["bufferView"] = view(gltf, array.astype(array.dtype.newbyteorder("<")).tobytes())
    return put(gltf, "accessors", item | members)


def interleave(gltf: dict, **arrays: np.ndarray) -> dict[str, int]:
    """Attributes side by side in one view, and 8 bytes that belong to none between vertices."""
    columns = [np.ascontiguousarray(a).view(np.uint8).reshape(len(a), -1) for a in arrays.values()]
    table = np.concatenate([*columns, np.full((len(columns[0]), 8), 0xAB, np.uint8)], axis=1)
    shared = view(gltf, table.tobytes(), byteStride=table.shape[1])
    offsets = np.cumsum([0, *(c.shape[1] for c in columns)]).tolist()
    return {
        name: accessor(gltf, array, bufferView=shared, byteOffset=offset)
        for (name, array), offset in zip(arrays.items(), offsets)
    }


def mesh(gltf: dict, indices: np.ndarray | None = None, primitive: dict | None = None, **arrays: np.ndarray) -> int:
    """A mesh of one primitive with the given attributes."""
    item = {"attributes": {name: accessor(gltf, array) for name, array in arrays.items()}}
    if indices is not None:
        item["indices"] = accessor(gltf, indices)
    return put(gltf, "meshes", {"primitives": [item | (primitive or {})]})


def node(gltf: dict, **members) -> int:
    return put(gltf, "nodes", members)


def png(pixels: np.ndarray) -> bytes:
    """An unfiltered PNG of uint8 `[h, w, 3]` or `[h, w, 4]`."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    height, width, channels = pixels.shape
    header = struct.pack(">IIBBBBB", width, height, 8, {3: 2, 4: 6}[channels], 0, 0, 0)
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def data_uri(data: bytes, kind: str = "application/octet-stream") -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def glb(text: bytes, binary: bytes) -> bytes:
    """The GLB container around JSON and binary data."""
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def write(gltf: dict, path: pathlib.Path, container: str = "glb") -> pathlib.Path:
    """Write a document as "files" (.gltf and .bin), "data" (.gltf with a data URI) or "glb"; the path written."""
    document = {key: value for key, value in gltf.items() if key != "bytes"}
    binary = bytes(gltf["bytes"])
    if binary and "buffers" not in document:
        document["buffers"] = [{"byteLength": len(binary)}]
        if container == "files":
            path.with_suffix(".bin").write_bytes(binary)
            document["buffers"][0]["uri"] = path.with_suffix(".bin").name
        if container == "data":
            document["buffers"][0]["uri"] = data_uri(binary)
    text = json.dumps(document).encode()
    path = path.with_suffix(".glb" if container == "glb" else ".gltf")
    path.write_bytes(glb(text, binary) if container == "glb" else text)
    return path
