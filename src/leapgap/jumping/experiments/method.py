"""Base class of the landing methods: plain data from which the controllers of a task are made."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

References = Mapping[Target, Log]
"""Plans from level ground, by their targets."""


class PlanSource(Enum):
    """Which robot a method's jumps are planned for."""

    own = "own"
    """The robot as its model file describes it, without any correction."""
    published = "published"
    """The planar robot of the published planner."""
    corrected = "corrected"
    """The robot that a diagnosis corrected."""


@dataclass(frozen=True)
class Method(ABC):
    """Makes the controllers of a task. It is plain data, so that it can be sent to worker processes."""

    robot: Robot
    references: References
    gains: PhaseGains = field(default_factory=PhaseGains)

    def __call__(self, task: JumpTask) -> Sequence[JumpController]:
        """New controllers of the task's jumps, in their order."""
        return [self.controller(task, self.reference(task)) for _ in range(task.jumps)]

    def reference(self, task: JumpTask) -> Reference:
        """The plan of one of the task's jumps."""
        return Reference.of(self.references[task.target], self.robot)

    @abstractmethod
    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A new controller of one jump along its plan."""


def shift_target(target: Target, shift_m: float) -> Target:
    """The target moved ``shift_m`` farther away, rounded to the millimetre."""
    return Target(round(target.x_m + shift_m, 3), target.z_m)


def crouch(references: References, robot: Robot) -> np.ndarray:
    """Joint angles in which the plans begin, (joints,), rad."""
    return next(iter(references.values())).per_joint("cmd_pos", robot.joints)[0]
