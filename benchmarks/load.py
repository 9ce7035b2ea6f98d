"""How long a file takes to load, with its pictures decoded and without: `python -m benchmarks.load FILE ...`."""

import argparse
import time
import warnings

import jax
import numpy as np

from jaxraster.io import gltf_texture, load


def seconds(file: str, runs: int) -> float:
    """The best of several runs: other work on the machine only ever slows one down."""
    best = float("inf")
    for _ in range(runs):
        began = time.perf_counter()
        jax.block_until_ready(load(file))
        best = min(best, time.perf_counter() - began)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", metavar="FILE")
    parser.add_argument("--runs", type=int, default=3)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    for file in arguments.files:
        whole = seconds(file, arguments.runs)
        # Stand a texel in for every picture: what is left is the file, its buffers and the mesh.
        decode = gltf_texture.read_image
        gltf_texture.read_image = lambda *_, **__: np.ones((1, 1, 4), np.float32)
        bare = seconds(file, arguments.runs)
        gltf_texture.read_image = decode
        print(f"{file}: {whole:.2f} s, without decoding pictures {bare:.2f} s")


if __name__ == "__main__":
    main()
