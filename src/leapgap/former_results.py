"""Cached results of versions up to 0.1, which kept the key inside the result or in ``key.json``.

They are located here so that they can be replaced and swept; their content is not used.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

TRIAL = {"landings", "conduct", "tried"}
MODEL = {"format_version", "trained_on"}
SPREADS = ("spread", "spread_no_phase", "spread_forecast")


def former_places(folder: Path) -> set[str]:
    """Places of former results below a folder: paths without endings, relative to it."""
    found = set()
    for path in folder.rglob("[!.]*.json"):
        found.add(path.parent if path.name == "key.json" else path.with_name(path.name.split(".")[0]))
    found |= {path.with_suffix("") for path in folder.rglob("*.npz") if path.stem in SPREADS}
    found |= {path for path in folder.glob("*_logs/*") if path.is_dir()}
    return {path.relative_to(folder).as_posix() for path in found if path != folder and former_files(path)}


def former_files(target: Path) -> list[Path]:
    """The files of a former result at a path; empty where there is none, or where that is not certain."""
    if target.is_dir():
        return verdict_files(target) or further_logs(target)
    record = read_keyed(target.with_name(f"{target.name}.json"))
    if record.keys() >= TRIAL or record.keys() == {"key", "value"}:
        endings = [".json", ".parquet"]
    elif any(target.parent.glob("*.key")):
        return []  # models of this version hold their keys too
    elif record.keys() >= MODEL:
        endings = [".json", ".npz", ".onnx", ".curve.json"]
    elif target.name in SPREADS and any(read_keyed(path).keys() >= MODEL for path in target.parent.glob("*.json")):
        endings = [".npz"]
    else:
        return []
    return [path for ending in endings if (path := target.with_name(target.name + ending)).is_file()]


def verdict_files(folder: Path) -> list[Path]:
    """Files of a former diagnosis of a withheld case: a folder with ``key.json``."""
    if read_keyed(folder / "key.json").keys() != {"key"}:
        return []
    named = [folder / name for name in ("key.json", "report.json", "report.html", "corrected/effects.json")]
    return [path for path in [*named, *folder.glob("corrected/*.xml")] if path.is_file()]


def further_logs(folder: Path) -> list[Path]:
    """Further jumps of a case: ``<kind>_logs/<case>`` beside the former verdict ``<kind>/<case>``."""
    kind = folder.parent.name.removesuffix("_logs")
    if kind == folder.parent.name or not verdict_files(folder.parent.parent / kind / folder.name):
        return []
    return sorted(folder.glob("*.parquet"))


def read_keyed(path: Path) -> Mapping[str, Any]:
    """Read a JSON object that holds a key as former results did; empty for any other file."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(value, dict) or not re.fullmatch("[0-9a-f]{64}", str(value.get("key"))):
        return {}
    return value
