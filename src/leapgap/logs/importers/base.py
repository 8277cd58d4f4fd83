"""What a format of foreign logs is: it finds the logs in a folder, and turns one into a log of ours."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar

from leapgap.logs.log import Log
from leapgap.robot.model import Robot


class LogFormat(ABC):
    """One format. A subclass is one file here, or offered by another package as an entry point."""

    name: ClassVar[str]
    Options: ClassVar[type]
    """Dataclass of what the files do not say themselves."""

    @abstractmethod
    def find(self, source: Path) -> dict[str, Path]:
        """The logs below a folder, each with the name it will have."""

    @abstractmethod
    def read(self, path: Path, name: str, robot: Robot, options: Any) -> Log:
        """One log; ``InputError`` names the file and what is wrong with it."""
