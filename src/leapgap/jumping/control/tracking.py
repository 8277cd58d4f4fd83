"""Controllers of one jump: joint PD along the reference, with a feed-forward that each of them decides."""

import math
from abc import abstractmethod
from collections import Counter

import numpy as np

from leapgap.jumping.control.border import TIME_NOT_USABLE, Border
from leapgap.jumping.control.gains import JointTargets, PhaseGains
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.models.rigid_body import Z
from leapgap.logs.pair_force import FORCES
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, Controller, StateEstimate


class JumpController(Controller):
    """Follows one reference from its first command on; after the reference's end, holds its last pose.

    ``fallbacks`` counts the fallback commands by reason; ``substituted`` lists their times, s since the start, and
    reasons.
    """

    def __init__(self, reference: Reference, robot: Robot, gains: PhaseGains, level_m: float | None = 0.0) -> None:
        """``level_m``: height of the ground at the start, m; None: computed from the measured height of the base."""
        self.reference, self.robot = reference, robot
        self.targets = JointTargets.of(reference, gains, robot)
        self.level_m = level_m
        self.legs = LegKinematics(robot)
        self.border = Border(robot)
        self.fallbacks: Counter[str] = Counter()
        self.substituted: list[tuple[float, str]] = []
        self.start_s: float | None = None
        self.frame: StartFrame | None = None
        self._jump_time_s = 0.0

    def command(self, estimate: StateEstimate) -> Command:
        """See ``Controller``: joint PD at the reference's row of this moment, with ``feed_forward``.

        A tick without a usable time gets a safe command (``Border``), and torques stay within those of the motors.
        """
        judged = self.border.judged(estimate)
        if judged is None:
            self.count_fallback(TIME_NOT_USABLE)
            return self.border.safe_command()
        return self.border.sent(self._tracking(judged))

    def count_fallback(self, reason: str) -> None:
        """Count a fallback command at the present time."""
        self.fallbacks[reason] += 1
        self.substituted.append((self._jump_time_s, reason))

    def _tracking(self, estimate: StateEstimate) -> Command:
        """The command for a judged estimate."""
        if self.start_s is None:
            self.start_s = estimate.time_s
        place, turned = estimate.base_position, estimate.base_quaternion
        if self.frame is None and math.isfinite(place @ place + turned @ turned):  # of limited size, by the border
            self.frame = self._start_frame(estimate)
        time_s = estimate.time_s - self.start_s
        self._jump_time_s = time_s
        torque, force = self.feed_forward(time_s, estimate, self.frame or StartFrame(0.0, 0.0, 0.0))
        torque, force = self.border.within_limits(torque, force)
        position, velocity = self.set_points(time_s)
        row, targets = self.reference.row(time_s), self.targets
        return Command(
            torque=torque,
            position=position,
            velocity=velocity,
            kp=targets.kp[row],
            kd=targets.kd[row],
            planned_force=force,
        )

    @abstractmethod
    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Joint torques (joints,), N·m, and their planar pair forces (4,), N, at a time since the start, s."""

    def set_points(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Set points of the joint PD at a time since the start, rad and rad/s, (joints,); asked after ``feed_forward``.

        They are those of the reference, without velocities after the planned landing.
        """
        row, moving = self.reference.row(time_s), time_s <= self.reference.schedule.landing_s
        velocity = self.targets.velocity[row]
        return self.targets.position[row], velocity if moving else 0.0 * velocity

    def _start_frame(self, estimate: StateEstimate) -> StartFrame:
        level = float(estimate.base_position[2] - self.reference.state[0, Z]) if self.level_m is None else self.level_m
        return StartFrame.of(estimate, level)

    def planned(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """The planned torques (joints,), N·m, and pair forces (4,), N, up to the planned landing."""
        if time_s > self.reference.schedule.landing_s:
            return self.zero_feed_forward()
        row = self.reference.row(time_s)
        return self.reference.torque[row], self.reference.force[row]

    def zero_feed_forward(self) -> tuple[np.ndarray, np.ndarray]:
        """Zero torques, (joints,), and zero pair forces, (4,)."""
        return np.zeros(len(self.robot.joints)), np.zeros(FORCES)


class JointPd(JumpController):
    """Joint PD with the torques of the plan as feed-forward: the baseline of every MPC."""

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Those of the plan."""
        return self.planned(time_s)
