"""MPC of the landing: from the touch-down of both pairs on, its forces bring the body to rest over the feet."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.jumping.control.border import TIME_NOT_USABLE, Border
from leapgap.jumping.control.condensed_qp import ForceLimits, prepare_qp
from leapgap.jumping.control.gains import JointGains
from leapgap.jumping.control.guarded_solve import NOT_FINITE, SolutionRequirements, guarded_solve
from leapgap.jumping.control.horizon import ROUNDING_S, Horizon
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.mpc_config import StateWeights
from leapgap.jumping.control.qp import Qp, QpConfig, solver
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.models.affine_model import AffineModel, Situation
from leapgap.jumping.models.rigid_body import GRAVITY, POSITION, RigidBody, X, Z
from leapgap.jumping.models.rigid_body_model import RigidBodyModel
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, FORCES
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, Controller, StateEstimate


@dataclass(frozen=True)
class LandingConfig:
    """Settings of the landing's MPC. Steps, duration and soft joint gains are as published, the weights are our own."""

    steps: int = 10
    step_s: float = 0.025
    """Length of a step, and time between updates."""
    duration_s: float = 0.2
    height_m: float = 0.18
    """Height of the base over the soles of its feet, at rest."""
    weights: StateWeights = field(
        default_factory=lambda: StateWeights(x=50.0, z=100.0, pitch=100.0, vx=10.0, vz=5.0, pitch_rate=5.0)
    )
    force_weight: float = 1e-5
    """Cost of a force's difference from half the robot's weight on each pair, per N²."""
    limits: ForceLimits = field(default_factory=lambda: ForceLimits(friction=0.6, largest_n=350.0, smallest_n=10.0))
    gains: JointGains = field(default_factory=lambda: JointGains(5.0, 1.0))
    qp: QpConfig = field(default_factory=QpConfig)
    demands: SolutionRequirements = field(default_factory=SolutionRequirements)

    def __post_init__(self) -> None:
        """Refuse values that mean nothing."""
        lengths = (self.step_s, self.duration_s, self.height_m, self.force_weight)
        if self.steps < 1 or not all(0 < one < np.inf for one in lengths):
            raise ValueError("steps of 1 or more, and step_s, duration_s, height_m, force_weight finite and above 0")


class LandingMpc(Controller):
    """Plans forces of all feet towards rest: level, midway between the feet, at a height over them.

    ``pose`` (joints,) rad is what the soft joint PD pulls towards. An update that fails sends the robot's weight.
    """

    def __init__(
        self,
        robot: Robot,
        pose: np.ndarray,
        config: LandingConfig,
        body: RigidBody,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.robot, self.pose, self.config, self.clock = robot, pose, config, clock
        self.model = RigidBodyModel(body)
        self.legs = LegKinematics(robot)
        self.border = Border(robot)
        self.solver = solver(config.qp)
        self.fallbacks: Counter[str] = Counter()
        self.force = standing_force(self.model.body)
        self._next_update_s = -np.inf

    def command(self, estimate: StateEstimate) -> Command:
        """See ``Controller``: the first force of the latest plan, with a soft joint PD."""
        judged = self.border.judged(estimate)
        if judged is None:
            self.fallbacks[TIME_NOT_USABLE] += 1
            return self.border.safe_command()
        if judged.time_s > self._next_update_s - ROUNDING_S:
            self._next_update_s = judged.time_s + self.config.step_s
            self.force = self._plan(judged)
        frame = StartFrame.of(judged)  # only the heading matters here: a force has no origin
        command = stand(self.robot, self.legs, judged, frame, self.force, self.pose, self.config.gains)
        return self.border.sent(limited(command, self.border))

    def _plan(self, estimate: StateEstimate) -> np.ndarray:
        """First force towards rest, (4,), N; the weight of the robot where there is no solution."""
        result = guarded_solve(lambda: self._problem(estimate), self.solver, self.config.demands, self.clock)
        if result.fault is None and result.solution is not None:
            return result.solution.x[: len(self.force)]
        self.fallbacks[result.fault or NOT_FINITE] += 1
        return standing_force(self.model.body)

    def _problem(self, estimate: StateEstimate) -> Qp | None:
        """The QP from the present state to the goal with fixed feet; the model is taken on the straight line to it."""
        config, frame = self.config, StartFrame.of(estimate)
        state, foot = frame.state(estimate), frame.foot(estimate, self.legs)
        if not (np.isfinite(state).all() and np.isfinite(foot).all()):
            return None
        goal = np.zeros(6)
        goal[X] = state[X] + foot[FORCE_X].mean()
        goal[Z] = state[Z] + foot[FORCE_Z].mean() - float(self.robot.foot_radius.mean()) + config.height_m
        steps = Horizon(config.step_s * np.arange(config.steps + 1), np.ones((config.steps, 2)))
        way = state + (goal - state) * np.linspace(0, 1, config.steps + 1)[:-1, None]
        feet = np.tile(foot, (config.steps, 1))
        feet[:, FORCE_X] -= (way - state)[:, POSITION][:, [X]]
        feet[:, FORCE_Z] -= (way - state)[:, POSITION][:, [Z]]
        there = Situation(way, feet, steps.time_s[:-1], np.tile(state, (config.steps, 1)))
        affine = self.model.affine(there, np.ones(config.steps, bool))
        later, first = (AffineModel(affine.bias[part], affine.by_force[part]) for part in (slice(1, None), slice(1)))
        targets = np.tile(goal, (config.steps, 1))
        force = np.tile(standing_force(self.model.body), (config.steps, 1))
        prepared = prepare_qp(steps, later, targets, force, config.weights.diagonal, config.force_weight, config.limits)
        return prepared.qp(state, first)


def limited(command: Command, border: Border) -> Command:
    """A command whose torques the motors can deliver."""
    torque, force = border.within_limits(command.torque, command.planned_force)
    return replace(command, torque=torque, planned_force=force)


def standing_force(body: RigidBody) -> np.ndarray:
    """The body's weight, half on each pair, (4,), N."""
    force = np.zeros(FORCES)
    force[FORCE_Z] = body.mass_kg * GRAVITY / 2
    return force


def stand(
    robot: Robot,
    legs: LegKinematics,
    estimate: StateEstimate,
    frame: StartFrame,
    force: np.ndarray,
    pose: np.ndarray,
    gains: JointGains,
) -> Command:
    """Command of a stance: planar pair forces (4,), N, as torques, and a joint PD towards a pose (joints,), rad."""
    finite = np.isfinite(estimate.base_quaternion).all() and np.isfinite(estimate.joint_pos).all()
    torque = legs.torque(estimate.base_quaternion, estimate.joint_pos, frame.in_world(force)) if finite else 0 * pose
    still = np.zeros(len(robot.joints))
    return Command(torque, pose, still, still + gains.kp_nm_per_rad, still + gains.kd_nms_per_rad, force)
