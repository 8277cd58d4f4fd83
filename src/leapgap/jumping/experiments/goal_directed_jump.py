"""A jump that is planned online, from the measured stance to a goal that a landing model chooses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.control.condensed_qp import ROUNDING_S
from leapgap.jumping.control.goal_shift_jump import ShiftTracker, ground_pitch
from leapgap.jumping.control.leg_kinematics import StartFrame
from leapgap.jumping.control.shifted_plan import DEVIATIONS, Observation, ObservedJointPd
from leapgap.jumping.control.tracking import JumpController, PhaseGains, Reference
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.models.rigid_body import Z
from leapgap.jumping.planning.problem import Grid, Limits
from leapgap.jumping.planning.reference import to_jump
from leapgap.jumping.planning.solve import FamilyConfig, Solution, plan_family
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate

GOAL = ("x", "z", "pitch")
"""Layout of a goal and of a landing: m, m over the height of a robot that stands on level ground, rad nose-down."""


REWEIGHTINGS = 10  # Iterations of the reweighting; most data sets settle after three
LEAST_WEIGHT = 1e-4


@dataclass(frozen=True)
class AimConfig:
    """How landing errors are learned, and what they cost when a goal is chosen."""

    scale: tuple[float, float, float, float] = (0.2, 0.1, 0.2, 0.1)
    """Typical change of each input: x, z and pitch of the goal, and pitch of the stance; m, m, rad, rad."""
    length: float = 1.5  # Length scale of the kernel, in units of ``scale``
    trend_ridge: float = 1.0  # Ridge of the linear trend. A quadratic trend extrapolates badly, for example to a box.
    noise: float = 0.02  # Variance of what does not repeat from jump to jump, as a share of the kernel's variance
    astray: float = 2.5
    """A jump whose held-out error is this many times the median or more gets less weight, by the square of the ratio.
    Such jumps are usually those whose feet slipped, and they say nothing about jumps whose feet held."""
    matters: tuple[float, float, float] = (0.01, 0.03, 0.1)  # Landing errors that cost alike: m, m, rad
    clearance_m: float = 0.015  # Goals are so much above the target: no foot touches before the scheduled landing
    caution: float = 0.02  # Cost of a goal off the target, per squared ``scale``: of goals that land alike, the nearest
    largest: tuple[float, float, float] = (0.25, 0.15, 0.2)  # Largest distance of a goal from its target: m, m, rad


@dataclass(frozen=True)
class LandingSamples:
    """Goals, stances and landings of n jumps."""

    goal: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # Commanded goals, (n, 3), as ``GOAL``
    stance_pitch: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Pitch of the crouch on the ground before each jump, nose-down, (n,), rad."""
    landing: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # Poses at the end of the flight, (n, 3)

    def __len__(self) -> int:
        return len(self.stance_pitch)

    def extended_by(self, other: "LandingSamples") -> "LandingSamples":
        """These samples, followed by those of ``other``."""
        return LandingSamples(*(np.concatenate([own, vars(other)[name]]) for name, own in vars(self).items()))

    @property
    def inputs(self) -> np.ndarray:
        """Goals and stance pitches as inputs of the regression, (n, 4)."""
        return np.column_stack([self.goal, self.stance_pitch])


class LandingModel:
    """Landing − goal as a function of goal and stance: a linear trend and a Gaussian process on what it leaves."""

    def __init__(self, samples: LandingSamples, config: AimConfig) -> None:
        self.samples, self.config = samples, config
        self.centre = samples.inputs.mean(axis=0) if len(samples) else np.zeros(4)
        self.error = samples.landing - samples.goal
        self.sample_weights = np.ones(len(samples))  # Weight of each jump in the fit, 0 to 1, (n,)
        self._fit()
        for _ in range(REWEIGHTINGS):
            # A jump's weight is by its error when the process predicts it from all other jumps.
            heldout = self.dual / np.diag(self.inverse)[:, None] / np.array(config.matters)
            off = np.linalg.norm(heldout, axis=1)
            usual = max(float(np.median(off)), 1.0) if len(off) else 1.0  # errors below ``matters`` are no outliers
            self.sample_weights = np.clip((config.astray * usual / np.maximum(off, 1e-9)) ** 2, LEAST_WEIGHT, 1.0)
            self._fit()

    def _fit(self) -> None:
        """Fit the trend, then the process to its residuals; a jump of smaller weight counts as one with more noise."""
        samples, config = self.samples, self.config
        trend = self._trend(samples.inputs)
        weighted = trend.T * self.sample_weights
        ridge = config.trend_ridge * np.eye(trend.shape[1])
        ridge[0, 0] = 1e-6  # the mean error is free
        self.weights = np.linalg.solve(weighted @ trend + ridge, weighted @ self.error)
        noise = np.diag(config.noise / self.sample_weights)
        self.inverse = np.linalg.inv(self._kernel(samples.inputs, samples.inputs) + noise)
        residual = self.error - trend @ self.weights
        self.dual = self.inverse @ residual
        self.scatter = np.sqrt((residual * self.dual).sum(axis=0) / max(len(samples), 1))
        """Standard deviation of the process, by maximum likelihood, (3,), m, m, rad."""

    def landing(self, goal: np.ndarray, stance_pitch: float) -> np.ndarray:
        """Predicted landing pose, (3,), of a jump to ``goal`` (3,) from a stance of this pitch, rad; as ``GOAL``."""
        at = np.append(goal, stance_pitch)[None]
        return goal + (self._trend(at) @ self.weights + self._kernel(at, self.samples.inputs) @ self.dual)[0]

    def deviation(self, goal: np.ndarray, stance_pitch: float) -> np.ndarray:
        """Standard deviation of that prediction, (3,), m, m, rad; it grows with the distance from the samples."""
        k = self._kernel(np.append(goal, stance_pitch)[None], self.samples.inputs)[0]
        return self.scatter * np.sqrt(max(1 - k @ self.inverse @ k, 0.0))

    def _scaled(self, inputs: np.ndarray) -> np.ndarray:
        return (inputs - self.centre) / np.array(self.config.scale)

    def _trend(self, inputs: np.ndarray) -> np.ndarray:
        return np.column_stack([np.ones(len(inputs)), self._scaled(inputs)])

    def _kernel(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        apart = self._scaled(a)[:, None] - self._scaled(b)[None]
        return np.exp(-0.5 * (apart**2).sum(axis=2) / self.config.length**2)


def target_pose(target: Target) -> np.ndarray:
    """Pose of a perfect landing: on the target and level, (3,), as ``GOAL``."""
    return np.array([target.x_m, target.z_m, 0.0])


def best_goal(
    model: LandingModel | None, target: Target, stance_pitch: float, offset: np.ndarray | None = None
) -> np.ndarray:
    """The goal whose landing is expected nearest to the target, (3,); the target itself without a model.

    ``offset`` (3,) is how much farther than predicted this target's jumps have landed.
    """
    if model is None:
        return target_pose(target)
    from scipy.optimize import minimize  # most processes read this file and aim at nothing

    config = model.config
    desired = target_pose(target) + np.array([0.0, config.clearance_m, 0.0])
    bias = np.zeros(3) if offset is None else offset
    matters, scale, largest = (np.array(v) for v in (config.matters, config.scale[:3], config.largest))

    def cost(shift: np.ndarray) -> float:
        goal = desired + shift * scale
        error = (model.landing(goal, stance_pitch) + bias - desired) / matters
        deviation = model.deviation(goal, stance_pitch) / matters
        return float(error @ error + deviation @ deviation + config.caution * (shift @ shift))

    first = -(model.landing(desired, stance_pitch) + bias - desired)
    starts = (np.zeros(3), np.clip(first, -largest, largest) / scale)
    bounds = [(-edge, edge) for edge in largest / scale]
    found = [minimize(cost, start, method="L-BFGS-B", bounds=bounds) for start in starts]
    return desired + min(found, key=lambda one: float(one.fun)).x * scale


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
            others = (self.plan(target, goal, stance_pitch, robot) for robot in self.fallback_robots)
            return next(((goal, solution) for solution in others if solution is not None), None)
        for share in NEARER_GOALS:
            to = target_pose(target) * (1 - share) + goal * share
            solution = self.plan(target, to, stance_pitch)
            if solution is not None:
                return to, solution
        return target_pose(target), to_target


@dataclass(frozen=True)
class Stand:
    """How long a robot stands before it jumps: until it is still, since a robot that swings lands elsewhere.

    The limits are six standard deviations and more of what a robot at rest measures with ``SensorNoise``.
    """

    measured_s: float = 0.06  # Time over which the stance is measured, and the robot must be still; no stand is shorter
    longest_s: float = 0.4  # A robot that is not still by then jumps all the same
    still_m_s: float = 0.02  # Largest velocity of a base that is still along any axis, mean over a third of that time
    still_rad_s: float = 0.03  # The same of its turning rates

    def is_over(self, estimates: Sequence[StateEstimate]) -> bool:
        """Whether a robot with these estimates since it began to stand, one or more, may jump now."""
        stood_s = estimates[-1].time_s - estimates[0].time_s
        if stood_s < self.measured_s - ROUNDING_S:
            return False
        # Slow in each third of the time: where a base turns back, it is so for a moment.
        largest = np.repeat([self.still_m_s, self.still_rad_s], 3)
        newest = latest(estimates, self.measured_s)
        thirds = np.array_split(np.array([(*one.base_velocity, *one.base_angular_velocity) for one in newest]), 3)
        is_still = all((np.abs(third.mean(axis=0)) <= largest).all() for third in thirds)
        return is_still or stood_s >= self.longest_s - ROUNDING_S


@dataclass(frozen=True)
class GoalChoice:
    """Where a goal-directed jump goes, and how that is decided."""

    target: Target
    planner: JumpPlanner
    aim: Callable[[Target, float], np.ndarray]  # Goal (3,) for a target and the pitch of the stance, rad
    stance_is_seen: bool = True  # Whether the stance is measured; else it is taken for level
    stand: Stand = field(default_factory=Stand)
    observation: Observation = field(default_factory=Observation)  # When deviations from the plan are kept


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
            still = np.zeros(len(self.robot.joints))
            gains, plan = self.gains.stance, self.reference
            kp, kd = still + gains.kp_nm_per_rad, still + gains.kd_nms_per_rad
            return Command(plan.torque[0], plan.joint_pos[0], still, kp, kd, plan.force[0])
        stance = latest(self._stood[:-1], stand.measured_s)  # the jump begins with this estimate
        pitch = np.mean([ground_pitch(one, self.legs) for one in stance]) if self.choice.stance_is_seen else 0.0
        self.tracker = self.plan_from(float(pitch))
        self.start_s = estimate.time_s
        return self.tracker.command(estimate)

    def plan_from(self, stance_pitch: float) -> JumpController:
        """Plan from a stance of this pitch, rad; the controller that follows the plan."""
        self.stance_pitch = stance_pitch
        target, planner = self.choice.target, self.choice.planner
        chosen = self.choice.aim(target, self.stance_pitch)
        plan = planner.plan_nearest(target, chosen, self.stance_pitch)
        if plan is None:
            self.count_fallback(NO_PLAN)  # the plan from level ground is used instead
        else:
            self.goal, solution = plan
            if solution.problem.robot != planner.robot or not np.allclose(self.goal, chosen):
                self.count_fallback(OTHER_PLAN)
            self.reference = Reference.of(to_jump(solution), self.robot)
        return self.track(None if plan is None else plan[1])

    def track(self, solution: Solution | None) -> JumpController:
        """Controller that follows ``reference``, of the plan ``solution``; None: the plan from level ground."""
        del solution
        return ObservedJointPd(self.reference, self.robot, self.gains, self.choice.observation)

    @property
    def shifts(self) -> np.ndarray:
        """Shift of the goal from each update on, (updates, 3), where it is shifted."""
        return self.tracker.shifts if isinstance(self.tracker, ShiftTracker) else np.zeros((len(self.deviations), 3))

    @property
    def deviations(self) -> np.ndarray:
        """How far trunk and feet were from the (shifted) plan at each update, (updates, 10), where that is kept."""
        if isinstance(self.tracker, ObservedJointPd | ShiftTracker):
            return self.tracker.recorder.deviations
        return np.zeros((0, DEVIATIONS))

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques (joints,), N·m, and pair forces (4,), N, of the planned jump."""
        assert self.tracker is not None
        return self.tracker.feed_forward(time_s, estimate, frame)


def latest(estimates: Sequence[StateEstimate], duration_s: float) -> Sequence[StateEstimate]:
    """Those of the last ``duration_s``, which come one a control tick."""
    since_s = estimates[-1].time_s - duration_s + ROUNDING_S
    first = next(i for i, estimate in enumerate(estimates) if estimate.time_s > since_s)
    return estimates[first:]
