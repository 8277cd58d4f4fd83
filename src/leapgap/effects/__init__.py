"""Effects that the nominal robot leaves out; other packages may register more."""

import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Any

from leapgap.effects.base import Effect
from leapgap.errors import InputError, did_you_mean
from leapgap.registry import classes_by_name
from leapgap.robot.model_file import LARGEST

ENTRY_POINTS = "leapgap.effects"  # group under which an installed package offers effect classes

Registry = Mapping[str, type[Effect]]  # effect classes by name


class Kinds(dict[str, type[Effect]]):
    """Effect classes by name; a class is found by its other names too, which are not counted."""

    def __missing__(self, name: str) -> type[Effect]:
        """The class that has this as another name."""
        for kind in self.values():
            if name in kind.other_names:
                return kind
        raise KeyError(name)

    def __contains__(self, name: object) -> bool:
        """Whether some class is found by this name."""
        return super().__contains__(name) or any(name in kind.other_names for kind in self.values())

    def get(self, name: str, default: Any = None) -> Any:
        """The class of this name, if there is one."""
        try:
            return self[name]
        except KeyError:
            return default


def first_name(name: str) -> str:
    """The name under which an effect stands in the tables, by any name of it; a name that is no effect's stays."""
    return known()[name].name if name in known() else name


@cache
def known() -> Kinds:
    """All effects by name, in alphabetical order: those of this package and those of installed packages."""
    kinds = Kinds(classes_by_name(sys.modules[__name__], Effect, ENTRY_POINTS))
    for kind in kinds.values():
        check_class(kind)
    return kinds


def by_default() -> dict[str, type[Effect]]:
    """The known effects that a diagnosis looks for when nothing is named, by name in alphabetical order."""
    return {name: kind for name, kind in known().items() if kind.by_default}


def registry(own: Iterable[type[Effect]] = ()) -> Kinds:
    """The known effects and a user's own classes."""
    # Effects by name with further classes; ``InputError`` for what is no effect or has the name of another
    found = Kinds(known())
    for kind in own:
        check_class(kind)
        if found.get(kind.name, kind) is not kind:
            raise InputError(
                f"effect class {kind.__qualname__}", f"the name {kind.name}", "a name of its own", "choose another name"
            )
        found[kind.name] = kind
    return found


def check_class(kind: Any) -> None:
    """Raise ``InputError`` for a class that cannot be injected and fitted like a known effect."""
    where = f"effect class {getattr(kind, '__qualname__', kind)}"
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise InputError(where, repr(kind), "a subclass of leapgap.effects.base.Effect", "pass the class itself")
    if not isinstance(getattr(kind, "name", None), str):
        raise InputError(where, "no name", 'a class variable like name = "my_effect"', "give it a name")
    if not (is_dataclass(kind) and "__dataclass_fields__" in vars(kind) and kind.declarations()):
        expected = "a frozen dataclass with at least one field declared by leapgap.effects.base.parameter"
        do = "decorate the class with @dataclass(frozen=True) and declare its parameters"
        raise InputError(where, "no parameter", expected, do)
    if kind.parameters.__func__ is Effect.parameters.__func__:  # type: ignore[attr-defined]
        own = [name for name, about in kind.declarations().items() if about.nominal is None]
        if own:
            raise InputError(where, f"None as nominal {own[0]}", "the model's own value", "override parameters()")


def describe(kind: type[Effect]) -> str:
    """Short description of an effect, ``viscous friction``: its words, else the first line of its docstring."""
    own = kind.__dict__.get("__doc__") or ""
    of_class = "" if own.startswith(f"{kind.__name__}(") else own  # a dataclass without words gets its signature
    text = (vars(kind).get("words") or of_class or kind.name.replace("_", " ")).strip().split("\n")[0].rstrip(".")
    return text[:1].lower() + text[1:]


def effect_words(name: str) -> str:
    """What an effect is, such as ``viscous friction``; the name of one that only its user knows."""
    kind = known().get(name)
    return describe(kind) if kind else name.replace("_", " ")


def label_words(label: str) -> str:
    """An effect and its place: ``viscous friction at elbow`` for ``joint_damping at elbow``."""
    name, at, place = label.partition(" at ")
    return f"{effect_words(name)}{at}{place}"


def parameter_words(name: str) -> str:
    """A number of an effect without the unit in its name: ``torque`` for ``torque_nm``, ``torque (N·m)`` likewise."""
    return re.sub(r"_(kg_m|rad_nm|rad_s|s_rad|per_s|kg|nm|rad|m|s|v)(?= \(|$)", "", name).replace("_", " ")


def sentence_words(sentence: str) -> str:
    """A sentence of a report without names of code: ``viscous friction (at elbow: damping 0.4 N·m·s/rad)``."""
    kinds = known().values()
    names = "|".join(name for kind in kinds for name in (kind.name, *kind.other_names))
    numbers = {p for kind in kinds for p in kind.declarations()}
    plain = re.sub(rf"\((?:{names})(?: (at [^():]+))?: ", lambda found: f"({found[1]}: " if found[1] else "(", sentence)
    plain = re.sub(rf"\b(?:{'|'.join(numbers)})(?= [-\d])", lambda found: parameter_words(found[0]), plain)
    return re.sub(rf"\b(?:{names})\b", lambda found: effect_words(found[0]) if "_" in found[0] else found[0], plain)


def effect(name: str, location: str = "all", **values: float) -> Effect:
    """A known effect by name; an unknown name, parameter or value out of range is an ``InputError``."""
    return effect_among(known(), name, location, values)


def effect_among(kinds: Registry, name: str, location: str, values: Mapping[str, float]) -> Effect:
    """An effect by name among the given classes; errors as in ``effect``."""
    if not isinstance(name, str) or name not in kinds:
        do = did_you_mean(str(name), kinds) or "choose a known effect: leapgap effects"
        raise InputError("effect", str(name), f"one of {', '.join(kinds)}", do)
    if not isinstance(location, str):
        raise InputError("location", repr(location), "the name of a place", "correct it")
    kind = kinds[name]
    declarations = kind.declarations()
    for key, value in values.items():
        if key not in declarations:
            do = did_you_mean(key, declarations) or "correct it"
            raise InputError(f"effect {name}", f"parameter {key}", f"one of {', '.join(declarations)}", do)
        if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= LARGEST:
            expected = f"a number up to {LARGEST:g} {declarations[key].unit}"
            raise InputError(f"effect {name}, {key}", repr(value), expected, "choose a physical value")
        lower, upper = declarations[key].limits
        if not lower <= value <= upper:
            expected = f"{lower:g} to {upper:g} {declarations[key].unit}"
            raise InputError(f"effect {name}, {key}", f"{value:g}", expected, "choose a physical value")
    return kind(location=location, **values)


def from_config(entries: Iterable[Mapping[str, Any]], kinds: Registry | None = None) -> tuple[Effect, ...]:
    """Effects from configuration: ``[{name: joint_damping, location: all, damping: 0.4}, …]``."""
    kinds, found = known() if kinds is None else kinds, []
    for entry in entries:
        if not isinstance(entry, Mapping):
            raise InputError("effects", repr(entry), "an effect: its name, location and parameters", "correct it")
        values = dict(entry)
        name, location = values.pop("name", "no name"), values.pop("location", "all")
        found.append(effect_among(kinds, name, location, values))
    return tuple(found)


def to_config(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """The inverse of ``from_config``: what ``corrected/effects.json`` holds; the model's own values are left out."""
    return [{"name": e.name, "location": e.location, **e.values} for e in effects]
