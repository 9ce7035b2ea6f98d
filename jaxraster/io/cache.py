"""Prepared surroundings on the user's disk, so that a picture of all directions is prepared once.

A file is named by the hash of all that it is made from: the bytes of the picture, and the sources that prepare it. What
is out of date is never found, and nothing is ever put right in place.
"""

import hashlib
import io
import os
import pathlib
import sys
import zipfile
from collections.abc import Mapping
from importlib import resources

import numpy as np
from jaxtyping import Shaped

from ..errors import OutputError
from .disk import write_file

Arrays = Mapping[str, Shaped[np.ndarray, "..."]]
MAKERS = ("environment", "io", "math")  # the packages whose sources say what is in a prepared file


def cache_folder() -> pathlib.Path:
    """Where this system keeps what programs can make again: XDG_CACHE_HOME, or its own convention."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG base directory specification has relative paths ignored.
    if os.path.isabs(given):
        return pathlib.Path(given) / "jaxraster"
    # Where a user has no home, as in some containers, this stays "~", where nothing is found.
    home = pathlib.Path(os.path.expanduser("~"))
    conventions = {"darwin": home / "Library" / "Caches", "win32": os.environ.get("LOCALAPPDATA", home)}
    return pathlib.Path(conventions.get(sys.platform, home / ".cache")) / "jaxraster"


def cached_path(content: bytes, *options: object) -> pathlib.Path:
    """Where what is made of a file's bytes with some options is kept, whether or not it is there."""
    digest = hashlib.sha256(content)
    digest.update(repr(options).encode())
    package = __name__.split(".")[0]
    for maker in MAKERS:
        sources = (one for one in resources.files(f"{package}.{maker}").iterdir() if one.name.endswith(".py"))
        for source in sorted(sources, key=lambda one: one.name):
            digest.update(source.read_bytes())
    return cache_folder() / f"{digest.hexdigest()}.npz"


def store(path: pathlib.Path, arrays: Arrays) -> int:
    """Put arrays there, whole or not at all, and return how many bytes they take."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(path.parent, "", f"cannot be made: {error.strerror}; set XDG_CACHE_HOME") from error
    if path.is_dir():
        raise OutputError(path, "", "is a folder, where a file is to be kept; remove it")
    write_file(path, buffer.getvalue())
    return buffer.tell()


def _array(archive: zipfile.ZipFile, name: str) -> Shaped[np.ndarray, "..."]:
    with archive.open(name) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def fetch(path: pathlib.Path) -> Arrays | None:
    """The arrays that were put there, or None for nothing; a `ValueError` for what is damaged."""
    try:
        if not path.is_file():
            return None
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy"): _array(archive, name) for name in archive.namelist()}
    # Whatever lies there can be made again, and broken archives raise errors of a dozen kinds.
    except Exception as error:
        raise ValueError(str(error) or type(error).__name__) from error
