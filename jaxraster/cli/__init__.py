"""The command line: find the command, run it, and turn whatever goes wrong into one line and an exit code."""

import argparse
import sys
import traceback
import warnings
from collections.abc import Sequence

from ..errors import AssetWarning, Error, LimitError, UsageError
from . import compare, limits, prepare, render
from .arguments import parse, quiet
from .terminal import complain, progress, say

COMMANDS = {"render": render, "compare": compare, "prepare": prepare, "limits": limits}


def _parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    parser = quiet(
        argparse.ArgumentParser("jaxraster", description="A realistic rasterizer made of pure functions in JAX.")
    )
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND")
    for name, module in COMMANDS.items():
        about = module.__doc__.splitlines()[0]
        command = quiet(commands.add_parser(name, help=about, description=about, allow_abbrev=False))
        command.add_argument("--debug", action="store_true", help="show the traceback of an error")
        module.add_arguments(command)
        command.set_defaults(run=module.run, parser=command)
    return parser


def _version() -> str:
    """The installed package's version."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("jaxraster")
    except PackageNotFoundError:
        return "(not installed)"


def _as_error(error: Exception) -> Error | None:
    """Our own error for what went wrong, or None for a bug."""
    if isinstance(error, Error):
        return error
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return LimitError(None, "", "out of memory; choose a smaller --width, --height, --supersample or file")
    return None


def _dispatch(argv: Sequence[str]) -> None:
    """Run one command; every failure is an exception."""
    arguments = parse(_parser(), argv)
    if arguments.version:
        say(f"jaxraster {_version()}")
    elif not hasattr(arguments, "run"):
        raise UsageError(None, "", f"no command given; choose one of: {', '.join(COMMANDS)} (see jaxraster --help)")
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("always", AssetWarning)
            warnings.showwarning = lambda message, *_, **__: complain("warning", message)
            arguments.run(arguments)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0 done, 1 a bug of ours, 2 the request, 3 the input, 4 the output, 5 limits and memory, 130 interrupted. A
    traceback is shown only with `--debug`.
    """
    argv = sys.argv[1:] if argv is None else argv
    try:
        _dispatch(argv)
        return 0
    except SystemExit as stop:  # argparse has printed its help
        return int(stop.code or 0)
    except KeyboardInterrupt:
        progress()
        return 130
    except Exception as error:
        progress()
        if "--debug" in argv:
            traceback.print_exc()
        known = _as_error(error)
        if known is None:
            what = f"{type(error).__name__}: {str(error)[:300]}"
            complain("internal error", f"{what}; please report it, with the output of --debug")
            return 1
        complain("error", known)
        return known.code
