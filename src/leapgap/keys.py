"""What a result was made from, as one hash, so that a run that was killed goes on where it ended."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import leapgap
from leapgap.files import read_json

KEY = "key.json"
VERDICT = ("diagnosis", "effects", "recording", "robot", "simulation", "control", "view", "files.py", "errors.py")
"""Parts of the library that a verdict depends on."""
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
