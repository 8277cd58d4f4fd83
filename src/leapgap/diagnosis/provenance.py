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
        logs: Sequence[Log], robot: Robot, config: Mapping[str, Any], files: Mapping[str, str] | None = None
    ) -> "Provenance":
        """Of some logs; ``files`` holds the SHA-256 of the file of each log by its name, where there are files."""
        digests = {log.name: content_sha256(log) for log in logs} if files is None else dict(files)
        return Provenance(digests, {name: installed_version(name) for name in TOOLS}, robot.sha256, config)


def content_sha256(log: Log) -> str:
    """SHA-256 of the metadata and of all columns, whatever their order, by 64-bit floats."""
    digest = hashlib.sha256(log.info.to_json().encode())
    for name in sorted(log.columns):
        digest.update(name.encode() + b"\0" + np.ascontiguousarray(log[name], dtype="<f8").tobytes())
    return digest.hexdigest()


def installed_version(package: str) -> str:
    """Version of a package; of a source tree that was never installed there is none."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
