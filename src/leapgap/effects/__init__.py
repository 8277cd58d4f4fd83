"""What the nominal robot leaves out: one file an effect, found by its file name."""

import pkgutil
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

from leapgap.effects.base import Effect
from leapgap.errors import InputError


@cache
def known() -> dict[str, type[Effect]]:
    """All effects by name, in alphabetical order; what is defined elsewhere is nothing a diagnosis may know."""
    for module in pkgutil.iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
    here = [kind for kind in Effect.__subclasses__() if kind.__module__.startswith(f"{__name__}.")]
    return {kind.name: kind for kind in sorted(here, key=lambda kind: kind.name)}


def describe(name: str) -> str:
    """What the effect is, as its file says: ``viscous friction of the gears``."""
    text = (import_module(known()[name].__module__).__doc__ or "").split("\n")[0].rstrip(".")
    return text[:1].lower() + text[1:]


def effect(name: str, location: str = "all", **values: float) -> Effect:
    """An effect by name; an unknown name, parameter or value out of range is an ``InputError``."""
    if name not in known():
        raise InputError("effect", name, f"one of {', '.join(known())}", "choose a known effect")
    kind = known()[name]
    ranges = {p.name: p for p in kind.parameters()}
    for key, value in values.items():
        if key not in ranges:
            raise InputError(f"effect {name}", f"parameter {key}", f"one of {', '.join(ranges)}", "correct it")
        if not ranges[key].lower <= value <= ranges[key].upper:
            expected = f"{ranges[key].lower:g} to {ranges[key].upper:g} {ranges[key].unit}"
            raise InputError(f"effect {name}, {key}", f"{value:g}", expected, "choose a physical value")
    return kind(location=location, **values)


def from_config(entries: list[Mapping[str, Any]]) -> tuple[Effect, ...]:
    """Effects from configuration: ``[{name: joint_damping, location: all, damping: 0.4}, …]``."""
    return tuple(effect(**entry) for entry in entries)


def to_config(effects: tuple[Effect, ...]) -> list[dict[str, Any]]:
    """The inverse of ``from_config``: what ``corrected/effects.json`` holds."""
    return [{"name": e.name, "location": e.location, **e.values} for e in effects]
