"""Dataclasses from plain values, as JSON and YAML have them: the dataclass decides about keys and their types."""

import contextlib
import dataclasses
import math
import reprlib
import textwrap
import types
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from leapgap.errors import InputError, did_you_mean

Kind = TypeVar("Kind")
LARGEST_SHOWN, LONGEST_SHOWN = 10**15, 200
"""A whole number, and characters of a value, that a message shows."""


def from_mapping(kind: type[Kind], values: Any, where: str) -> Kind:
    """A dataclass from a mapping; an unknown key or a value of another type is an ``InputError`` with its place."""
    fields = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    if not isinstance(values, Mapping):
        raise InputError(where, repr(values), f"an object with keys among {', '.join(sorted(fields))}", "correct it")
    unknown = sorted(set(values) - fields, key=str)
    if unknown:
        nearest = [question for name in unknown if (question := did_you_mean(str(name), fields))]
        expected, do = f"keys among {', '.join(sorted(fields))}", " ".join(nearest) or "correct them"
        raise InputError(where, f"the keys {', '.join(map(str, unknown))}", expected, do)
    missing = [field.name for field in dataclasses.fields(kind) if is_needed(field) and field.name not in values]  # type: ignore[arg-type]
    if missing:
        raise InputError(where, f"no {', '.join(missing)}", "every key that has no value of its own", "state it")
    types_of = typing.get_type_hints(kind)
    return kind(**{name: converted(types_of[name], value, f"{where}, {name}") for name, value in values.items()})


def is_needed(field: dataclasses.Field) -> bool:
    """Whether a field of a dataclass has no value unless it is stated."""
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def converted(kind: Any, value: Any, where: str) -> Any:
    """A value as its field's type wants it."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return value
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in inner:
            return None
        (kind,) = [one for one in inner if one is not type(None)][:1]
        return converted(kind, value, where)
    if dataclasses.is_dataclass(kind):
        return from_mapping(kind, value, where)  # type: ignore[arg-type]
    if origin in (dict, Mapping) or kind is dict or (isinstance(origin, type) and issubclass(origin, Mapping)):
        if isinstance(value, Mapping):
            of = inner[1] if inner else Any
            return {str(key): converted(of, one, f"{where}, {key}") for key, one in value.items()}
    elif origin in (list, tuple) or (isinstance(origin, type) and issubclass(origin, typing.Sequence)):
        if isinstance(value, list):
            items = [converted(inner[0], one, f"{where}, item {i}") for i, one in enumerate(value)]
            return tuple(items) if origin is tuple else items
    elif kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            if not math.isnan(value):
                return float(value)
    elif isinstance(value, kind) and not (kind is int and isinstance(value, bool)):
        return value
    raise InputError(where, in_short(value), f"a value of type {getattr(kind, '__name__', kind)}", "correct it")


def in_short(value: Any) -> str:
    """A value as a message shows it, however long it is."""
    if isinstance(value, int) and abs(value) > LARGEST_SHOWN:
        return f"a whole number of {math.floor(math.log10(abs(value))) + 1} digits"
    return reprlib.repr(value) if isinstance(value, list | dict) else textwrap.shorten(repr(value), LONGEST_SHOWN)
