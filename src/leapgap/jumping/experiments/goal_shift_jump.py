"""A goal-directed jump whose goal is shifted while the robot pushes."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig
from leapgap.jumping.control.late_stance import LateStance
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.shifted_plan import GOAL_AXES, ShiftedPlan, differences
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.goal_directed_jump import GoalChoice, GoalDirectedJump, JumpPlanner
from leapgap.jumping.experiments.landing_feedback import LandingFeedback
from leapgap.jumping.experiments.landing_model import target_pose
from leapgap.jumping.planning.reference import Gains, to_jump
from leapgap.jumping.planning.solve import Solution, landing_goal
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate

NO_NEIGHBOURS = "no plans of neighbouring goals"
NO_OTHER_STANCE = "no plan from another stance, so that none can be measured in the jump"
STANCE_STEPS = (-0.05, 0.05)
"""Distance of the stance that the slope by the stance's pitch is taken from, rad: nose-up, as on a block ahead, and
nose-down where the first has no plan."""
LARGEST_TILT_RAD = 0.2
"""A stance that is measured in the jump and farther from the expected one is not believed."""
STANCES = 21
"""Number of stances within that distance whose goals are chosen before the jump: one every 0.02 rad."""
NEIGHBOUR_STEPS = (0.05, 0.04, 0.08)
"""Distance of the neighbouring goals that slopes are taken from: x, z, pitch; m, m, rad."""


@dataclass(frozen=True)
class ShiftSettings:
    """What a goal-shift jump needs beyond a goal-directed one."""

    config: GoalShiftConfig = field(default_factory=GoalShiftConfig)
    feedback: LandingFeedback | None = None
    """None: the goal is not shifted, but for exploration."""
    exploration: np.ndarray | None = None
    """Added to the shifts, (updates, 3), m, m, rad."""


class GoalShiftJump(GoalDirectedJump):
    """Plans to a goal and to its neighbours from the measured stance, then jumps with goal-shift MPC.

    ``shift_tracker`` holds what was shifted and measured; it is None where there were no neighbouring plans.
    """

    def __init__(
        self, choice: GoalChoice, first: Reference, robot: Robot, gains: PhaseGains, settings: ShiftSettings
    ) -> None:
        super().__init__(choice, first, robot, gains)
        self.settings = settings
        self.shift_tracker: ShiftTracker | None = None

    def track(self, solution: Solution | None) -> JumpController:
        """Goal-shift MPC along the plan; joint PD where there are no neighbouring plans."""
        plan = None if solution is None else shifted_plan(self.choice.planner, solution, self.reference, self.robot)
        if plan is None or self.goal is None or solution is None:
            if solution is not None:
                self._substitute(NO_NEIGHBOURS)
            return super().track(solution)
        settings, feedback = self.settings, self.settings.feedback
        late = None
        if not self.choice.stance_is_seen:
            slopes = stance_slopes(self.choice.planner, solution, self.reference, self.robot)
            if slopes is None:
                self._substitute(NO_OTHER_STANCE)
            else:
                plan, late = plan.with_stance(slopes), self._late_stance()
        self.shift_tracker = ShiftTracker(
            plan,
            self.robot,
            self.gains,
            settings.config,
            self.goal,
            self.stance_pitch,
            self._desired(),
            None if feedback is None else feedback.planned_to(self.goal),
            settings.exploration,
            late=late,
        )
        self.shift_tracker.fallbacks, self.shift_tracker.substituted = self.fallbacks, self.substituted
        return self.shift_tracker

    def command(self, estimate: StateEstimate) -> Command:
        """See ``GoalDirectedJump``; goal and stance are those that were measured late, where they were."""
        command = super().command(estimate)
        if self.shift_tracker is not None:
            self.goal, self.stance_pitch = self.shift_tracker.goal, self.shift_tracker.stance_pitch
        return command

    def _late_stance(self) -> LateStance:
        """Goals for all stances that may be measured in the jump."""
        pitches = self.stance_pitch + np.linspace(-LARGEST_TILT_RAD, LARGEST_TILT_RAD, STANCES)
        return LateStance(pitches, np.array([self.choice.aim(self.choice.target, pitch) for pitch in pitches]))

    def _desired(self) -> np.ndarray:
        """Landing (3,) that shifts of the goal aim at.

        The goal was chosen with all that was known before the jump. Where no goal is expected to land on the target,
        a shift must not try it either: its effect is known less there.
        """
        feedback = self.settings.feedback
        assert self.goal is not None
        if feedback is None:
            return target_pose(self.choice.target)
        return feedback.expect(self.goal, self.stance_pitch)

    @property
    def shifts(self) -> np.ndarray:
        """Shift of the goal from each update on, (updates, 3)."""
        return super().shifts if self.shift_tracker is None else self.shift_tracker.shifts

    @property
    def deviations(self) -> np.ndarray:
        """How far trunk and feet were from the shifted plan at each update, (updates, 10)."""
        return super().deviations if self.shift_tracker is None else self.shift_tracker.deviations


def shifted_plan(planner: JumpPlanner, solution: Solution, reference: Reference, robot: Robot) -> ShiftedPlan | None:
    """The plan and its slopes; where a neighbour on one side has no plan, that on the other side is taken."""
    problem = solution.problem
    target, goal = problem.target, landing_goal(problem)
    neighbours, steps = [], []
    for axis, size in enumerate(NEIGHBOUR_STEPS):
        for step in (size, -size):
            moved = goal + step * np.eye(GOAL_AXES)[axis]
            neighbour = planner.plan(target, moved, problem.stance_pitch_rad, problem.robot)
            if neighbour is not None:
                neighbours.append(Reference.of(to_jump(neighbour, Gains()), robot))
                steps.append(step)
                break
    return ShiftedPlan.of(reference, neighbours, steps) if len(steps) == GOAL_AXES else None


def stance_slopes(
    planner: JumpPlanner, solution: Solution, reference: Reference, robot: Robot
) -> dict[str, np.ndarray] | None:
    """Slopes of the plan by the pitch of the stance, (rows, n) for each quantity, per rad; None without a neighbour."""
    problem = solution.problem
    goal = landing_goal(problem)
    for step in STANCE_STEPS:
        tilted = planner.plan(problem.target, goal, problem.stance_pitch_rad + step, problem.robot)
        if tilted is not None:
            return differences(reference, Reference.of(to_jump(tilted, Gains()), robot), step)
    return None
