"""Prepare a picture of all directions to light scenes, and keep the result where rendering finds it.

What is kept belongs to the bytes of the file, wherever it lies and whatever its name.
"""

import argparse
import time

from .arguments import add_limit
from .terminal import interruptible, progress, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `jaxraster prepare`."""
    parser.add_argument("environment", metavar="FILE", help="an equirectangular .hdr or .exr, twice as wide as high")
    parser.add_argument("--strict", action="store_true", help="refuse what would be put right")
    add_limit(parser, "read")


def run(arguments: argparse.Namespace) -> None:
    """Read, prepare, keep; say what was done, where it is, and how long it took."""
    from ..io.environment import prepare_environment
    from ..io.reading import Limits

    start = time.perf_counter()
    with interruptible():
        progress("preparing...")
        limits = Limits(**dict(arguments.limit))
        done = prepare_environment(arguments.environment, strict=arguments.strict, limits=limits)
    height, width, _ = done.map.texels.shape
    suns = done.map.suns.irradiance.shape[0]
    say(f"{arguments.environment}: {width} x {height} pixels, suns cut out to cast shadows: {suns}")
    say(f"wrote {done.path} ({done.size / 1e6:.1f} MB) in {time.perf_counter() - start:.1f} s")
