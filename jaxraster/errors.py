"""The typed errors that a user's file, disk or request can raise, each with the exit code of its kind.

One line says it all: `FILE: WHERE: what is wrong, with the numbers; what to do`. Programming mistakes at the API's
boundary (wrong rank, dtype or range of an argument) are plain `TypeError` and `ValueError` instead.
"""

import os


class Error(Exception):
    """Base of all errors below; `code` is the command line's exit status."""

    code = 1

    def __init__(self, file: str | os.PathLike | None, where: str, message: str):
        self.file, self.where, self.message = file, where, message
        super().__init__(": ".join(str(part) for part in (file, where, message) if part not in (None, "")))


class UsageError(Error):
    """A request that cannot be understood: an unknown option, a size of zero."""

    code = 2


class InputError(Error):
    """A file that is missing, broken, or asks for what is not supported."""

    code = 3


class OutputError(Error):
    """A result that cannot be written where it was asked for."""

    code = 4


class LimitError(Error):
    """A file or request larger than the limits of this program or this machine."""

    code = 5


class AssetWarning(UserWarning):
    """Something in a file is left out or put right: the picture differs from what its author saw."""
