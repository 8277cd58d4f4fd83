"""Several jumps in a row: jump, land, settle, next jump, each from its own take-off pose."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.border import TIME_NOT_USABLE, Border
from leapgap.jumping.control.condensed_qp import ROUNDING_S, ForceLimits, Horizon, prepare_qp
from leapgap.jumping.control.leg_kinematics import LegKinematics, StartFrame
from leapgap.jumping.control.mpc import StateWeights
from leapgap.jumping.control.qp import Qp, QpConfig, SolutionRequirements, guarded_solve, solver
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.models.rigid_body import GRAVITY, POSITION, AffineModel, RigidBody, RigidBodyModel, Situation, X, Z
from leapgap.jumping.task import JointGains
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, FORCES
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS
from leapgap.simulation.controller import Command, Controller, StateEstimate


@dataclass(frozen=True)
class LandingConfig:
    """Settings of the landing's MPC. Steps, duration and soft joint gains are as published, the weights are our own."""

    steps: int = 10
    step_s: float = 0.025  # Length of a step, and time between updates
    duration_s: float = 0.2
    height_m: float = 0.18  # Height of the base over the soles of its feet, at rest
    weights: StateWeights = field(
        default_factory=lambda: StateWeights(x=50.0, z=100.0, pitch=100.0, vx=10.0, vz=5.0, pitch_rate=5.0)
    )
    force_weight: float = 1e-5  # Cost of a force's difference from half the robot's weight on each pair, per N²
    limits: ForceLimits = field(default_factory=lambda: ForceLimits(friction=0.6, largest_n=350.0, smallest_n=10.0))
    gains: JointGains = field(default_factory=lambda: JointGains(5.0, 1.0))
    qp: QpConfig = field(default_factory=QpConfig)
    demands: SolutionRequirements = field(default_factory=SolutionRequirements)

    def __post_init__(self) -> None:
        lengths = (self.step_s, self.duration_s, self.height_m, self.force_weight)
        if self.steps < 1 or not all(0 < one < np.inf for one in lengths):
            raise ValueError("steps of 1 or more, and step_s, duration_s, height_m, force_weight finite and above 0")


class LandingMpc(Controller):
    """Plans forces of all feet towards rest: level, midway between the feet, at a height over them.

    ``pose`` (joints,) rad is what the soft joint PD pulls towards. An update that fails sends the robot's weight.
    """

    def __init__(self, robot: Robot, pose: np.ndarray, config: LandingConfig, body: RigidBody) -> None:
        self.robot, self.pose, self.config = robot, pose, config
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
        result = guarded_solve(self._problem(estimate), self.solver, self.config.demands)
        if result.x is not None:
            return result.x[: len(self.force)]
        self.fallbacks[result.fault] += 1
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


Phase = Literal["jump", "landing", "settling"]


@dataclass(frozen=True)
class SequenceConfig:
    """Times at which a phase ends and the next one begins."""

    landing: LandingConfig = field(default_factory=LandingConfig)
    earliest_touch_s: float = 0.05  # Time after the planned take-off; feet that touch earlier have not left the ground
    latest_touch_s: float = 0.3  # Time after the planned landing by which both pairs must be down; else the legs settle
    confirm_s: float = 0.003  # Both pairs must touch for this long before the landing begins
    settle_s: float = 0.6  # Time from the end of the landing to the next jump, in which the legs move to its first pose
    settle_gains: JointGains = field(default_factory=lambda: JointGains(100.0, 3.0))

    def __post_init__(self) -> None:
        times = (self.earliest_touch_s, self.latest_touch_s, self.confirm_s)
        if not (all(0 <= one < np.inf for one in times) and 0 < self.settle_s < np.inf):
            raise ValueError("earliest_touch_s, latest_touch_s, confirm_s finite and not below 0, settle_s above 0")


class JumpSequence(Controller):
    """Makes the given jumps in their order and lands after each; stands after the last.

    The touch-down of both pairs ends a flight, early or late. ``phase`` holds the present phase, and ``fallbacks`` the
    count of fallback commands of all parts by reason.
    """

    def __init__(self, jumps: Sequence[JumpController], robot: Robot, config: SequenceConfig, body: RigidBody) -> None:
        """``body``: rigid body that the landing controller assumes."""
        if not jumps:
            raise InputError("continuous jumps", "no jump", "one or more", "name their references")
        self.jumps, self.robot, self.config, self.body = list(jumps), robot, config, body
        self.legs = LegKinematics(robot)
        self.border = Border(robot)
        self._own_fallbacks: Counter[str] = Counter()
        self.phase: Phase = "jump"
        self.number = 0
        self.landings_s: list[float] = []
        self._landings: list[LandingMpc] = []
        self._phase_since_s = 0.0
        self._both_since_s = np.inf
        self._settle_from = jumps[0].reference.joint_pos[0]
        self._feet = [robot.feet_at(pair) for pair in PAIRS]

    @property
    def fallbacks(self) -> Counter[str]:
        """Count of fallback commands by reason, of all jumps and landings so far."""
        of_jumps, of_landings = ([part.fallbacks for part in parts] for parts in (self.jumps, self._landings))
        return sum((*of_jumps, self._own_fallbacks, *of_landings), Counter[str]())

    def command(self, estimate: StateEstimate) -> Command:
        """See ``Controller``: the command of the present phase, a safe one where a tick has no usable time."""
        judged = self.border.judged(estimate)
        if judged is None:
            self._own_fallbacks[TIME_NOT_USABLE] += 1
            return self.border.safe_command()
        if not all(judged.foot_contact[feet].any() for feet in self._feet):
            self._both_since_s = np.inf
        elif self._both_since_s == np.inf:
            self._both_since_s = judged.time_s
        self._switch(judged)
        if self.phase == "jump":
            return self.border.sent(self.jumps[self.number].command(judged))
        if self.phase == "landing":
            return self.border.sent(self._landings[-1].command(judged))
        return self.border.sent(self._settle(judged))

    def _switch(self, estimate: StateEstimate) -> None:
        """Enter the next phase when the present one is over."""
        now, config = estimate.time_s, self.config
        lasted = now - self._phase_since_s + ROUNDING_S
        jump = self.jumps[self.number]
        if self.phase == "jump" and jump.start_s is not None:
            # A jump may stand first, to measure its stance and to become still.
            lasted, schedule = now - jump.start_s + ROUNDING_S, jump.reference.schedule
            may_touch = lasted >= schedule.take_off_s + config.earliest_touch_s
            if may_touch and now - self._both_since_s + ROUNDING_S >= config.confirm_s:
                self._landings.append(LandingMpc(self.robot, self._next_pose(), config.landing, self.body))
                self.landings_s.append(now)
                self.phase, self._phase_since_s = "landing", now
            elif lasted >= schedule.landing_s + config.latest_touch_s:
                self._enter("settling", estimate)
        elif self.phase == "landing" and lasted >= config.landing.duration_s:
            self._enter("settling", estimate)
        elif self.phase == "settling" and lasted >= config.settle_s and self.number + 1 < len(self.jumps):
            self.number += 1
            self._enter("jump", estimate)

    def _enter(self, phase: Phase, estimate: StateEstimate) -> None:
        self.phase, self._phase_since_s = phase, estimate.time_s
        measured = estimate.joint_pos
        self._settle_from = measured.copy() if np.isfinite(measured).all() else self._next_pose()

    def _next_pose(self) -> np.ndarray:
        """Joint angles to stand in: first pose of the next jump, or last pose of the last one, (joints,), rad."""
        if self.number + 1 < len(self.jumps):
            return self.jumps[self.number + 1].reference.joint_pos[0]
        return self.jumps[self.number].reference.joint_pos[-1]

    def _settle(self, estimate: StateEstimate) -> Command:
        """Move the joints to the next pose in half of the time, then stand; feet in contact carry the weight."""
        part = np.clip(2 * (estimate.time_s - self._phase_since_s) / self.config.settle_s, 0.0, 1.0)
        smooth = part * part * (3 - 2 * part)
        pose = self._settle_from + smooth * (self._next_pose() - self._settle_from)
        force = standing_force(self.body) * np.isfinite(self._both_since_s)
        frame = StartFrame.of(estimate)
        command = stand(self.robot, self.legs, estimate, frame, force, pose, self.config.settle_gains)
        return limited(command, self.border)
