"""Ways to make a task's jumps; each is data, so that it travels to worker processes, and makes fresh controllers."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from leapgap.control.gains import PhaseGains
from leapgap.control.mpc import JumpMpc
from leapgap.control.planner import MpcConfig
from leapgap.control.reference import Reference
from leapgap.control.tracking import JointPd, JumpController
from leapgap.experiment.aimed import AimedJump, JumpPlanner
from leapgap.experiment.aiming import LandingModel, best_goal
from leapgap.experiment.tasks import Task
from leapgap.recording.jump import Jump, Target
from leapgap.robot.model import Robot
from leapgap.robot.prediction import PredictionModel

References = Mapping[Target, Jump]
"""Plans from level ground, by their targets."""


@dataclass(frozen=True)
class Method(ABC):
    """Makes the controllers of a task."""

    robot: Robot
    references: References
    gains: PhaseGains = field(default_factory=PhaseGains)

    def __call__(self, task: Task) -> Sequence[JumpController]:
        """Of the task's jumps, in their order."""
        return [self.controller(task, self.reference(task)) for _ in range(task.jumps)]

    def reference(self, task: Task) -> Reference:
        """The plan of one of the task's jumps."""
        return Reference.of(self.references[task.target], self.robot)

    @abstractmethod
    def controller(self, task: Task, reference: Reference) -> JumpController:
        """Of one jump."""


@dataclass(frozen=True)
class ByJointPd(Method):
    """Joint PD and the planned torques, of a plan that goes ``shift_m`` farther than the target."""

    shift_m: float = 0.0

    def reference(self, task: Task) -> Reference:
        """The shifted plan."""
        return Reference.of(self.references[shifted(task.target, self.shift_m)], self.robot)

    def controller(self, task: Task, reference: Reference) -> JumpController:
        """As said."""
        return JointPd(reference, self.robot, self.gains)


@dataclass(frozen=True)
class ByMpc(Method):
    """The paper's MPC with a prediction model."""

    model: PredictionModel | None = None
    config: MpcConfig = field(default_factory=MpcConfig)

    def controller(self, task: Task, reference: Reference) -> JumpController:
        """As said."""
        assert self.model is not None
        return JumpMpc(reference, self.robot, self.gains, self.model, self.config)


@dataclass(frozen=True)
class ByAiming(Method):
    """Plans from the measured stance to the goal that a landing model says will land on the target."""

    planner: JumpPlanner | None = None
    landing: LandingModel | None = None
    offset: Mapping[str, np.ndarray] = field(default_factory=dict)
    """By task: how much farther than predicted its jumps have landed, (3,)."""
    beyond: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Added to each goal, to try something new, (3,)."""

    def controller(self, task: Task, reference: Reference) -> JumpController:
        """As said."""
        assert self.planner is not None
        offset = self.offset.get(task.name)

        def aim(target: Target, stance_pitch: float) -> np.ndarray:
            return best_goal(self.landing, target, stance_pitch, offset) + self.beyond

        return AimedJump(task.target, reference, self.planner, aim, self.robot, self.gains)


def shifted(target: Target, shift_m: float) -> Target:
    """A target farther away, to the millimetre."""
    return Target(round(target.x_m + shift_m, 3), target.z_m)
