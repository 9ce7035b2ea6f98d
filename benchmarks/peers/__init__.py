"""Other rasterizers on the same clip positions; each file imports its library only when a peer is made.

A peer is a class. `Peer(clip, faces, size)` prepares all that need not be done again for each picture, and raises, in
one line, what it lacks or cannot draw. `name` is the program and its version, `draw()` draws one picture and waits for
it, `faces()` gives the ids it drew and `release()` lets go.
"""

import functools
import pathlib
from collections.abc import Callable

import numpy as np

from .deodr import Deodr
from .elsewhere import Elsewhere
from .jaxrenderer import JaxRenderer
from .mesa import Mesa
from .mitsuba import Mitsuba

# The first one present says what is right.
PEERS = {"Mesa": Mesa, "DEODR": Deodr, "Mitsuba": Mitsuba, "jaxrenderer": JaxRenderer}
NOT_INSTALLABLE = {
    "PyTorch3D": "PyPI has no build of it for this Python",
    "DRTK": "it has to be built from source; its name on PyPI is another project's",
}
TRIANGLE = np.array([[-1, -1, 0.5, 1], [1, -1, 0.5, 1], [0, 1, 0.5, 1]], np.float32)


def reason(error: Exception) -> str:
    """An error's first line, or its name."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def found(python312: pathlib.Path | None = None) -> tuple[dict[str, Callable], dict[str, str]]:
    """Who can draw a triangle, here or in another process under `python312`; and a line about everybody.

    The line is the version of those that can, and what the others lack.
    """
    present, lines = {}, {}
    for name, here in PEERS.items():
        elsewhere = [functools.partial(Elsewhere, python312, name)] if python312 else []
        for make in (here, *elsewhere):
            try:
                peer = make(TRIANGLE, np.array([[0, 1, 2]]), 8)
                peer.draw()
                peer.release()
                present[name], lines[name] = make, peer.name
                break
            except Exception as error:
                lines[name] = reason(error)
    return present, lines | NOT_INSTALLABLE
