"""List the limits of what is read and drawn, with the option that changes them."""

import argparse
from dataclasses import fields

from .terminal import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`jaxraster limits` has no options."""


def run(arguments: argparse.Namespace) -> None:
    """Print a line for each limit: its name, the most that is allowed, and of what."""
    from ..io.reading import Limits

    for each in fields(Limits):
        say(f"{each.name:16} {each.default:11}  {each.metadata['about']}")
    say("Change one with: jaxraster render SCENE --limit NAME=N")
