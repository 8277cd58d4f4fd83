"""Settings from JSON or YAML: the dataclass beside what it configures decides about keys and their types."""

import json
from pathlib import Path
from typing import Any, TypeVar

import yaml

from leapgap.errors import InputError
from leapgap.logs.files import check_file
from leapgap.runtime.typed_values import MOST_BYTES, check_size, from_mapping, from_yaml

Kind = TypeVar("Kind")
YAML = (".yaml", ".yml")  # endings of the files that are read as YAML; all others are JSON


def from_json(kind: type[Kind], path: Path) -> Kind:
    """A dataclass from a file, JSON or YAML by its ending; what is not in the file keeps its default."""
    return from_mapping(kind, values_of(path), str(path))


def values_of(path: Path) -> Any:
    """What a file of settings says, JSON or YAML by its ending; ``InputError`` for one that is broken or too large."""
    kind = "YAML" if path.suffix in YAML else "JSON"
    check_file(path, "settings as JSON or YAML", "name the file")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(path, f"{path.stat().st_size} bytes", f"at most {MOST_BYTES}", "name a file of settings")
    try:
        text = path.read_text(encoding="utf-8")
        values = from_yaml(text) if kind == "YAML" else json.loads(text, object_pairs_hook=each_once)
        check_size(values)
    except RecursionError:
        raise InputError(path, f"{kind} that is nested too deep", "an object of settings", "correct it") from None
    except (ValueError, yaml.YAMLError) as error:
        message = " ".join(str(error).split())
        raise InputError(path, f"no valid {kind} ({message})", "an object of settings", "correct it") from None
    return values


def each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object with these keys; ``ValueError`` names one that is there twice, of which JSON would keep the last."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key} twice")
        found[key] = value
    return found
