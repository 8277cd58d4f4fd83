"""Digests of values by content: equal content gives equal digests in every process."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from leapgap.runtime.atomic_io import sha256


def file_digests(folder: Path, pattern: str = "*.parquet") -> dict[str, str]:
    """File name → SHA-256 of the files of a folder that match a pattern."""
    return {path.name: sha256(path) for path in sorted(folder.glob(pattern))}


def digest(value: Any) -> str:
    """SHA-256 of the content of a value: numbers, texts, arrays, mappings, sequences, dataclasses and closures of them.

    Equal content gives equal digests across processes; object identity does not matter. A value with an
    attribute ``sha256`` (a robot: of its model file) is hashed by that. Any other kind of value is a ``TypeError``.
    """
    hashed = hashlib.sha256()
    for part in content(value):
        hashed.update(part)
    return hashed.hexdigest()


def content(value: Any) -> Iterator[bytes]:
    """The bytes that ``digest`` hashes; each part begins with its kind and length, so that parts cannot be confused."""
    if value is None or isinstance(value, bool | int | float | str | np.generic):
        plain = value.item() if isinstance(value, np.generic) else value
        yield f"{type(plain).__name__} {plain!r};".encode()
    elif isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape};".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif hasattr(value, "sha256"):
        yield f"file {value.sha256};".encode()
    elif is_dataclass(value) or isinstance(value, FunctionType) or hasattr(value, "__dict__"):
        kind = defined_by(value)
        yield f"{kind.__module__}.{kind.__qualname__} ".encode()
        yield from content(parts_of(value))
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)};".encode()
        for key in sorted(value, key=lambda key: b"".join(content(key))):
            yield from content(key)
            yield from content(value[key])
    elif isinstance(value, Sequence):
        yield f"sequence {len(value)};".encode()
        for item in value:
            yield from content(item)
    else:
        raise TypeError(f"no digest of a {type(value).__name__}: {value!r}")


def defined_by(value: Any) -> Any:
    """The function itself, or the class of any other value."""
    return value if isinstance(value, FunctionType) else type(value)


def parts_of(value: Any) -> dict[str, Any]:
    """Fields of a dataclass, closure variables of a function, or attributes of another object, by name."""
    if isinstance(value, FunctionType):
        cells = zip(value.__code__.co_freevars, value.__closure__ or (), strict=True)
        return {name: cell.cell_contents for name, cell in cells}
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return dict(vars(value))


def modules_within(value: Any) -> set[str]:
    """Names of the modules that define the classes and functions in a value: their code is part of its content."""
    if value is None or isinstance(value, bool | int | float | str | np.generic | np.ndarray):
        return set()
    if isinstance(value, Mapping) and not hasattr(value, "__dict__"):
        parts: list[Any] = [*value.keys(), *value.values()]
        own: set[str] = set()
    elif isinstance(value, Sequence) and not hasattr(value, "__dict__"):
        parts, own = list(value), set()
    else:
        own = {defined_by(value).__module__}
        whole = hasattr(value, "sha256") or not (is_dataclass(value) or hasattr(value, "__dict__"))
        parts = [] if whole else list(parts_of(value).values())
    return own.union(*(modules_within(part) for part in parts)) - {"builtins"}
