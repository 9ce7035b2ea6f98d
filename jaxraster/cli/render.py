"""Render a scene to a picture.

A file is loaded, planned, compiled and drawn; the plan says which effects are in and why, and how long each step took.
"""

import argparse
import contextlib
import dataclasses
import os
import pathlib
import time
from collections.abc import Iterator

from ..errors import InputError, OutputError, UsageError
from .arguments import add_limit, between, choose, direction, finite, guess, names, whole
from .surroundings import add_surroundings, check_surroundings, names_file, read_surroundings
from .terminal import complain, interruptible, progress, say

OCCLUSIONS = ("auto", "none", "ssao", "horizon")
NEAREST, FARTHEST = 1e-6, 1e9  # metres of radius: no scene needs others, whose squares leave single precision


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `jaxraster render`."""
    parser.add_argument(
        "scene",
        nargs="?",
        default="stage",
        metavar="SCENE",
        help="a glTF, OBJ, PLY, STL or OFF file, or a built-in scene: stage (default), cornell_box, material_grid",
    )
    option = parser.add_argument
    option(
        "-o",
        "--output",
        default="render.png",
        metavar="OUT",
        help="the picture: .png, .jpg; .hdr, .exr for light (default: %(default)s)",
    )
    option("--width", type=whole(1), default=640, metavar="W", help="pixels (default: %(default)s)")
    option("--height", type=whole(1), default=480, metavar="H", help="pixels (default: %(default)s)")
    option("--camera", type=whole(0), metavar="N", help="which of the file's cameras (default: 0)")
    option("--exposure", type=finite, default=0.0, metavar="EV", help="stops, +1 is twice as bright (default: 0)")
    option("--tonemap", default="pbr_neutral", metavar="NAME", help="the tone map (default: %(default)s)")
    option(
        "--shading",
        default="standard",
        metavar="NAME",
        help="standard (default), gltf: as other viewers, or local: lights alone",
    )
    option(
        "--light-direction",
        type=direction,
        metavar="X,Y,Z",
        help="light a file by one lamp alone, which shines in this direction",
    )
    add_surroundings(parser)
    option(
        "--occlusion",
        default="auto",
        metavar="NAME",
        help="what near things hide of ambient light: auto (default: as the planner finds), none, ssao or horizon",
    )
    reach = "how near they must be (default: 0.25); another one asks for horizons"
    option("--occlusion-radius", type=between(NEAREST, FARTHEST), metavar="METRES", help=reach)
    option("--dither", action="store_true", help="hide the steps of slow ramps under noise of one code")
    option("--supersample", type=whole(1, 8), default=1, metavar="N", help="N x N samples per pixel (default: 1)")
    option(
        "--aov",
        type=names,
        default=[],
        metavar="NAME,...",
        help="also write these buffers as OUT.NAME.png; 'all' for every one, a wrong name lists them",
    )
    option("--exr", metavar="FILE", help="also write linear light and the --aov buffers as channels of an EXR file")
    repairs = parser.add_mutually_exclusive_group()
    repairs.add_argument("--repair", action="store_true", help="drop what is broken in the file, and count it")
    repairs.add_argument("--strict", action="store_true", help="refuse what would be put right, or clamped")
    add_limit(parser, "read or draw")


def _check(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be rendered or written, before anything slow begins."""
    from ..display.tonemap import TONEMAPS
    from ..io.exr import check_exr
    from ..io.load import check_save
    from ..io.reading import Limits, exceed
    from ..plan import SHADINGS
    from .aov import AOVS

    choose("--tonemap", arguments.tonemap, TONEMAPS)
    choose("--shading", arguments.shading, SHADINGS)
    _check_occlusion(arguments.occlusion, arguments.occlusion_radius, arguments.shading)
    if "all" in arguments.aov:
        arguments.aov = list(AOVS)
    for name in arguments.aov:
        choose("--aov", name, AOVS)
    width, height, n = arguments.width, arguments.height, arguments.supersample
    limits = arguments.limits = Limits(**dict(arguments.limit))
    for option, side in (("--width", width), ("--height", height)):
        if side > limits.picture_side:
            exceed("picture_side", limits.picture_side, None, option, f"{side} pixels")
    if (samples := width * height * n * n) > limits.picture_samples:
        asked = f"{width} x {height} pixels with {n} x {n} samples are {samples} samples"
        exceed("picture_samples", limits.picture_samples, None, "", asked)
    check_surroundings(arguments)
    around = arguments.environment if names_file(arguments.environment) else ""
    paths = [arguments.output, *(_aov_path(arguments.output, name) for name in arguments.aov)]
    for path in [*paths, *([arguments.exr] if arguments.exr else [])]:
        for name, what in ((arguments.scene, "scene"), (around, "environment")):
            if os.path.exists(path) and os.path.exists(name) and os.path.samefile(path, name):
                raise OutputError(path, "", f"is the {what} itself; choose another name")
    for path in paths:
        check_save(path)
    if arguments.exr:
        if not arguments.exr.lower().endswith(".exr"):
            raise OutputError(arguments.exr, "", "--exr writes OpenEXR; end the name with .exr")
        if os.path.realpath(arguments.exr) in map(os.path.realpath, paths):
            raise OutputError(arguments.exr, "", "would hold the picture and --exr both; choose another name for one")
        check_exr(arguments.exr)


def _check_occlusion(name: str, radius: float | None, shading: str) -> None:
    """Refuse an occlusion that is unknown, or of what is not drawn."""
    choose("--occlusion", name, OCCLUSIONS)
    if radius is not None and name == "none":
        raise UsageError(None, "--occlusion-radius", "is of what '--occlusion none' leaves out; drop one of them")
    if shading == "local" and (name not in ("auto", "none") or radius is not None):
        raise UsageError(None, "--occlusion", "'--shading local' has no visibility of lights; drop one of them")


def _aov_path(output: str, name: str) -> str:
    """`folder/picture.png` -> `folder/picture.depth.png`."""
    return str(pathlib.Path(output).with_suffix(f".{name}.png"))


def _load(arguments: argparse.Namespace):
    """The scene and camera: built in if the name is one of those, else from the file; and surroundings, if asked for.

    Files are read before surroundings are prepared, which takes longer.
    """
    from ..io.load import load
    from ..scenes import SCENES

    name = arguments.scene
    if name in SCENES:
        of_files = ("camera", "light_direction", "repair")
        for option in of_files if names_file(arguments.environment) else (*of_files, "strict"):
            value = getattr(arguments, option)
            if value is not None and value is not False:
                raise UsageError(None, f"--{option.replace('_', '-')}", f"is for files; {name!r} is built in")
        scene, camera = SCENES[name]()
    elif not os.path.exists(name) and not os.path.splitext(name)[1]:
        raise InputError(name, "", f"neither a file nor a built-in scene{guess(name, SCENES)}")
    else:
        scene, camera = load(
            name,
            camera=arguments.camera or 0,
            light_direction=arguments.light_direction,
            environment=0.0 if arguments.environment else None,
            repair=arguments.repair,
            strict=arguments.strict,
            limits=arguments.limits,
        )
    if arguments.environment:
        scene = dataclasses.replace(scene, environment=read_surroundings(arguments))
    return scene, camera


def _plan(scene, camera, arguments: argparse.Namespace):
    """The plan for what was asked for, and its reasons."""
    from ..display.dither import Dither
    from ..planner import plan_for
    from ..screen.horizon import HorizonAO
    from ..screen.ssao import SSAO

    names = ("width", "height", "supersample", "tonemap", "exposure", "shading")
    asked = {name: getattr(arguments, name) for name in names}
    asked |= {"dither": Dither()} if arguments.dither else {}
    radius = {} if arguments.occlusion_radius is None else {"radius": arguments.occlusion_radius}
    # The planner knows but one radius: another one asks for horizons.
    if arguments.occlusion != "auto" or radius:
        methods = {"none": lambda: None, "ssao": lambda: SSAO(**radius)}
        asked["occlusion"] = methods.get(arguments.occlusion, lambda: HorizonAO(**radius))()
    return plan_for(scene, camera, **asked)


@contextlib.contextmanager
def _step(seconds: dict[str, float], name: str, doing: str) -> Iterator[None]:
    """Show a step while it lasts and note its seconds."""
    start = time.perf_counter()
    with interruptible():
        progress(f"{doing}...")
        yield
    seconds[name] = time.perf_counter() - start


def run(arguments: argparse.Namespace) -> None:
    """Load, plan, compile, render, save; say what was done."""
    _check(arguments)
    import jax
    import numpy as np

    from ..io.exr import write_exr
    from ..io.load import is_linear, save
    from ..planner import explain
    from ..render import render
    from .aov import channels, finite_pixels, pick, picture

    seconds: dict[str, float] = {}
    with _step(seconds, "load", "loading"):
        scene, camera = jax.block_until_ready(_load(arguments))
    with _step(seconds, "plan", "planning"):
        plan, reasons = _plan(scene, camera, arguments)
    say(explain(reasons))

    # Ask for the wanted buffers only: what is not returned is never computed.
    def buffers(scene, camera, plan):
        frame = render(scene, camera, plan)
        light = frame.hdr if arguments.exr or is_linear(arguments.output) else None
        return frame.image, light, [pick(name, frame, camera, plan) for name in arguments.aov]

    with _step(seconds, "compile", "compiling"):
        compiled = jax.jit(buffers).lower(scene, camera, plan).compile()
    with _step(seconds, "frame", "rendering"):
        image, light, aovs = jax.block_until_ready(compiled(scene, camera, plan))
    say(" · ".join(f"{name} {value:.{3 if name == 'frame' else 2}f} s" for name, value in seconds.items()))

    progress("saving...")
    image, bad = finite_pixels(light if is_linear(arguments.output) else image)
    if bad:
        total = arguments.width * arguments.height
        complain("warning", f"{arguments.output}: {bad} of {total} pixels are not finite and written as black")
    save(arguments.output, image)
    say(f"wrote {arguments.output} ({arguments.width}x{arguments.height})")
    for name, (mask, buffer) in zip(arguments.aov, aovs):
        path = _aov_path(arguments.output, name)
        image, about = picture(name, mask, buffer, plan)
        save(path, image)
        say(f"wrote {path} ({about})")
    if arguments.exr:
        planes = {letter: np.asarray(light[..., i]) for i, letter in enumerate("RGB")}
        for name, (mask, buffer) in zip(arguments.aov, aovs):
            planes |= channels(name, mask, buffer)
        write_exr(arguments.exr, planes)
        say(f"wrote {arguments.exr} ({', '.join(planes)})")
