"""Provenance of a report: logs, robot, settings and versions of tools."""

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
    """Hashes of logs and robot, settings and versions of tools behind a report."""

    logs: Mapping[str, str]
    """SHA-256 of each log by its name, of its file where the caller names it, else of its content."""
    versions: Mapping[str, str]  # Versions of the packages that influence the results
    robot: str  # SHA-256 of the model file
    config: Mapping[str, Any]  # The settings of the diagnosis

    @staticmethod
    def of(
        logs: Sequence[Log], robot: Robot, config: Mapping[str, Any], files: Mapping[str, str] | None = None
    ) -> "Provenance":
        """Provenance of some logs; ``files`` holds the SHA-256 of the file of each log by its name, if known."""
        digests = {log.name: content_sha256(log) for log in logs} if files is None else dict(files)
        return Provenance(digests, {name: installed_version(name) for name in TOOLS}, robot.sha256, config)


def content_sha256(log: Log) -> str:
    """SHA-256 of the metadata and all columns as 64-bit floats; the order of columns does not matter."""
    digest = hashlib.sha256(log.info.to_json().encode())
    for name in sorted(log.columns):
        digest.update(name.encode() + b"\0" + np.ascontiguousarray(log[name], dtype="<f8").tobytes())
    return digest.hexdigest()


def installed_version(package: str) -> str:
    """Version of a package, or ``not installed``."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
