"""A jump that is planned when it is due: from the stance that is measured, to the goal that lands on the target."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.landing import stand
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.reference import Reference, StartFrame
from leapgap.jumping.control.tracking import JointPd, JumpController
from leapgap.jumping.experiments.landing_model import wanted
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.models.rigid_body import Z
from leapgap.jumping.planning.problem import Aim, Grid, Limits, Problem
from leapgap.jumping.planning.reference import Gains, to_jump
from leapgap.jumping.planning.solve import Solution, solve
from leapgap.logs.segments import ContactSchedule, Target
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate

NO_PLAN = "no plan from this stance"
OTHER_PLAN = "no plan to this goal, a nearer one or of a nimbler robot"
NEARER = (0.8, 0.6, 0.4, 0.2)
"""Shares of the way from the target to a goal that has no plan."""


AIMED_LIMITS = Limits(friction=0.6, knee_clearance_m=0.04, swing_clearance_m=0.02)
"""Of plans for robots that land where they are aimed.

The friction is the cone of the MPC: a box is out of reach of stiff joints within the published 0.4. On a block of 8 cm
the knees in the crouch are lower than the published 5 cm. The front feet, once they swing, keep clear of floor and box.
"""


@dataclass(frozen=True)
class JumpPlanner:
    """Plans jumps of one robot on one schedule."""

    robot: PlanarRobot
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    limits: Limits = field(default_factory=Limits)
    nimbler: tuple[PlanarRobot, ...] = ()
    """What to plan for where the robot itself cannot do it: it lands off, but repeats, which can be learned."""

    def plan(
        self, target: Target, goal: np.ndarray, stance_pitch: float, robot: PlanarRobot | None = None
    ) -> Solution | None:
        """To a goal (x, z, pitch); None where there is no such jump."""
        aim = Aim(*(float(v) for v in goal - wanted(target)))
        problem = Problem(
            target,
            Grid(self.schedule),
            robot or self.robot,
            limits=self.limits,
            stance_pitch_rad=stance_pitch,
            aim=aim,
        )
        solution = solve(problem)
        return solution if solution.solved else None

    def nearest(self, target: Target, goal: np.ndarray, stance_pitch: float) -> tuple[np.ndarray, Solution] | None:
        """The plan to the goal; where there is none to one between it and the target, or for a nimbler robot."""
        aimed = self.plan(target, goal, stance_pitch)
        if aimed is not None:
            return goal, aimed
        straight = self.plan(target, wanted(target), stance_pitch)
        if straight is None:
            return self._for_a_nimbler_robot(target, goal, stance_pitch)
        for share in NEARER:
            to = wanted(target) * (1 - share) + goal * share
            solution = self.plan(target, to, stance_pitch)
            if solution is not None:
                return to, solution
        return wanted(target), straight

    def _for_a_nimbler_robot(
        self, target: Target, goal: np.ndarray, stance_pitch: float
    ) -> tuple[np.ndarray, Solution] | None:
        for robot in self.nimbler:
            solution = self.plan(target, goal, stance_pitch, robot)
            if solution is not None:
                return goal, solution
        return None


class GoalDirectedJump(JumpController):
    """Stands, measures its stance, plans to the goal ``aim(target, stance pitch)``, and jumps with joint PD.

    ``goal`` and ``stance_pitch`` say afterwards what was planned. The jump begins at ``start_s``, after standing.
    """

    def __init__(
        self,
        target: Target,
        first: Reference,
        planner: JumpPlanner,
        aim: Callable[[Target, float], np.ndarray],
        robot: Robot,
        gains: PhaseGains,
        stand_s: float = 0.06,
    ) -> None:
        super().__init__(first, robot, gains)
        self.target, self.planner, self.aim, self.gains, self.stand_s = target, planner, aim, gains, stand_s
        self.tracker: JointPd | None = None
        self.standing_height_m = float(first.state[0, Z])
        self.goal: np.ndarray | None = None
        self.stance_pitch = 0.0
        self._stood: list[StateEstimate] = []

    def command(self, estimate: StateEstimate) -> Command:
        """Stand for a while, then jump."""
        if self.tracker is not None:
            return self.tracker.command(estimate)
        if not self._stood or estimate.time_s - self._stood[0].time_s < self.stand_s - 1e-9:
            self._stood.append(estimate)
            return self._standing(estimate)
        self.stance_pitch = stance_pitch(self._stood, self.legs)
        wished = self.aim(self.target, self.stance_pitch)
        found = self.planner.nearest(self.target, wished, self.stance_pitch)
        if found is None:
            self._substitute(NO_PLAN)  # what was planned for level ground is the best there is
        else:
            self.goal, solution = found
            if solution.problem.robot != self.planner.robot or not np.allclose(self.goal, wished):
                self._substitute(OTHER_PLAN)
            self.reference = Reference.of(to_jump(solution, Gains()), self.robot)
        self.tracker = JointPd(self.reference, self.robot, self.gains)
        self.start_s = estimate.time_s
        return self.tracker.command(estimate)

    def _substitute(self, reason: str) -> None:
        self.fallbacks[reason] += 1
        self.substituted.append((0.0, reason))

    def _standing(self, estimate: StateEstimate) -> Command:
        """As before the jump: the first pose of the reference and the torques that hold the robot in it."""
        pose = self.targets.position[0]
        command = stand(self.robot, self.legs, estimate, StartFrame.of(estimate), np.zeros(4), pose, self.gains.stance)
        return Command(
            self.reference.torque[0], pose, command.velocity, command.kp, command.kd, self.reference.force[0]
        )

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Of the planned jump."""
        assert self.tracker is not None
        return self.tracker.feed_forward(time_s, estimate, frame)


def stance_pitch(stood: list[StateEstimate], legs: LegKinematics) -> float:
    """Pitch that a robot in the crouch has on the ground below its feet, rad: the slope from rear to front feet.

    Mean over the estimates: kinematics of the encoders, turned by the measured attitude.
    """
    slopes = []
    for estimate in stood:
        front, rear = legs.pair_offsets(estimate.base_quaternion, estimate.joint_pos)
        across = np.hypot(*(front - rear)[:2])
        slopes.append(-np.arctan2(front[2] - rear[2], across))
    return float(np.mean(slopes))
