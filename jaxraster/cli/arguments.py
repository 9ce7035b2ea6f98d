"""Reading a command's words: numbers in their ranges, names with a guess at what was meant, errors as one line."""

import argparse
import dataclasses
import difflib
import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import NoReturn

from ..errors import UsageError

_OPTION = re.compile(r"--[a-z-]+|-[a-z]")
_NEGATIVE = re.compile(r"-(\d|\.\d|inf|nan)")


def guess(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'this'?` if a known name is close, else `; known: all of them`."""
    known = list(known)
    close = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {close[0]!r}?" if close else f"; known: {', '.join(known)}"


def choose(option: str, word: str, known: Iterable[str]) -> str:
    """The word, if it is a known name of what the option chooses from."""
    known = list(known)
    if word not in known:
        raise UsageError(None, option, f"unknown name {word!r}{guess(word, known)}")
    return word


def whole(low: int, high: int | None = None) -> Callable[[str], int]:
    """A reader of whole numbers from `low` to `high`."""
    wanted = f"a whole number from {low} " + (f"to {high}" if high else "on")

    def read(word: str) -> int:
        number = int(word) if re.fullmatch(r"[+-]?\d{1,18}", word) else None
        if number is None or number < low or (high and number > high):
            raise argparse.ArgumentTypeError(f"expected {wanted}, got {word!r}")
        return number

    return read


def finite(word: str) -> float:
    """A finite number."""
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"expected a finite number, got {word!r}")
    return number


def between(low: float, high: float) -> Callable[[str], float]:
    """A reader of numbers from `low` to `high`."""

    def read(word: str) -> float:
        number = finite(word)
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"expected a number from {low:g} to {high:g}, got {word!r}")
        return number

    return read


def direction(word: str) -> tuple[float, float, float]:
    """Three finite numbers `x,y,z`, not all zero."""
    try:
        x, y, z = (finite(part) for part in word.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(f"expected three finite numbers x,y,z, got {word!r}") from None
    if x == y == z == 0:
        raise argparse.ArgumentTypeError(f"a direction needs a length above zero, got {word!r}")
    return x, y, z


def tones(word: str) -> str | list[list[float]]:
    """`GREY`, `R,G,B` or six numbers as radiance of the sky and of the ground; a word without numbers as it is."""
    try:
        numbers = [float(part) for part in word.split(",")]
    except ValueError:
        return word
    if len(numbers) not in (1, 3, 6) or not all(0 <= number < math.inf for number in numbers):
        raise argparse.ArgumentTypeError(f"expected 1, 3 or 6 numbers of at least 0, got {word!r}")
    return [numbers[:3], numbers[-3:]]


def _limit(word: str) -> tuple[str, int]:
    """`NAME=N`: the name of a limit and a whole number of at least 1."""
    from ..io.reading import Limits

    name, _, number = word.partition("=")
    known = [each.name for each in dataclasses.fields(Limits)]
    if name not in known:
        raise argparse.ArgumentTypeError(f"unknown name {name!r}{guess(name, known)}")
    return name, whole(1)(number)


def add_limit(parser: argparse.ArgumentParser, does: str) -> None:
    """`--limit NAME=N`, as often as wanted, of what the command does."""
    parser.add_argument(
        "--limit",
        type=_limit,
        action="append",
        default=[],
        metavar="NAME=N",
        help=f"{does} up to N of something; 'jaxraster limits' lists the names",
    )


def names(word: str) -> list[str]:
    """A list `this,that`, without repeats."""
    return list(dict.fromkeys(part.strip() for part in word.split(",") if part.strip()))


def _fail(message: str) -> NoReturn:
    """Stands in for argparse's own exit."""
    raise UsageError(None, "", message.removeprefix("argument "))


def quiet(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """Let the parser raise `UsageError` where argparse would print its usage and exit."""
    parser.error = _fail
    return parser


def parse(parser: argparse.ArgumentParser, argv: Sequence[str]) -> argparse.Namespace:
    """Parse all words. A command's own parser is its default `parser`, whose help lists the options to guess from."""
    # Tie a negative number to the option before it: argparse would take `-1,-2,-1` or `-1e3` for options.
    words: list[str] = []
    for word in argv:
        if words and _OPTION.fullmatch(words[-1]) and _NEGATIVE.match(word):
            words[-1] += ("=" if words[-1].startswith("--") else "") + word
        else:
            words.append(word)
    arguments, unknown = parser.parse_known_args(words)
    if unknown:
        name = unknown[0].split("=")[0]
        if not name.startswith("-"):
            raise UsageError(None, "", f"one argument too many: {name!r}")
        options = getattr(arguments, "parser", parser).format_help().split("options:")[-1]
        known = re.findall(r"(?<![\w-])--[a-z-]+", options)
        raise UsageError(None, "", f"unknown option {name!r}{guess(name, known)}")
    return arguments
