"""The shape of an effect's file: its settings, and the one function that takes them, named as the file."""

import dataclasses
import importlib
import inspect
import types
import typing

import pytest


def effects() -> dict[str, type]:
    """The plan's fields of type `Effect | None`, or one of several effects, and their records."""
    plan = importlib.import_module("jaxraster.plan").Plan
    kinds = {name: typing.get_args(hint) for name, hint in typing.get_type_hints(plan).items()}
    return {
        f"{name}: {kind.__name__}": kind
        for name, kinds_of in kinds.items()
        for kind in kinds_of
        if type(None) in kinds_of and dataclasses.is_dataclass(kind)
    }


def faults(module: types.ModuleType) -> list[str]:
    """How an effect's module departs from the shape."""
    own = {name: value for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__}
    public = {name: value for name, value in own.items() if not name.startswith("_")}
    file = module.__name__.split(".")[-1]
    records = [name for name, value in public.items() if dataclasses.is_dataclass(value)]
    takers = {}
    for name, value in public.items():
        if inspect.isfunction(inspect.unwrap(value)):
            parameters = inspect.signature(inspect.unwrap(value)).parameters.values()
            positional = [p.name for p in parameters if p.kind is not p.KEYWORD_ONLY]
            if "settings" in positional:
                takers[name] = positional
    found = []
    if not (module.__doc__ or "").strip():
        found.append("no docstring")
    if len(records) != 1:
        found.append(f"one public record expected, found {records}")
    if list(takers) != [file]:
        found.append(f"one public function that takes settings expected, {file}, found {list(takers)}")
    found += [f"{name}: settings come last" for name, words in takers.items() if words[-1] != "settings"]
    return found


def test_the_plan_has_effects():
    assert effects(), "no field of Plan is an effect or None"


@pytest.mark.parametrize(("name", "effect"), effects().items())
def test_effect_files_have_the_shape(name, effect):
    assert faults(importlib.import_module(effect.__module__)) == []


GOOD = '''
"""Fog."""
import dataclasses
@dataclasses.dataclass
class Fog:
    density: float = 0.1
def transmittance(distance, density): return 2.0 ** (-density * distance)
def fog(hdr, surface, settings, *, key=None): return hdr
'''


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("", "", None),
        ('"""Fog."""', "", "no docstring"),
        ("class Fog:", "class _Fog:", "one public record expected, found []"),
        ("def fog", "def mist", "one public function that takes settings expected, fog, found ['mist']"),
        ("surface, settings", "settings, surface", "fog: settings come last"),
        ("distance, density):", "distance, settings):", "found ['transmittance', 'fog']"),
    ],
)
def test_the_law_sees_a_fault(old, new, fault):
    module = types.ModuleType("jaxraster.fog")
    exec(GOOD.replace(old, new, 1), vars(module))
    found = faults(module)
    assert found == [] if fault is None else fault in " ".join(found)
