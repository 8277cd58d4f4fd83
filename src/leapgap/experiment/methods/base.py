"""What every landing method is: data that makes controllers, and the settings from which it is prepared."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from leapgap.control.gains import PhaseGains
from leapgap.control.reference import Reference
from leapgap.control.tracking import JumpController
from leapgap.experiment.tasks import Task
from leapgap.recording.jump import Jump, Target
from leapgap.robot.model import Robot

if TYPE_CHECKING:
    from leapgap.experiment.rig import LandSettings, Rig

References = Mapping[Target, Jump]
"""Plans from level ground, by their targets."""


@dataclass(frozen=True)
class Method(ABC):
    """Makes the controllers of a task; data, so that it travels to worker processes."""

    robot: Robot
    references: References
    gains: PhaseGains = field(default_factory=PhaseGains)

    def __call__(self, task: Task) -> Sequence[JumpController]:
        """Fresh controllers of the task's jumps, in their order."""
        return [self.controller(task, self.reference(task)) for _ in range(task.jumps)]

    def reference(self, task: Task) -> Reference:
        """The plan of one of the task's jumps."""
        return Reference.of(self.references[task.target], self.robot)

    @abstractmethod
    def controller(self, task: Task, reference: Reference) -> JumpController:
        """A fresh controller of one jump along its plan."""


class PlanSource(Enum):
    """Which robot a method's jumps are planned for."""

    own = "own"
    """The nominal robot."""
    published = "published"
    """The planar robot of the published planner."""
    corrected = "corrected"
    """The robot that a diagnosis corrected."""


@dataclass(frozen=True)
class MethodSettings(ABC):
    """How a method is configured. A subclass in a file of this package is all that a further method takes.

    An entry of ``land.method_settings`` names the class by ``kind`` and gives its fields; a class whose fields all
    have defaults can be asked for by its own name, without an entry.
    """

    name: ClassVar[str]

    def check(self, name: str, settings: "LandSettings") -> None:
        """Refuse, with an ``InputError``, what cannot work, before anything is run; ``name`` is the method's."""
        del name, settings

    @abstractmethod
    def prepare(self, name: str, rig: "Rig") -> Method | None:
        """The method on one simulated robot, after whatever it has to learn there.

        None, and one printed line, where something that it needs is not there: the method is then left out.
        """


def shifted(target: Target, shift_m: float) -> Target:
    """A target farther away, to the millimetre."""
    return Target(round(target.x_m + shift_m, 3), target.z_m)


def crouch(references: References, robot: Robot) -> np.ndarray:
    """Joints that the plans begin with, (joints,), rad."""
    return next(iter(references.values())).per_joint("cmd_pos", robot.joints)[0]
