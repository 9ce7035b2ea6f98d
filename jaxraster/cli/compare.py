"""Compare two pictures: how far one is from the other, and where.

PNG, JPEG and WebP hold display codes, which are compared as they are; HDR and EXR hold light.
"""

import argparse
import os
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..errors import InputError, OutputError, UsageError
from .arguments import add_limit, between, choose
from .terminal import complain, interruptible, progress, say

LIGHT = (".hdr", ".pic", ".exr")


class Metric(NamedTuple):
    """`text` words its value. `error` makes errors from 0 to 1 of its map, and `one` says what 1 is. `light`: whether
    it can compare light, which has no white."""

    name: str
    text: str
    error: Callable[[np.ndarray], np.ndarray]
    one: str
    light: bool


METRICS = {
    "relative_mse": Metric("relative MSE", "{:.6g}", np.sqrt, "an error as large as the reference", True),
    "psnr": Metric("PSNR", "{:.2f} dB", np.sqrt, "black for white", False),
    "ssim": Metric("SSIM", "{:.6g}", lambda similarity: 1.0 - similarity, "nothing in common", False),
    "flip": Metric("FLIP", "{:.6g}", lambda difference: difference, "the greatest difference to the eye", True),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `jaxraster compare`."""
    option = parser.add_argument
    option("image", metavar="IMAGE", help="a .png, .jpg or .webp, or light in .hdr or .exr")
    option("reference", metavar="REFERENCE", help="what it should look like: of the same size and kind")
    option("-o", "--output", metavar="MAP", help="also draw where they differ (.png, .jpg), from black 0 to yellow 1")
    option("--metric", default="flip", metavar="NAME", help=f"what MAP shows: {', '.join(METRICS)} (default: flip)")
    option(
        "--pixels-per-degree",
        type=between(1.0, 1000.0),
        metavar="P",
        help="how close FLIP looks: distance / width of a pixel, times pi / 180 (default: 67, a monitor 0.7 m away)",
    )
    add_limit(parser, "read")


def _check(arguments: argparse.Namespace) -> bool:
    """Refuse what cannot be compared or written, before anything is read; returns whether it is light."""
    from ..io.disk import suffix_of
    from ..io.image import check_writable

    choose("--metric", arguments.metric, METRICS)
    paths = arguments.image, arguments.reference
    light, other = (suffix_of(path) in LIGHT for path in paths)
    if light != other:
        raise UsageError(None, "", f"{paths[not light]} is for light, {paths[light]} is not; compare two of one kind")
    if light and not METRICS[arguments.metric].light:
        raise UsageError(None, "--metric", f"{arguments.metric} needs a white, which light does not have")
    if arguments.output:
        for path in paths:
            if os.path.exists(arguments.output) and os.path.exists(path) and os.path.samefile(arguments.output, path):
                raise OutputError(arguments.output, "", "is one of the pictures themselves; choose another name")
        check_writable(arguments.output)
    return light


def _read(path: str, light: bool, limits) -> np.ndarray:
    """A picture [h w 3] as the file has it, NaN and all."""
    from ..io.disk import suffix_of
    from ..io.exr import read_exr_light
    from ..io.image import read_image
    from ..io.radiance import read_hdr

    notes = ()
    if suffix_of(path) == ".exr":
        image, notes = read_exr_light(path, limits)
    elif light:
        image = read_hdr(path, limits)
    else:
        image = read_image(path, limits=limits)
        if (image[..., 3] < 1).any():
            notes = ("is transparent in places; its colours are compared, its opacity is not",)
    for note in notes:
        complain("warning", f"{path}: {note}")
    return image[..., :3].astype(np.float32)


def _metrics(chosen: str, light: bool, height: int, width: int) -> list[str]:
    """The names of the metrics that pictures of this kind and size have."""
    from ..metrics.ssim import LEAST

    names = [name for name, metric in METRICS.items() if metric.light or not light]
    if min(height, width) >= LEAST:
        return names
    if chosen == "ssim":
        raise UsageError(None, "--metric", f"ssim needs {LEAST} x {LEAST} pixels, there are {width} x {height}")
    return [name for name in names if name != "ssim"]


def run(arguments: argparse.Namespace) -> None:
    """Read, compare, print the table, draw the map."""
    light = _check(arguments)
    import jax.numpy as jnp

    from .. import metrics
    from ..io.image import write_image
    from ..io.reading import Limits

    progress("loading...")
    limits = Limits(**dict(arguments.limit))
    image, reference = (_read(path, light, limits) for path in (arguments.image, arguments.reference))
    (height, width), (rows, columns) = image.shape[:2], reference.shape[:2]
    if (height, width) != (rows, columns):
        sizes = f"has {width} x {height} pixels, {arguments.reference} {columns} x {rows}"
        raise InputError(arguments.image, "", f"{sizes}; compare pictures of one size")
    names = _metrics(arguments.metric, light, height, width)

    say(f"{width} x {height} pixels of {'linear light' if light else 'display codes'}")
    scores = {}
    for name in names:
        progress("comparing...")
        with interruptible():
            function = metrics.hdr_flip if light and name == "flip" else getattr(metrics, name)
            ppd = arguments.pixels_per_degree if name == "flip" else None
            seen = {"pixels_per_degree": ppd} if ppd else {}
            scores[name] = function(jnp.asarray(image), jnp.asarray(reference), **seen)
            value = float(scores[name].value)
        say(f"{METRICS[name].name:13} {METRICS[name].text.format(value)}")
    shown, metric = scores[arguments.metric], METRICS[arguments.metric]
    say(f"{'not finite':13} {int(shown.undefined)} of {height * width} pixels, in no mean")
    if arguments.output:
        write_image(arguments.output, metrics.heat(jnp.asarray(metric.error(np.asarray(shown.map)))))
        green = "; green is not finite" * bool(shown.undefined)
        say(f"wrote {arguments.output} ({metric.name}: black is 0, pale yellow 1, {metric.one}{green})")
