"""What a reader of hostile files may do: answer within two seconds and 512 MB, and touch its own folder alone."""

import contextlib
import os
import pathlib
import resource
import sys
import time

SECONDS, MEGABYTES = 2.0, 512
WAITING = 10.0  # times as long as it computes may an answer take, on a machine with other things to do
_ALLOWED = tuple(os.path.realpath(p) for p in {sys.prefix, sys.base_prefix, pathlib.Path(__file__).parents[1]})
_ALLOWED += ("/dev/null", "/usr/lib", "/usr/share", "/proc", "/sys", "/etc/ld.so.cache", "/lib")
_watching: list[tuple[str, list[str]]] = []


def _hook(event: str, arguments: tuple) -> None:
    if not _watching or event not in ("open", "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.symlink"):
        return
    folder, touched = _watching[-1]
    for path in arguments[: 2 if event in ("os.rename", "os.symlink") else 1]:
        if isinstance(path, int | None):
            continue
        real = os.path.realpath(os.fsdecode(path))
        writes = event != "open" or (
            len(arguments) > 2 and (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        )
        if not real.startswith(folder) and (writes or not real.startswith(_ALLOWED)):
            touched.append(f"{event} {real}")


sys.addaudithook(_hook)


@contextlib.contextmanager
def watched(folder):
    """Fail if what happens inside takes too long or too much, or opens or changes a file outside of the folder."""
    touched: list[str] = []
    _watching.append((os.path.realpath(folder), touched))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began, computed = time.perf_counter(), time.process_time()
    try:
        yield
    finally:
        _watching.pop()
    computed, seconds = time.process_time() - computed, time.perf_counter() - began
    megabytes = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024
    assert touched == []
    assert megabytes <= MEGABYTES, f"took {megabytes:.0f} MB"
    assert computed <= SECONDS, f"computed for {computed:.1f} s"
    assert seconds <= WAITING * SECONDS, f"took {seconds:.1f} s"
