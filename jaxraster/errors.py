"""The typed errors that a user's file, disk or request can raise, each with the exit code of its kind.

One line says it all: `FILE: WHERE: what is wrong, with the numbers; what to do`. Programming mistakes at the API's
boundary (wrong rank, dtype or range of an argument) are plain `TypeError` and `ValueError` instead.
"""

import os

MOST_SHOWN = 400  # characters of a message: what a file holds may be quoted in it, and be of any length


def one_line(text: str) -> str:
    """The text with what no terminal should print escaped, cut where it gets long."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[:MOST_SHOWN])
    return shown + "..." * (len(text) > MOST_SHOWN)


class Error(Exception):
    """Base of all errors below; `code` is the command line's exit status."""

    code = 1

    def __init__(self, file: str | os.PathLike | None, where: str, message: str):
        self.file, self.where, self.message = file, one_line(where), one_line(message)
        super().__init__(": ".join(str(part) for part in (file, self.where, self.message) if part not in (None, "")))


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
