"""Settings from JSON or YAML: the dataclass beside what it configures decides about keys and their types."""

import dataclasses
import json
import math
import re
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from leapgap.errors import InputError, did_you_mean

Kind = TypeVar("Kind")


YAML = (".yaml", ".yml")
"""Endings of the files that are read as YAML; all others are JSON."""


def from_json(kind: type[Kind], path: Path) -> Kind:
    """A dataclass from a file, JSON or YAML by its ending; what is not in the file keeps its default."""
    return from_mapping(kind, values_of(path), str(path))


def values_of(path: Path) -> Any:
    """What a file of settings says, JSON or YAML by its ending."""
    try:
        text = path.read_text(encoding="utf-8")
        return from_yaml(text) if path.suffix in YAML else json.loads(text)
    except OSError:
        raise InputError(path, "no such file", "settings as JSON or YAML", "name the file") from None
    except (ValueError, yaml.YAMLError) as error:
        kind, message = ("YAML" if path.suffix in YAML else "JSON"), " ".join(str(error).split())
        raise InputError(path, f"no valid {kind} ({message})", "an object of settings", "correct it") from None


def from_yaml(text: str) -> Any:
    """Values of a YAML text. ``1e-3`` is a number here as everywhere else; PyYAML alone would take it for a text."""
    return yaml.load(text, Loader=Loader)


class Loader(yaml.SafeLoader):
    """Reads plain data, and floating-point numbers without a dot."""


Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


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
    types_of = typing.get_type_hints(kind)
    return kind(**{name: converted(types_of[name], value, f"{where}, {name}") for name, value in values.items()})


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
        if not math.isnan(value):
            return float(value)
    elif isinstance(value, kind) and not (kind is int and isinstance(value, bool)):
        return value
    raise InputError(where, repr(value), f"a value of type {getattr(kind, '__name__', kind)}", "correct it")


def replaced(settings: Kind, **changes: Any) -> Kind:
    """The same settings with some changed."""
    return dataclasses.replace(settings, **changes)  # type: ignore[type-var]
