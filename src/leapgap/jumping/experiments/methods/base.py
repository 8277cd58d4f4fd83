"""The settings from which a landing method is prepared."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from leapgap.jumping.experiments.method import Method

if TYPE_CHECKING:  # so that jumps are collected without the rig of landings
    from leapgap.jumping.experiments.rig import LandSettings, Rig


@dataclass(frozen=True)
class MethodSettings(ABC):
    """How a method is configured. To add a method, add a subclass in a file of this package.

    An entry of ``land.method_settings`` names the class by ``kind`` and gives its fields; a class whose fields all
    have defaults can be asked for by its own name, without an entry.
    """

    name: ClassVar[str]

    def check(self, name: str, settings: "LandSettings") -> None:
        """Raise an ``InputError`` where the settings cannot work, before anything is run; ``name`` is the method's."""
        del name, settings

    @abstractmethod
    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """Train the method on one simulated robot, where it needs that, and return it.

        Where an input is missing, one line is printed and None returned; the method is then left out.
        """
