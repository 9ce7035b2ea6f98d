"""The rasterizer beside others: `python -m benchmarks.visibility [--sizes 256,512,1024] [--helmet FILE]`.

Milliseconds from clip positions to face, barycentrics and depth, the fastest of several runs, taken in turns so that
other work on the machine slows all alike; and on how many pixels two programs see different faces.
"""

import argparse
import math
import pathlib
import time

import jax
import numpy as np

import jaxraster as jr

from .peers.mesa import Mesa
from .workloads import WORKLOADS, file


def turns(functions: dict, runs: int) -> dict[str, float]:
    """The fastest of several runs of each function, in turns, in milliseconds."""
    best = dict.fromkeys(functions, math.inf)
    for _ in range(runs):
        for name, function in functions.items():
            began = time.perf_counter()
            function()
            best[name] = min(best[name], 1e3 * (time.perf_counter() - began))
    return best


def compare(clip: np.ndarray, faces: np.ndarray, size: int, runs: int, peer: bool) -> dict[str, float]:
    """Compile seconds, milliseconds of both, MiB beyond inputs and outputs, and the share of pixels that differ."""
    clip_device, faces_device = jax.device_put((clip, faces))
    began = time.perf_counter()
    compiled = (
        jax.jit(lambda c, f: jr.rasterize(c, f, height=size, width=size)).lower(clip_device, faces_device).compile()
    )
    row = {"compile": time.perf_counter() - began, "memory": compiled.memory_analysis().temp_size_in_bytes / 2**20}
    seen = jax.block_until_ready(compiled(clip_device, faces_device))
    functions = {"ours": lambda: jax.block_until_ready(compiled(clip_device, faces_device))}
    if peer:
        mesa = Mesa(clip, faces, size)
        functions["mesa"] = mesa.draw
        mesa.draw()
        row["differ"] = float(np.mean(mesa.faces() != np.asarray(seen.face)))
    row |= turns(functions, runs)
    if peer:
        mesa.release()
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="256,512,1024")
    parser.add_argument("--helmet", type=pathlib.Path, help="a large file of the field, as W4")
    parser.add_argument("--runs", type=int, default=7)
    options = parser.parse_args()
    workloads = WORKLOADS | ({f"W4 {options.helmet.stem}": file(options.helmet)} if options.helmet else {})
    try:
        Mesa(np.zeros((3, 4), np.float32), np.array([[0, 1, 2]]), 8).release()
        peer = True
    except Exception as error:
        print(f"Mesa is absent: {error}")
        peer = False
    ratios = []
    print(f"{'workload':36} {'size':>5} {'compile':>8} {'MiB':>6} {'ours':>9} {'Mesa':>9} {'ratio':>6} {'differ':>8}")
    for name in sorted(workloads):
        for size in map(int, options.sizes.split(",")):
            row = compare(*workloads[name](size), size, options.runs, peer)
            line = f"{name:36} {size:5} {row['compile']:6.1f} s {row['memory']:6.1f} {row['ours']:6.1f} ms"
            if peer:
                ratios.append(row["mesa"] / row["ours"])
                line += f" {row['mesa']:6.1f} ms {ratios[-1]:6.2f} {100 * row['differ']:6.2f} %"
            print(line, flush=True)
    if ratios:
        print(f"geometric mean of Mesa / ours: {math.exp(np.mean(np.log(ratios))):.2f}")


if __name__ == "__main__":
    main()
