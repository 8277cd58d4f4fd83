"""Jumps by goal-shift MPC to goals that a landing model chooses."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.goal_directed_jump import GoalChoice, JumpPlanner
from leapgap.jumping.experiments.goal_shift_jump import GoalShiftJump, ShiftSettings
from leapgap.jumping.experiments.landing_feedback import LandingFeedback
from leapgap.jumping.experiments.landing_model import best_goal
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.task import Target


@dataclass(frozen=True)
class GoalShiftMethod(Method):
    """Goal-shift MPC along plans from the measured stance to the goal that the model says will land on the target."""

    planner: JumpPlanner | None = None
    feedback: LandingFeedback | None = None
    config: GoalShiftConfig = field(default_factory=GoalShiftConfig)
    goal_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Added to each goal for exploration, (3,), m, m, rad."""
    exploration: np.ndarray | None = None
    """Added to the shifts, (updates, 3), m, m, rad."""

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A jump that is planned after the stance was measured, and shifted on the way."""
        assert self.planner is not None
        landing = None if self.feedback is None else self.feedback.landing

        def aim(target: Target, stance_pitch: float) -> np.ndarray:
            return best_goal(landing, target, stance_pitch) + self.goal_offset

        settings = ShiftSettings(self.config, self.feedback, self.exploration)
        choice = GoalChoice(task.target, self.planner, aim, task.stance_is_seen)
        return GoalShiftJump(choice, reference, self.robot, self.gains, settings)
