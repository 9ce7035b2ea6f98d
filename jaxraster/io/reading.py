"""How a file is read: within which limits, and what becomes of what is broken in it."""

import os
from dataclasses import dataclass, field, fields
from typing import NoReturn

from ..errors import InputError, LimitError, one_line

OR_REPAIR = "export it again, or drop it with repair"
MOST_NAMED = 5  # places that a note names; the rest are counted


def _limit(default: int, about: str):
    return field(default=default, metadata={"about": about})


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The most of everything that is read and drawn; beyond it a `LimitError` names the limit before memory is
    asked for.

    Example:
        >>> Limits(triangles=1000).nodes
        1000000
    """

    file_bytes: int = _limit(2**31, "bytes of a file")
    claimed_bytes: int = _limit(2**24, "bytes that a file may claim and not hold: accessors of zeros")
    vertices: int = _limit(2**27, "vertices of a scene, read and placed, instances counted each")
    triangles: int = _limit(2**26, "triangles of a scene, instances counted each")
    nodes: int = _limit(10**6, "nodes of a scene")
    image_side: int = _limit(2**14, "pixels along a side of a PNG, JPEG or WebP")
    image_pixels: int = _limit(2**26, "pixels of a PNG, JPEG or WebP")
    texels: int = _limit(2**28, "pixels of all textures of a scene together")
    light_side: int = _limit(2**15, "pixels along a side of an .hdr or .exr")
    light_pixels: int = _limit(2**27, "pixels of an .hdr or .exr")
    picture_side: int = _limit(2**14, "pixels along a side of the picture that the command line draws")
    picture_samples: int = _limit(2**28, "samples of that picture: a buffer of one float for each takes 1 GiB")

    def __post_init__(self):
        for each in fields(self):
            value = getattr(self, each.name)
            if type(value) is not int or value < 1:
                raise ValueError(f"Limits.{each.name} must be a whole number of at least 1, got {value!r}")


DEFAULT = Limits()


def exceed(limit: str, most: int, file: str | os.PathLike | None, where: str, message: str) -> NoReturn:
    """Raise the `LimitError` for more than `most`, by the name under which the limit can be raised."""
    raise LimitError(file, where, f"{message}; at most {most} are allowed (limit {limit})")


class Reading:
    """The limits and the rules for one file, and the notes taken on the way: what -> the places, in order.

    Three things happen to what cannot be read as it stands. What is not supported is ignored, with a note. What can
    be put right without loss is mended, with a note; `strict` makes that an error. What is broken is an error; `repair`
    drops it instead, with a note of how much.
    """

    def __init__(self, *, repair: bool = False, strict: bool = False, limits: Limits | None = None):
        if repair and strict:
            raise ValueError("repair and strict exclude each other: one drops what is broken, the other forbids it")
        if not isinstance(limits, Limits | None):
            raise TypeError(f"limits must be a Limits(...) or None, got {type(limits).__name__}")
        self.repair, self.strict, self.limits = repair, strict, limits or DEFAULT
        self._notes: dict[str, dict[str, None]] = {}
        self._counts: dict[str, int] = {}

    def count(self, limit: str, amount: int, file: str | os.PathLike, where: str, what: str) -> None:
        """Add to what a limit bounds, before it is allocated, `what` being what grows."""
        total = self._counts[limit] = self._counts.get(limit, 0) + amount
        if total > (most := getattr(self.limits, limit)):
            exceed(limit, most, file, where, f"brings {what} to {total}")

    def ignore(self, what: str, where: str = "") -> None:
        """Note one more place of something that is left out."""
        self._notes.setdefault(one_line(what), {})[one_line(where)] = None

    def mend(self, file: str | os.PathLike, where: str, what: str) -> None:
        """Note something that is put right, for instance "roughnessFactor 3 is clamped to [0, 1]"."""
        if self.strict:
            raise InputError(file, where, f"{what}, which strict forbids; export it again")
        self.ignore(what, where)

    def drop(self, file: str | os.PathLike, where: str, message: str, dropped: str) -> None:
        """Note that something broken is left out: `message` says what is wrong with it, `dropped` what goes and how
        much of it."""
        if not self.repair:
            raise InputError(file, where, f"{message}; {'export it again' if self.strict else OR_REPAIR}")
        self.ignore(f"dropped {dropped}: {message}", where)

    def notes(self) -> tuple[str, ...]:
        """One sentence for each kind of note, with the first few of its places."""
        sentences = []
        for what, where in self._notes.items():
            named = [place for place in where if place]
            more = f" and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
            sentences.append(f"{what}{': ' if named else ''}{', '.join(named[:MOST_NAMED])}{more}")
        return tuple(sentences)
