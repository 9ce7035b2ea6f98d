"""Between program and user: results on stdout, warnings and progress on stderr, Ctrl-C. Output stops no rendering."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator

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


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C end the process at once, as the shell expects, where there is nothing to clean up.

    Python's own way is to finish the compiler's call first, which takes seconds, and JAX may then crash at exit.
    """
    before = signal.getsignal(signal.SIGINT)
    ours = before is signal.default_int_handler and threading.current_thread() is threading.main_thread()
    if ours:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)
