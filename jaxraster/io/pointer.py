"""JSON values that know where they stand, so that every complaint names the file and the place.

A `Json` is a value, its file and its pointer (RFC 6901). The readers check type and range, and raise `InputError`.
"""

import json
import math
from typing import Any, NamedTuple, NoReturn, TypeVar

from ..errors import InputError


class Json(NamedTuple):
    """A JSON value, the file it is from and the pointer to it there."""

    value: Any
    file: str
    where: str = ""


T = TypeVar("T")
FLOAT_MAX = 3.4028235e38  # the largest float32
_NAMES = {dict: "an object", list: "an array", str: "a string", bool: "true or false", int: "an integer"}


def fail(at: Json, message: str) -> NoReturn:
    """Raise the `InputError` of this place."""
    raise InputError(at.file, at.where or "/", message)


def parse(data: bytes, file: str) -> Json:
    """The object that a UTF-8 JSON file holds; NaN and Infinity are no JSON, and numbers beyond 1e308 become inf."""

    def refuse(name: str) -> NoReturn:
        raise InputError(file, "", f"is not JSON: it holds {name}; export it again")

    def integer(digits: str) -> int | float:
        return int(digits) if len(digits) < 20 else float(digits)

    try:
        value = json.loads(data.decode("utf-8-sig"), parse_constant=refuse, parse_int=integer)
    except json.JSONDecodeError as error:
        place = f"line {error.lineno} column {error.colno}"
        raise InputError(file, place, f"is not JSON: {error.msg}; the file may be cut off or damaged") from error
    except UnicodeDecodeError as error:
        raise InputError(file, f"byte {error.start}", "is not UTF-8 text; save it as UTF-8") from error
    except RecursionError as error:
        raise InputError(file, "", "is JSON nested too deeply") from error
    return _typed(Json(value, file), dict)


def _told(value: Any) -> str:
    """A value in few words: what holds others may be of any size and depth."""
    if type(value) in (dict, list) and value:
        return f"{_NAMES[type(value)]} of {len(value)}"
    return json.dumps(value[:40] if type(value) is str else value)


def _typed(at: Json, kind: type) -> Json:
    value = int(at.value) if kind is int and type(at.value) is float and at.value.is_integer() else at.value
    if type(value) is not kind:
        fail(at, f"expected {_NAMES[kind]}, got {_told(value)}")
    return at if value is at.value else at._replace(value=value)


def member(at: Json, key: str, kind: type, default: Any = None) -> Json:
    """A member of an object, checked to be a `kind`; without a default it has to be there."""
    if key not in at.value:
        if default is None:
            fail(at, f"{key} is missing")
        return Json(default, at.file, f"{at.where}/{key}")
    return _typed(Json(at.value[key], at.file, f"{at.where}/{key}"), kind)


def table(at: Json, *keys: str) -> Json:
    """The object under a path of keys, empty where one is absent."""
    for depth, key in enumerate(keys):
        if key not in at.value:
            return Json({}, at.file, "/".join((at.where, *keys[depth:])))
        at = member(at, key, dict)
    return at


def rows(at: Json, key: str) -> list[Json]:
    """A member that is an array of objects, empty if absent."""
    array = member(at, key, list, [])
    return [_typed(Json(v, at.file, f"{array.where}/{i}"), dict) for i, v in enumerate(array.value)]


def integer(at: Json, key: str, default: int | None = None, *, low: int = 0) -> int:
    """A member that is an integer of at least `low`."""
    found = member(at, key, int, default)
    if found.value < low:
        fail(found, f"is {found.value}, but at least {low} is needed")
    return found.value


def numbers(at: Json, key: str, default: tuple, low: float = -math.inf, high: float = math.inf) -> tuple[float, ...]:
    """A member that is an array of as many finite numbers in [low, high] as the default has."""
    found = member(at, key, list, list(default))
    if len(found.value) != len(default):
        fail(found, f"has {len(found.value)} numbers, but {len(default)} are needed")
    # Say where only what is wrong stands: a scene may have a million such arrays.
    if all(type(x) in (int, float) and low <= x <= high and -FLOAT_MAX <= x <= FLOAT_MAX for x in found.value):
        return tuple(map(float, found.value))
    items = [Json(v, at.file, f"{found.where}/{i}") for i, v in enumerate(found.value)]
    return tuple(_number(item, low, high) for item in items)


def number(at: Json, key: str, default: float | None = None, low: float = -math.inf, high: float = math.inf) -> float:
    """A member that is a finite number in [low, high]."""
    if key not in at.value and default is not None:
        return default
    if key not in at.value:
        fail(at, f"{key} is missing")
    return _number(Json(at.value[key], at.file, f"{at.where}/{key}"), low, high)


def _number(at: Json, low: float, high: float) -> float:
    if type(at.value) not in (int, float) or not math.isfinite(at.value):
        fail(at, f"expected a finite number, got {_told(at.value)}")
    if abs(at.value) > FLOAT_MAX:
        fail(at, f"is {at.value:g}, too large for a float32")
    if not low <= at.value <= high:
        fail(at, f"is {at.value:g}, which is not in [{low:g}, {high:g}]")
    return float(at.value)


def strings(at: Json, key: str) -> list[str]:
    """A member that is an array of strings, each once; empty if absent."""
    array = member(at, key, list, [])
    items = [_typed(Json(v, at.file, f"{array.where}/{i}"), str).value for i, v in enumerate(array.value)]
    return list(dict.fromkeys(items))


def indices(at: Json, key: str, count: int) -> list[int]:
    """A member that is an array of integers below `count`, empty if absent."""
    array = member(at, key, list, [])
    if all(type(i) is int and 0 <= i < count for i in array.value):
        return array.value
    items = [_typed(Json(v, at.file, f"{array.where}/{i}"), int) for i, v in enumerate(array.value)]
    for item in items:
        if not 0 <= item.value < count:
            fail(item, f"is {item.value}, but there are {count}")
    return [item.value for item in items]


def reference(at: Json, key: str, targets: list[T]) -> T | None:
    """The row of `targets` that a member names by its index; None if there is no such member."""
    if key not in at.value:
        return None
    found = member(at, key, int)
    if not 0 <= found.value < len(targets):
        fail(found, f"is {found.value}, but there are {len(targets)}; the file may be damaged")
    return targets[found.value]
