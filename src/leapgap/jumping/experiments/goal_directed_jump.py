"""A jump that is planned online, from the measured stance to a goal that a landing model chooses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.control.deviation_recorder import Observation, ObservedJointPd
from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.horizon import ROUNDING_S
from leapgap.jumping.control.landing import stand
from leapgap.jumping.control.late_stance import ground_pitch
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.shifted_plan import GOAL_AXES
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.experiments.landing_model import target_pose
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.models.rigid_body import Z
from leapgap.jumping.planning.family import FamilyConfig, plan_family
from leapgap.jumping.planning.problem import Grid, Limits
from leapgap.jumping.planning.reference import Gains, to_jump
from leapgap.jumping.planning.solve import Solution
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate

NO_PLAN = "no plan from this stance"
OTHER_PLAN = "no plan to this goal, a nearer one or of a fallback_robots robot"
NEARER_GOALS = (0.8, 0.6, 0.4, 0.2)
"""Where a goal has no plan, goals at these shares of the way from the target to it are planned instead, in order."""


AIMING_LIMITS = Limits(friction=0.6, knee_clearance_m=0.04, swing_clearance_m=0.02)
"""Limits of the plans of goal-directed jumps.

The friction is that of the MPC's cone: with the published 0.4, stiff joints cannot reach a box. The knee clearance is
less than the published 5 cm, because knees in the crouch are lower than that on a block of 8 cm. Swinging front feet
keep clear of floor and box.
"""


@dataclass(frozen=True)
class JumpPlanner:
    """Plans jumps of one robot with one contact schedule; the plans form one smooth family."""

    robot: PlanarRobot
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    limits: Limits = field(default_factory=Limits)
    fallback_robots: tuple[PlanarRobot, ...] = ()
    """Robots to plan for where ``robot`` itself cannot do a jump. The landing error is larger, but it repeats, so that
    a landing model can learn it."""
    family: FamilyConfig = field(default_factory=FamilyConfig)

    def plan(
        self, target: Target, goal: np.ndarray, stance_pitch: float, robot: PlanarRobot | None = None
    ) -> Solution | None:
        """Plan a jump to a goal (x, z, pitch; m, m, rad); None where there is none within the limits."""
        family = plan_family(robot or self.robot, Grid(self.schedule), self.limits, self.family)
        solution = family.plan(target, goal, stance_pitch)
        return solution if solution.solved else None

    def reaches(self, goals: Sequence[np.ndarray]) -> bool:
        """Whether there are plans from level ground to all goals (3,), on the floor ahead."""
        return all(self.plan(Target(float(goal[0])), goal, 0.0) is not None for goal in goals)

    def plan_nearest(self, target: Target, goal: np.ndarray, stance_pitch: float) -> tuple[np.ndarray, Solution] | None:
        """A goal and its plan: ``goal``, else the nearest between it and the target, else for a fallback robot."""
        direct = self.plan(target, goal, stance_pitch)
        if direct is not None:
            return goal, direct
        to_target = self.plan(target, target_pose(target), stance_pitch)
        if to_target is None:
            return self._plan_for_fallback_robots(target, goal, stance_pitch)
        for share in NEARER_GOALS:
            to = target_pose(target) * (1 - share) + goal * share
            solution = self.plan(target, to, stance_pitch)
            if solution is not None:
                return to, solution
        return target_pose(target), to_target

    def _plan_for_fallback_robots(
        self, target: Target, goal: np.ndarray, stance_pitch: float
    ) -> tuple[np.ndarray, Solution] | None:
        for robot in self.fallback_robots:
            solution = self.plan(target, goal, stance_pitch, robot)
            if solution is not None:
                return goal, solution
        return None


@dataclass(frozen=True)
class Stand:
    """How long a robot stands before it jumps: until it is still, since a robot that swings lands elsewhere.

    The limits are six standard deviations and more of what a robot at rest measures with ``SensorNoise``.
    """

    measured_s: float = 0.06
    """Time over which the stance is measured, and the robot must be still; no stand is shorter."""
    longest_s: float = 0.4
    """A robot that is not still by then jumps all the same."""
    still_m_s: float = 0.02
    """Largest velocity of a base that is still along any axis, mean over a third of that time."""
    still_rad_s: float = 0.03
    """The same of its turning rates."""

    def is_over(self, estimates: Sequence[StateEstimate]) -> bool:
        """Whether a robot with these estimates since it began to stand, one or more, may jump now."""
        stood_s = estimates[-1].time_s - estimates[0].time_s
        if stood_s < self.measured_s - ROUNDING_S:
            return False
        return stood_s >= self.longest_s - ROUNDING_S or self._is_still(latest(estimates, self.measured_s))

    def _is_still(self, estimates: Sequence[StateEstimate]) -> bool:
        """Whether the base is slow in each third of some estimates: where it turns back, it is so for a moment."""
        largest = np.repeat([self.still_m_s, self.still_rad_s], 3)
        rates = np.array([(*one.base_velocity, *one.base_angular_velocity) for one in estimates])
        return all((np.abs(third.mean(axis=0)) <= largest).all() for third in np.array_split(rates, 3))


@dataclass(frozen=True)
class GoalChoice:
    """Where a goal-directed jump goes, and how that is decided."""

    target: Target
    planner: JumpPlanner
    aim: Callable[[Target, float], np.ndarray]
    """Goal (3,) for a target and the pitch of the stance, rad."""
    stance_is_seen: bool = True
    """Whether the stance is measured; else it is taken for level."""
    stand: Stand = field(default_factory=Stand)
    observation: Observation = field(default_factory=Observation)
    """When deviations from the plan are kept."""


class GoalDirectedJump(JumpController):
    """Stands, measures its stance, plans to the goal of its ``choice``, and jumps with joint PD.

    The jump begins at ``start_s``, after standing; from then on ``goal`` and ``stance_pitch`` hold what was planned.
    """

    def __init__(self, choice: GoalChoice, first: Reference, robot: Robot, gains: PhaseGains) -> None:
        """``first``: the robot stands in its first pose, and follows it where it finds no plan."""
        super().__init__(first, robot, gains)
        self.choice, self.gains = choice, gains
        self.tracker: JumpController | None = None
        self.standing_height_m = float(first.state[0, Z])
        self.goal: np.ndarray | None = None
        self.stance_pitch = 0.0
        self._stood: list[StateEstimate] = []

    def command(self, estimate: StateEstimate) -> Command:
        """Stand, then plan and jump."""
        if self.tracker is not None:
            return self.tracker.command(estimate)
        stand = self.choice.stand
        self._stood.append(estimate)
        if len(self._stood) == 1 or not stand.is_over(self._stood):
            return self._standing(estimate)
        stance = latest(self._stood[:-1], stand.measured_s)  # the jump begins with this estimate
        self.tracker = self.plan_from(stance_pitch(stance, self.legs) if self.choice.stance_is_seen else 0.0)
        self.start_s = estimate.time_s
        return self.tracker.command(estimate)

    def plan_from(self, stance_pitch: float) -> JumpController:
        """Plan from a stance of this pitch, rad; the controller that follows the plan."""
        self.stance_pitch = stance_pitch
        target, planner = self.choice.target, self.choice.planner
        chosen = self.choice.aim(target, self.stance_pitch)
        plan = planner.plan_nearest(target, chosen, self.stance_pitch)
        if plan is None:
            self._substitute(NO_PLAN)  # the plan from level ground is used instead
        else:
            self.goal, solution = plan
            if solution.problem.robot != planner.robot or not np.allclose(self.goal, chosen):
                self._substitute(OTHER_PLAN)
            self.reference = Reference.of(to_jump(solution, Gains()), self.robot)
        return self.track(None if plan is None else plan[1])

    def track(self, solution: Solution | None) -> JumpController:
        """Controller that follows ``reference``, of the plan ``solution``; None: the plan from level ground."""
        del solution
        return ObservedJointPd(self.reference, self.robot, self.gains, self.choice.observation)

    @property
    def shifts(self) -> np.ndarray:
        """Shift of the goal from each update on, (updates, 3): none in such a jump."""
        return np.zeros((len(self.deviations), GOAL_AXES))

    @property
    def deviations(self) -> np.ndarray:
        """How far trunk and feet were from the plan at each update, (updates, 10)."""
        assert isinstance(self.tracker, ObservedJointPd)
        return self.tracker.recorder.deviations

    def _substitute(self, reason: str) -> None:
        self.fallbacks[reason] += 1
        self.substituted.append((0.0, reason))

    def _standing(self, estimate: StateEstimate) -> Command:
        """The first pose of the reference, and the torques that hold the robot in it."""
        pose = self.targets.position[0]
        command = stand(self.robot, self.legs, estimate, StartFrame.of(estimate), np.zeros(4), pose, self.gains.stance)
        return Command(
            self.reference.torque[0], pose, command.velocity, command.kp, command.kd, self.reference.force[0]
        )

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques (joints,), N·m, and pair forces (4,), N, of the planned jump."""
        assert self.tracker is not None
        return self.tracker.feed_forward(time_s, estimate, frame)


def latest(estimates: Sequence[StateEstimate], duration_s: float) -> Sequence[StateEstimate]:
    """Those of the last ``duration_s``, which come one a control tick."""
    since_s = estimates[-1].time_s - duration_s + ROUNDING_S
    first = next(i for i, estimate in enumerate(estimates) if estimate.time_s > since_s)
    return estimates[first:]


def stance_pitch(estimates: Sequence[StateEstimate], legs: LegKinematics) -> float:
    """Pitch of the ground under a robot in the crouch, rad, nose-down; mean over the estimates."""
    return float(np.mean([ground_pitch(estimate, legs) for estimate in estimates]))
