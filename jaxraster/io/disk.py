"""Files as bytes: read whole or refused in one line, written whole or not at all."""

import contextlib
import os
import secrets
import stat
from collections.abc import Iterator

from ..errors import InputError, OutputError
from .reading import DEFAULT, Limits, exceed

Path = str | os.PathLike


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def read_file(path: Path, limits: Limits = DEFAULT) -> bytes:
    """The bytes of a regular file that is neither empty nor larger than the limit."""
    try:
        # Ask before opening: a pipe would wait for ever, and a device never end.
        status = os.stat(path)
        if stat.S_ISDIR(status.st_mode):
            raise InputError(path, "", "is a folder; name a file in it")
        if not stat.S_ISREG(status.st_mode):
            raise InputError(path, "", "is not a regular file; copy it to one")
        if status.st_size > limits.file_bytes:
            exceed("file_bytes", limits.file_bytes, path, "", f"has {status.st_size} bytes")
        with open(path, "rb") as file:
            data = file.read()
    except (OSError, ValueError) as error:
        raise InputError(path, "", f"cannot be read: {_reason(error)}; check the path and its permissions") from error
    if not data:
        raise InputError(path, "", "is empty; export or copy it again")
    return data


def suffix_of(path: Path) -> str:
    """The end of a file's name that tells its format, in lower case, with its dot."""
    return os.path.splitext(os.fspath(path))[1].lower()


def lies_beside(path: Path, file: Path) -> bool:
    """Whether a path, links followed, leads into the folder of a file or below, or of what that file is a link to."""
    real = os.path.realpath(path)
    folders = os.path.realpath(os.path.dirname(file)), os.path.dirname(os.path.realpath(file))
    return any(os.path.commonpath([folder, real]) == folder for folder in folders)


def _target(path: Path) -> str:
    """The file that `path` stands for, links followed; an `OSError` if no picture may take its place."""
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    if not os.path.isdir(folder):
        raise OSError(f"there is no folder {folder}; create it")
    with contextlib.suppress(FileNotFoundError):
        mode = os.stat(target).st_mode
        if stat.S_ISDIR(mode):
            raise OSError("it is a folder; add a file name")
        if not stat.S_ISREG(mode):
            raise OSError("it is not a regular file; choose another name")
        if not os.access(target, os.W_OK):
            raise OSError("the file is read-only; choose another name")
    return target


@contextlib.contextmanager
def _beside(path: Path) -> Iterator[tuple[str, str]]:
    """A path's target and a fresh name in the same folder that is gone afterwards; failures as `OutputError`."""
    temporary = None
    try:
        target = _target(path)
        temporary = os.path.join(os.path.dirname(target), f".{secrets.token_hex(8)}.tmp")
        yield target, temporary
    except (OSError, ValueError) as error:
        raise OutputError(path, "", f"cannot be written: {_reason(error)}") from error
    finally:
        if temporary:
            with contextlib.suppress(OSError):
                os.unlink(temporary)


def check_file(path: Path) -> None:
    """Raise the `OutputError` that writing would end in, as far as it can be known before: try it with no bytes."""
    with _beside(path) as (_, temporary), open(temporary, "xb"):
        pass


def write_file(path: Path, data: bytes) -> None:
    """Put `data` in the place of `path` in one step; on any failure what was there before is untouched.

    A link is followed, and a file that is replaced keeps its permissions. The bytes are on the disk before the name is,
    so that no power cut leaves half a file.
    """
    with _beside(path) as (target, temporary):
        with open(temporary, "xb") as file:
            # Set them before there is anything to read.
            with contextlib.suppress(FileNotFoundError):
                os.chmod(temporary, os.stat(target).st_mode & 0o777)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
        # Let the name, too, survive a power cut; the file is whole either way, so a folder that cannot is no failure.
        with contextlib.suppress(OSError):
            folder = os.open(os.path.dirname(target), os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
