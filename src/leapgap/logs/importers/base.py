"""Base class of log formats: it lists the logs in a folder and reads one of them."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar

from leapgap.logs.log import Log
from leapgap.robot.model import Robot


class LogFormat(ABC):
    """One log format. A subclass is one file here, or an entry point of another package."""

    name: ClassVar[str]
    Options: ClassVar[type]  # dataclass of options: what the files themselves do not state

    @abstractmethod
    def find(self, source: Path) -> dict[str, Path]:
        """Files of the logs below a folder, by the names the logs will have."""

    @abstractmethod
    def read(self, path: Path, name: str, robot: Robot, options: Any) -> Log:
        """One log; ``InputError`` names the file and what is wrong with it."""

    def read_all(self, path: Path, name: str, robot: Robot, options: Any) -> list[Log]:
        """All logs of one file, whose names begin with ``name``; a format whose files hold one each has no more."""
        return [self.read(path, name, robot, options)]
