"""What lies around a scene, on the command line: a file, a clear sky with its sun, or tones; and how it is turned."""

import argparse
import math
import os

from ..errors import InputError, UsageError
from .arguments import direction, finite, tones

OF_THE_SKY = ("--sun-direction", "--turbidity")


def add_surroundings(parser: argparse.ArgumentParser) -> None:
    """The options of surroundings."""
    option = parser.add_argument
    option(
        "--environment",
        type=tones,
        metavar="WHAT",
        help="the surroundings, which light a file without lights: an equirectangular .hdr or .exr; 'sky', Preetham's "
        "clear sky with its sun; or radiance: GREY, R,G,B, or six numbers for sky and ground",
    )
    option("--environment-rotation", type=finite, metavar="DEG", help="turn them counter-clockwise, seen from above")
    towards = "towards the sun of --environment sky, +Y up (default: 0.4,0.6,0.7)"
    option("--sun-direction", type=direction, metavar="X,Y,Z", help=towards)
    option("--turbidity", type=finite, metavar="T", help="that sky's haze, from 2 for none to 10 (default: 3)")


def names_file(given: str | list | None) -> bool:
    """Whether the surroundings come from a file."""
    from ..io.environment import SKY

    return isinstance(given, str) and given != SKY


def check_surroundings(arguments: argparse.Namespace) -> None:
    """Refuse what is not there, as far as it can be known without reading it."""
    from ..environment.sky import LEAST, MOST
    from ..io.environment import SKY
    from ..io.light import check_light

    given, sun, turbidity = arguments.environment, arguments.sun_direction, arguments.turbidity
    if arguments.environment_rotation is not None and (given is None or isinstance(given, list)):
        what = "add it" if given is None else "tones look the same from all sides; drop one of them"
        raise UsageError(None, "--environment-rotation", f"turns the picture that --environment names; {what}")
    for option, value in zip(OF_THE_SKY, (sun, turbidity)):
        if value is not None and given != SKY:
            raise UsageError(None, option, f"is for '--environment {SKY}'; add it")
    if sun is not None and sun[1] < 0:
        below = f"a sun at Y = {sun[1]:g} is below the horizon"
        raise UsageError(None, OF_THE_SKY[0], f"{below}; give X,Y,Z towards the sun, Y at least 0")
    if turbidity is not None and not LEAST <= turbidity <= MOST:
        raise UsageError(None, OF_THE_SKY[1], f"expected a number from {LEAST:g} to {MOST:g}, got {turbidity:g}")
    if names_file(given):
        if not os.path.exists(given):
            raise InputError(given, "", f"is neither a file, nor {SKY!r}, nor numbers")
        check_light(given)


def read_surroundings(arguments: argparse.Namespace):
    """The environment that was asked for, turned."""
    from ..io.environment import SKY, TOWARDS_SUN, TURBIDITY, clear_sky, read_environment, surroundings

    given, rotation = arguments.environment, math.radians(arguments.environment_rotation or 0.0)
    if given == SKY:
        given = clear_sky(arguments.sun_direction or TOWARDS_SUN, arguments.turbidity or TURBIDITY, rotation=rotation)
    elif names_file(given):
        given = read_environment(given, rotation=rotation, strict=arguments.strict, limits=arguments.limits)
    return surroundings(given)[0]
