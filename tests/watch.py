"""What a reader of hostile files may do: answer within two seconds and 512 MB, and touch its own folder alone."""

import contextlib
import os
import pathlib
import resource
import sys
import time

SECONDS, MEGABYTES = 2.0, 512
# The type checker of these tests, imports on first use and other work on the same core may more than double an answer.
SLACK = 2.5
SOON = SLACK * SECONDS
WAITING = 10.0  # times as long as it computes may an answer take, on a machine with other things to do
_ALLOWED = [os.path.realpath(p) for p in {sys.prefix, sys.base_prefix, pathlib.Path(__file__).parents[1]}]
_ALLOWED += ["/usr/lib", "/usr/lib64", "/usr/share", "/proc", "/sys", "/etc/ld.so.cache", "/lib", "/lib64"]
# How many of an event's first arguments are paths; all events but "open" change what is there.
_NUM_PATHS = {"open": 1, "os.rename": 2, "os.symlink": 2, "os.link": 2}
_NUM_PATHS |= dict.fromkeys(("os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.chmod", "os.chown", "os.utime"), 1)
_NUM_PATHS |= dict.fromkeys(("shutil.copyfile", "shutil.copymode", "shutil.copystat", "shutil.copytree"), 2)
_NUM_PATHS |= {"shutil.move": 2, "shutil.unpack_archive": 2, "shutil.make_archive": 1, "shutil.rmtree": 1}
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_watching: list[tuple[str, list[str]]] = []


def _lies_in(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


def _hook(event: str, arguments: tuple) -> None:
    if not _watching:
        return
    folder, touched = _watching[-1]
    if event in ("socket.connect", "socket.sendto"):
        touched.append(f"{event} {arguments[1]}")
    writes = event != "open" or bool((arguments[2] or 0) & _WRITES)
    for path in arguments[: _NUM_PATHS.get(event, 0)]:
        # A number stands for a file that was opened before.
        if isinstance(path, int | None):
            continue
        real = os.path.realpath(os.fsdecode(path))
        if real == os.devnull or _lies_in(real, folder):
            continue
        if writes or not any(_lies_in(real, allowed) for allowed in _ALLOWED):
            touched.append(f"{event} {real}")


sys.addaudithook(_hook)


def _forget_peak() -> None:
    """Let the peak of memory be what is in use now, where the system can do so."""
    with contextlib.suppress(OSError):
        pathlib.Path("/proc/self/clear_refs").write_text("5")


def _peak() -> float:
    """The most memory in use so far, in megabytes: since `_forget_peak`, or without /proc since the process began."""
    try:
        status = pathlib.Path("/proc/self/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0]) / 1024
    except (OSError, IndexError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@contextlib.contextmanager
def watched(folder):
    """Fail if what happens inside takes too long or too much, connects, or opens or changes a file elsewhere."""
    touched: list[str] = []
    _forget_peak()
    memory = _peak()
    _watching.append((os.path.realpath(folder), touched))
    began, computed = time.perf_counter(), time.process_time()
    try:
        yield
    finally:
        _watching.pop()
    computed, seconds = time.process_time() - computed, time.perf_counter() - began
    megabytes = _peak() - memory
    assert not touched, f"touched {touched}"
    assert megabytes <= MEGABYTES, f"took {megabytes:.0f} MB"
    assert computed <= SLACK * SECONDS, f"computed for {computed:.1f} s"
    assert seconds <= WAITING * SECONDS, f"took {seconds:.1f} s"
