"""One workload at one size: what it costs here, what it costs the peers, and whether all see the same."""

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

import jaxraster as jr

from .calibration import INPUTS, calibration
from .peers import reason
from .workloads import Workload

REST = 0.05  # seconds between programs: the workers of some keep a core busy for a while after they have returned
PATIENCE_MS = 10_000.0  # no more runs of what has had this long: of runs so long, two or three differ little


class Row(NamedTuple):
    """A line of the table; times in milliseconds."""

    workload: str
    size: int  # px, of a side
    compile: float
    steady: float
    calibration: float
    memory: int  # bytes at the peak, beyond inputs and outputs
    peers: dict[str, float]  # of those that could draw it
    differ: float | None  # the share of pixels where the first of these peers sees another face


def turns(functions: dict[str, Callable], runs: int) -> dict[str, float]:
    """The fastest of several runs of each function, in milliseconds.

    They take turns, so that other work on the machine slows all alike. Call each once before: a first run may compile.
    """
    best, spent = dict.fromkeys(functions, math.inf), dict.fromkeys(functions, 0.0)
    for _ in range(runs):
        for name, function in functions.items():
            if spent[name] > PATIENCE_MS:
                continue
            time.sleep(REST)
            began = time.perf_counter()
            function()
            taken = 1e3 * (time.perf_counter() - began)
            best[name] = min(best[name], taken)
            spent[name] += taken
    return best


def _drawn(visibility: jr.Visibility) -> tuple:
    """What the peers draw, too."""
    return visibility.face, visibility.barycentric, visibility.depth


def measure(name: str, workload: Workload, size: int, peers: dict[str, Callable], runs: int) -> Row:
    """Compile and draw the workload here, and have it drawn by those peers that can; prints why the others cannot."""
    inputs, fixed = jax.device_put((tuple(workload), INPUTS))
    began = time.perf_counter()
    compiled = jax.jit(lambda c, f: _drawn(jr.rasterize(c, f, height=size, width=size))).lower(*inputs).compile()
    compile_ms = 1e3 * (time.perf_counter() - began)
    face = np.asarray(compiled(*inputs)[0])
    jax.block_until_ready(calibration(*fixed))

    ready = {}
    for peer, make in peers.items():
        try:
            one = make(workload.clip, workload.faces, size)
            one.draw()
            ready[peer] = one
        except Exception as error:
            print(f"{peer} does not draw {name} at {size} px: {reason(error)}")
    times = turns(
        {
            "calibration": lambda: jax.block_until_ready(calibration(*fixed)),
            "steady": lambda: jax.block_until_ready(compiled(*inputs)),
            **{peer: one.draw for peer, one in ready.items()},
        },
        runs,
    )
    seen = [one.faces() for one in ready.values()]
    for one in ready.values():
        one.release()
    return Row(
        workload=name,
        size=size,
        compile=compile_ms,
        calibration=times.pop("calibration"),
        steady=times.pop("steady"),
        memory=compiled.memory_analysis().temp_size_in_bytes,
        peers=times,
        differ=float(np.mean(seen[0] != face)) if seen else None,
    )
