"""Plans from the measured stance to the goal that a landing model says will land on the target."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.jumping.control.deviation_recorder import Observation
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.goal_directed_jump import GoalChoice, GoalDirectedJump, JumpPlanner
from leapgap.jumping.experiments.landing_model import LandingModel, best_goal
from leapgap.jumping.experiments.method import Method, References
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.task import Target


@dataclass(frozen=True)
class AimingMethod(Method):
    """Plans from the measured stance to the goal that a landing model says will land on the target."""

    planner: JumpPlanner | None = None
    landing: LandingModel | None = None
    offset: Mapping[str, np.ndarray] = field(default_factory=dict)
    """By name of the task: mean landing − predicted landing of its jumps, (3,), m, m, rad."""
    goal_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Added to each goal for exploration, (3,), m, m, rad."""
    observation: Observation = field(default_factory=Observation)
    """When deviations from the plan are kept."""

    def explore(self, offset: np.ndarray, references: References, rng: np.random.Generator) -> "AimingMethod":
        """The method with an offset (3,) of its goals."""
        del rng
        return replace(self, goal_offset=offset, references=references)

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A jump that is planned after the stance was measured."""
        assert self.planner is not None
        offset = self.offset.get(task.name)

        def aim(target: Target, stance_pitch: float) -> np.ndarray:
            return best_goal(self.landing, target, stance_pitch, offset) + self.goal_offset

        choice = GoalChoice(task.target, self.planner, aim, task.stance_is_seen, observation=self.observation)
        return GoalDirectedJump(choice, reference, self.robot, self.gains)
