"""Keep what is freed: memory stays with the process, as a GPU's and Mesa's buffers do.

Otherwise glibc hands freed megabytes back to the system, or not, by rules that follow what was freed before; and a call
that has to ask for them anew spends up to half of its time on page faults. Users have the same by the variables
MALLOC_TRIM_THRESHOLD_ and MALLOC_MMAP_THRESHOLD_.
"""

import contextlib
import ctypes

# Of glibc's malloc.h: sizes in bytes from which on memory goes back when freed, and is asked from the system alone.
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
MOST = 2**31 - 1


def keep() -> bool:
    """Whether this system's library could be told so."""
    with contextlib.suppress(OSError, AttributeError):
        tell = ctypes.CDLL(None).mallopt
        return all(tell(threshold, MOST) for threshold in (TRIM_THRESHOLD, MMAP_THRESHOLD))
    return False
