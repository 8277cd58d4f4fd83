"""What a result was made from, as one hash, so that a run that was killed goes on where it ended."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

import leapgap
from leapgap.files import read_json

KEY = "key.json"
VERDICT = (
    *("diagnosis", "effects", "recording", "robot", "simulation", "files.py", "errors.py"),
    *("view/report.py", "view/report.html", "view/page.py"),
)
"""Parts of the library that a verdict depends on; it makes no recordings."""
LANDING = ("experiment", "control", "effects", "planning", "recording", "robot", "simulation", "files.py", "errors.py")
"""Parts that a closed-loop experiment depends on."""
TOOLS = ("casadi", "daqp", "mujoco", "numpy", "osqp", "plotly", "scipy")


def code_hash(parts: Sequence[str] = VERDICT) -> str:
    """SHA-256 of the code behind a result and of the versions of its tools."""
    root = Path(leapgap.__file__).parent
    digest = hashlib.sha256()
    for part in parts:
        for path in sorted((root / part).rglob("*")) if (root / part).is_dir() else [root / part]:
            if path.suffix in (".py", ".html", ".xml"):
                digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    digest.update(json.dumps({name: version(name) for name in TOOLS}).encode())
    return digest.hexdigest()


def key_of(logs: Path, robot: Path, settings: Mapping[str, Any], code: str) -> str:
    """SHA-256 of a folder of logs, a model file, the settings and the code."""
    digest = hashlib.sha256(code.encode() + json.dumps(settings, sort_keys=True).encode() + robot.read_bytes())
    for path in sorted(logs.glob("*.parquet")):
        digest.update(path.name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def has_key(folder: Path, key: str) -> bool:
    """Whether a finished verdict in a folder was made from just this."""
    return (folder / KEY).is_file() and read_json(folder / KEY).get("key") == key


def digest(value: Any) -> str:
    """SHA-256 of what a value holds: numbers, texts, arrays, mappings, sequences, dataclasses and closures of them.

    Two values that hold the same have the same digest in every process; nothing else is told apart by chance of
    memory. A value with a ``sha256`` of its own (a robot: of its model file) is that. Anything else is a ``TypeError``.
    """
    found = hashlib.sha256()
    for part in content(value):
        found.update(part)
    return found.hexdigest()


def content(value: Any) -> Iterator[bytes]:
    """The bytes that ``digest`` hashes; every part says its kind and its length, so that none runs into the next."""
    if value is None or isinstance(value, bool | int | float | str | np.generic):
        plain = value.item() if isinstance(value, np.generic) else value
        yield f"{type(plain).__name__} {plain!r};".encode()
    elif isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape};".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif hasattr(value, "sha256"):
        yield f"file {value.sha256};".encode()
    elif is_dataclass(value) or isinstance(value, FunctionType) or hasattr(value, "__dict__"):
        yield f"{named(value)} ".encode()
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


def named(value: Any) -> str:
    """The kind of a value, or which function it is."""
    what = value if isinstance(value, FunctionType) else type(value)
    return f"{what.__module__}.{what.__qualname__}"


def parts_of(value: Any) -> dict[str, Any]:
    """Fields of a dataclass, what a function closes over, or the attributes of another object."""
    if isinstance(value, FunctionType):
        cells = zip(value.__code__.co_freevars, value.__closure__ or (), strict=True)
        return {name: cell.cell_contents for name, cell in cells}
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    return dict(vars(value))
