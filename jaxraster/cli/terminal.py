"""What the user reads: results on stdout, warnings and progress on stderr. Nothing here ever stops a rendering."""

import os
import sys

_CLEAR_LINE = "\r\x1b[K"  # back to the first column, erase to the end of the line


def _write(stream, text: str) -> None:
    """Write and flush; a stream that can take no more (closed pipe, full disk) is silenced for good."""
    if stream is None:  # the process was started with this stream closed
        return
    try:
        stream.write(text)
        stream.flush()
    except UnicodeEncodeError:
        stream.write(text.encode("ascii", "replace").decode())
    except OSError:
        # Send the rest nowhere, or the interpreter would complain about unflushed text at its exit.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def progress(text: str = "") -> None:
    """Show what is being done on one line that rewrites itself; only where someone watches. Empty text clears it."""
    if sys.stderr is not None and sys.stderr.isatty():
        _write(sys.stderr, _CLEAR_LINE + text)


def say(text: str) -> None:
    """A line of the result, on stdout."""
    progress()
    _write(sys.stdout, f"{text}\n")


def complain(kind: str, message: object) -> None:
    """`jaxraster: kind: message` on stderr, always one line."""
    progress()
    _write(sys.stderr, f"jaxraster: {kind}: {' '.join(str(message).split())}\n")
