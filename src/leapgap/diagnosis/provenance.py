"""What a report was made of: logs, robot, settings and tools, so that a reader knows what it is about."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from leapgap.logs.log import Log
from leapgap.robot.model import Robot

TOOLS = ("leapgap", "mujoco", "numpy")


@dataclass(frozen=True)
class Provenance:
    """The logs, the robot, the settings and the tools behind a report."""

    logs: Mapping[str, str]
    """SHA-256 of each log by its name: of its file where the caller names it, else of its content."""
    versions: Mapping[str, str]
    """Of the packages that decide the figures."""
    robot: str
    """SHA-256 of the model file."""
    config: Mapping[str, Any]
    """The settings of the diagnosis."""

    @staticmethod
    def of(
        jumps: Sequence[Log], robot: Robot, config: Mapping[str, Any], files: Mapping[str, str] | None = None
    ) -> "Provenance":
        """Of some logs; ``files`` holds the SHA-256 of the file of each log by its name, where there are files."""
        logs = {jump.name: content_sha256(jump) for jump in jumps} if files is None else dict(files)
        return Provenance(logs, {name: installed(name) for name in TOOLS}, robot.sha256, config)


def content_sha256(jump: Log) -> str:
    """SHA-256 of the metadata and of all columns, whatever their order, by 64-bit floats."""
    digest = hashlib.sha256(jump.info.to_json().encode())
    for name in sorted(jump.columns):
        digest.update(name.encode() + b"\0" + np.ascontiguousarray(jump[name], dtype="<f8").tobytes())
    return digest.hexdigest()


def installed(package: str) -> str:
    """Version of a package; of a source tree that was never installed there is none."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
