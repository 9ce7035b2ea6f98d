"""The outside of a glTF 2.0 file: JSON or GLB, and the buffers and images it refers to.

Only data inside the file and files beside or below it are read, never the network.
Source: Khronos Group, "glTF 2.0 Specification", 2021, sections 2, 3.6.1 and 4.
"""

import base64
import binascii
import os
import pathlib
import re
import struct
import urllib.parse
from typing import NamedTuple

from ..errors import InputError
from .disk import Path, lies_beside, read_file
from .pointer import Json, fail, integer, member, parse, rows, strings, table
from .reading import Limits, Reading

_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class Document(NamedTuple):
    """A parsed glTF file and how it is read, the folder its names are relative to, its binary chunk, and its parts."""

    root: Json
    reading: Reading
    folder: pathlib.Path
    chunk: bytes | None
    buffers: list[Json]
    views: list[Json]
    accessors: list[Json]
    read: dict[str, memoryview]  # what has been fetched, by URI or place


def _split_glb(data: bytes, file: str, reading: Reading) -> tuple[bytes, bytes | None]:
    """The JSON of a GLB file, and its binary chunk if it has one."""
    if len(data) < 20:
        raise InputError(file, "header", f"a GLB has at least 20 bytes, this one {len(data)}; it is cut off")
    magic, version, length = struct.unpack_from("<4sII", data)
    if magic != b"glTF":
        raise InputError(file, "header", f"a GLB begins with b'glTF', this one with {magic!r}; check the file's type")
    if version != 2:
        raise InputError(file, "header", f"is GLB version {version}, but only 2 is supported; export it as glTF 2.0")
    if not 20 <= length <= len(data):
        raise InputError(file, "header", f"says {length} bytes, the file has {len(data)}; it is cut off or damaged")
    if length < len(data):
        reading.mend(file, "header", f"{len(data) - length} bytes after the end are ignored")
    chunks, offset = [], 12
    while offset + 8 <= length:
        size, kind = struct.unpack_from("<II", data, offset)
        if offset + 8 + size > length:
            left = length - offset - 8
            raise InputError(file, f"chunk {len(chunks)}", f"says {size} bytes, but {left} are left; it is damaged")
        chunks.append((kind, data[offset + 8 : offset + 8 + size]))
        offset += 8 + size
    if not chunks or chunks[0][0] != _JSON_CHUNK:
        raise InputError(file, "chunk 0", "is not the JSON every GLB begins with; it is damaged")
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == _BINARY_CHUNK else None
    return chunks[0][1], binary


def read_uri(at: Json, folder: pathlib.Path, limits: Limits) -> bytes:
    """The bytes behind a URI: data in place, or a file in the document's folder or below."""
    uri = at.value
    if uri[:5].lower() == "data:":
        header, comma, payload = uri.partition(",")
        if not comma:
            fail(at, "is a data URI without a comma; export it again")
        try:
            payload = urllib.parse.unquote_to_bytes(payload)
            return base64.b64decode(payload, validate=True) if header.lower().endswith(";base64") else payload
        except (binascii.Error, ValueError) as error:
            fail(at, f"is not valid base64 ({error}); export it again")
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", uri):
        fail(at, f"{uri[:60]} is not a relative file name; only files beside this one are read")
    name = os.path.normpath(urllib.parse.unquote(uri))
    outside = os.path.isabs(name) or name.split(os.sep)[0] == os.pardir
    if outside or "\0" in name or not lies_beside(folder / name, at.file):
        fail(at, f"{uri[:60]} lies outside the file's folder; move it beside this file")
    try:
        return read_file(folder / name, limits)
    except InputError as error:
        fail(at, f"{uri[:60]} {error.message}")


def read_buffer(document: Document, at: Json) -> memoryview:
    """The bytes of a buffer, fetched when they are first asked for; a file that many buffers name is read once."""
    if at.where in document.read:
        return document.read[at.where]
    length, reading = integer(at, "byteLength", low=1), document.reading
    if "uri" in at.value:
        uri = member(at, "uri", str)
        if uri.value not in document.read:
            fetched = read_uri(uri, document.folder, reading.limits)
            reading.count("file_bytes", len(fetched), at.file, uri.where, "bytes of all buffers")
            document.read[uri.value] = memoryview(fetched)
        data = document.read[uri.value]
    elif document.chunk is not None and at.where == "/buffers/0":
        data = memoryview(document.chunk)
    else:
        fail(at, "has no uri, and there is no binary chunk to hold it; export it again")
    if len(data) < length:
        fail(at, f"byteLength is {length}, but only {len(data)} bytes are there; the data may be cut off")
    document.read[at.where] = data[:length]
    return document.read[at.where]


def read_document(path: Path, supported: frozenset[str], reading: Reading) -> Document:
    """Parse a .gltf or .glb file; refuse one that requires more than the extensions supported."""
    file, data = os.fspath(path), read_file(path, reading.limits)
    is_glb = data[:4] == b"glTF" or file.lower().endswith(".glb")
    text, chunk = _split_glb(data, file, reading) if is_glb else (data, None)
    root = parse(text, file)
    asset = table(root, "asset")
    version = member(asset, "minVersion" if "minVersion" in asset.value else "version", str)
    if version.value != "2.0" and not (version.where.endswith("/version") and version.value.startswith("2.")):
        fail(version, f"is {version.value[:20]!r}, but only glTF 2.0 is supported; export it as such")
    for extension in strings(root, "extensionsRequired"):
        if extension not in supported:
            fail(root, f"requires {extension}, which is not supported; export it without")
    folder = pathlib.Path(file).parent
    buffers, views, accessors = (rows(root, key) for key in ("buffers", "bufferViews", "accessors"))
    return Document(root, reading, folder, chunk, buffers, views, accessors, {})
