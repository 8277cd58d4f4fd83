"""Plain values, as JSON and YAML have them: YAML of bounded size, and dataclasses, which decide on keys and types."""

import contextlib
import dataclasses
import math
import re
import reprlib
import textwrap
import types
import typing
from collections.abc import Mapping
from enum import Enum
from typing import Any, TypeVar

import yaml

from leapgap.errors import InputError, did_you_mean

MERGE = "tag:yaml.org,2002:merge"  # tag of the key ``<<``
NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
LONGEST_NUMBER = 1000  # characters of a number
MOST_BYTES, MOST_VALUES = 1_000_000, 100_000  # size of a file, and values in it, names written out


def from_yaml(text: str) -> Any:
    """Values of a YAML text. ``1e-3`` is a number here as everywhere else; PyYAML alone would take it for a text."""
    return yaml.load(text, Loader=Loader)


class Loader(yaml.SafeLoader):
    """Reads plain data and floating-point numbers without a dot, and refuses a key that is there twice."""

    written_out = 0  # keys of all mappings so far

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """The mapping of a node; what ``<<`` brings in may be stated anew."""
        known: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != MERGE:
                if key.value in known:
                    raise yaml.constructor.ConstructorError(None, None, f"the key {key.value} twice", key.start_mark)
                known.add(key.value)
        return super().construct_mapping(node, deep)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Write out what ``<<`` brings in, which may bring in further mappings, each of them several times."""
        super().flatten_mapping(node)
        self.written_out += len(node.value)
        if self.written_out > 2 * MOST_VALUES:  # a mapping that is brought in is counted there, too
            raise yaml.constructor.ConstructorError(None, None, f"more than {MOST_VALUES} values", node.start_mark)

    def construct_scalar(self, node: yaml.ScalarNode) -> Any:
        """The text of a value; a number has few digits (one in base 60, ``1:59``, is computed digit by digit)."""
        if node.tag in NUMBERS and len(node.value) > LONGEST_NUMBER:
            found = f"a number of {len(node.value)} characters"
            raise yaml.constructor.ConstructorError(None, None, found, node.start_mark)
        return super().construct_scalar(node)


Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def check_size(values: Any) -> None:
    """``ValueError`` for more values than settings have, written out; names of YAML stand for what they name.

    ``RecursionError`` for values that contain themselves.
    """
    sizes: dict[int, int] = {}

    def size(value: Any) -> int:
        if not isinstance(value, dict | list):
            return 1
        if id(value) not in sizes:
            inner = value.values() if isinstance(value, dict) else value
            sizes[id(value)] = 1 + sum(map(size, inner))
        return sizes[id(value)]

    if size(values) > MOST_VALUES:
        raise ValueError(f"{size(values):.3g} values; expected at most {MOST_VALUES}")


Kind = TypeVar("Kind")
LARGEST_SHOWN, LONGEST_SHOWN = 10**15, 200  # a whole number, and characters of a value, that a message shows


def from_mapping(kind: type[Kind], values: Any, where: str, joint: str = ", ", default: Kind | None = None) -> Kind:
    """A dataclass from a mapping; an unknown key or a value of another type is an ``InputError`` with its place.

    What the mapping leaves out is that of ``default``, else of the class. ``joint`` stands between ``where`` and a key.
    """
    fields = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    if not isinstance(values, Mapping):
        raise InputError(where, repr(values), f"an object with keys among {', '.join(sorted(fields))}", "correct it")
    unknown = sorted(set(values) - fields, key=str)
    if unknown:
        nearest = [question for name in unknown if (question := did_you_mean(str(name), fields))]
        expected, do = f"keys among {', '.join(sorted(fields))}", " ".join(nearest) or "correct them"
        raise InputError(where, f"the keys {', '.join(map(str, unknown))}", expected, do)
    defaults = {field.name: default_of(field) for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    missing = [name for name, own in defaults.items() if own is dataclasses.MISSING and name not in values]
    if missing and default is None:
        raise InputError(where, f"no {', '.join(missing)}", "every key that has no value of its own", "state it")
    types_of, found = typing.get_type_hints(kind), {}
    for name, value in values.items():
        found[name] = converted(types_of[name], value, f"{where}{joint}{name}", defaults[name])
    return kind(**found) if default is None else dataclasses.replace(default, **found)  # type: ignore[type-var]


def default_of(field: dataclasses.Field) -> Any:
    """The value that a field has where none is stated; ``MISSING`` where it has none."""
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def converted(kind: Any, value: Any, where: str, default: Any = None) -> Any:
    """A value as its field's type wants it; ``default`` is that of the field."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return value
    if origin in (typing.Union, types.UnionType):
        if value is None and type(None) in inner:
            return None
        (kind,) = [one for one in inner if one is not type(None)][:1]
        return converted(kind, value, where, default)
    if dataclasses.is_dataclass(kind):
        return from_mapping(kind, value, where, ".", default if isinstance(default, kind) else None)  # type: ignore[arg-type]
    if origin in (dict, Mapping) or kind is dict or (isinstance(origin, type) and issubclass(origin, Mapping)):
        if isinstance(value, Mapping):
            of = inner[1] if inner else Any
            return {str(key): converted(of, one, f"{where}.{key}") for key, one in value.items()}
    elif origin in (list, tuple) or (isinstance(origin, type) and issubclass(origin, typing.Sequence)):
        if isinstance(value, list):
            items = [converted(inner[0], one, f"{where}[{i}]") for i, one in enumerate(value)]
            return tuple(items) if origin is tuple else items
    elif kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            if math.isnan(value):
                raise InputError(where, "nan", "a number", "correct it")
            return float(value)
    elif kind is str and isinstance(value, int | float) and not isinstance(value, bool):
        return str(value)
    elif isinstance(kind, type) and issubclass(kind, Enum):
        if value not in kind.__members__:
            raise InputError(where, in_short(value), f"one of {', '.join(kind.__members__)}", "choose one")
        return kind[value]
    elif isinstance(value, kind) and not (kind is int and isinstance(value, bool)):
        return value
    raise InputError(where, in_short(value), f"a value of type {getattr(kind, '__name__', kind)}", "correct it")


def in_short(value: Any) -> str:
    """A value as a message shows it, however long it is."""
    if isinstance(value, int) and abs(value) > LARGEST_SHOWN:
        return f"a whole number of {math.floor(math.log10(abs(value))) + 1} digits"
    return reprlib.repr(value) if isinstance(value, list | dict) else textwrap.shorten(repr(value), LONGEST_SHOWN)
