"""Controllers of one jump: joint PD along the reference, with a feed-forward that each of them decides."""

import math
from abc import abstractmethod
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.border import TIME_NOT_USABLE, Border
from leapgap.jumping.control.leg_kinematics import LegKinematics, StartFrame
from leapgap.jumping.learning.window_extraction import feet, states
from leapgap.jumping.task import ContactSchedule, JointGains, Target, schedule_of, target_of
from leapgap.logs.log import Log
from leapgap.logs.pair_force import FORCES, per_axis
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS
from leapgap.simulation.controller import Command, Controller, StateEstimate


@dataclass(frozen=True)
class Reference:
    """A planned jump in rows of equal period; the first and the last row are held before and after the jump."""

    name: str
    schedule: ContactSchedule
    period_s: float
    state: np.ndarray  # x z pitch and rates, m, rad, s, (rows, 6); x from the start of the jump
    force: np.ndarray  # Planned ground force on the robot, front x z, rear x z, N, zero without contact, (rows, 4)
    foot: np.ndarray  # Foot − base, mean of each pair, front x z, rear x z, m, (rows, 4)
    joint_pos: np.ndarray
    joint_vel: np.ndarray
    torque: np.ndarray  # (rows, joints) each, rad, rad/s, N·m, joint order of the robot
    target: Target = field(default_factory=lambda: Target(0.0))  # Where it lands, from its start, m

    @staticmethod
    def of(jump: Log, robot: Robot) -> "Reference":
        """The reference of a planned jump; ``InputError`` where joints are missing or it ends before its take-off."""
        missing = [joint for joint in robot.joints if f"cmd_pos/{joint}" not in jump]
        if missing:
            raise InputError(
                jump.name, f"no joint {', '.join(missing)}", f"the joints of {robot.name}", "plan it again"
            )
        schedule, period = schedule_of(jump), jump.info.sample_period_s
        if jump.time[-1] < schedule.take_off_s:
            found, do = f"a reference that ends at {jump.time[-1]:g} s", "plan it again (stages.optimize)"
            raise InputError(jump.name, found, f"one that reaches its take-off at {schedule.take_off_s:g} s", do)
        state = states(jump)
        state[:, 0] -= state[0, 0]
        stands = per_axis(schedule.in_contact(jump.time))
        return Reference(
            name=jump.name,
            schedule=schedule,
            period_s=period,
            state=state,
            force=jump.pair_force("mpc_force") * stands,
            foot=feet(jump, robot, np.arange(len(jump))),
            joint_pos=jump.per_joint("cmd_pos", robot.joints),
            joint_vel=jump.per_joint("cmd_vel", robot.joints),
            torque=jump.per_joint("cmd_tau", robot.joints),
            target=target_of(jump),
        )

    def row(self, time_s: float) -> int:
        """Index of the row nearest to a time since the start, s."""
        return min(max(round(time_s / self.period_s), 0), len(self.state) - 1)

    def rows(self, times_s: np.ndarray) -> np.ndarray:
        """Index of the row nearest to each time since the start, s."""
        return np.clip(np.round(np.asarray(times_s) / self.period_s).astype(int), 0, len(self.state) - 1)

    def mean_force(self, times_s: np.ndarray) -> np.ndarray:
        """Mean planned force between successive times (n + 1,), N, (n, 4): the same impulse as the plan's."""
        begin, end = (time[:, None] for time in (times_s[:-1], times_s[1:]))
        at = np.clip(times_s / self.period_s, 0, len(self.force))
        impulse = np.stack([np.interp(at, np.arange(len(self.force) + 1), column) for column in self._impulse.T], 1)
        return np.diff(impulse, axis=0) * self.period_s / (end - begin)

    @cached_property
    def _impulse(self) -> np.ndarray:
        """Cumulative sum of the forces before each row, (rows + 1, 4), N; times the period it is the impulse."""
        return np.concatenate([np.zeros((1, self.force.shape[1])), np.cumsum(self.force, axis=0)])


@dataclass(frozen=True)
class PhaseGains:
    """Gains of a pair in stance, in swing (the other pair pushes), and in flight; as published 300/3 throughout.

    Those from the planned landing on are the published ones.
    """

    stance: JointGains = field(default_factory=JointGains)
    swing: JointGains = field(default_factory=JointGains)
    flight: JointGains = field(default_factory=JointGains)

    def rows(self, reference: Reference, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
        """kp and kd of the joint PD at each row of a reference, (rows, joints) each, SI units."""
        times = np.arange(len(reference.joint_pos)) * reference.period_s
        kp, kd = np.empty_like(reference.joint_pos), np.empty_like(reference.joint_pos)
        contact = reference.schedule.in_contact(times)
        landed = times >= reference.schedule.landing_s - 1e-6
        for pair, name in enumerate(PAIRS):
            phases = [landed, contact[:, pair], contact.any(axis=1)]
            for values, part in ((kp, "kp_nm_per_rad"), (kd, "kd_nms_per_rad")):
                of_phase = [getattr(gains, part) for gains in (JointGains(), self.stance, self.swing)]
                values[:, robot.joints_at(name)] = np.select(phases, of_phase, getattr(self.flight, part))[:, None]
        return kp, kd


ORIGIN_FRAME = StartFrame(0.0, 0.0, 0.0)


class JumpController(Controller):
    """Follows one reference from its first command on; after the reference's end, holds its last pose.

    ``fallbacks`` counts the fallback commands by reason; ``substituted`` lists their times, s since the start, and
    reasons.
    """

    def __init__(self, reference: Reference, robot: Robot, gains: PhaseGains) -> None:
        self.reference, self.robot = reference, robot
        self.kp, self.kd = gains.rows(reference, robot)
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
        if self.start_s is None:
            self.start_s = judged.time_s
        place, turned = judged.base_position, judged.base_quaternion
        if self.frame is None and math.isfinite(place @ place + turned @ turned):  # of limited size, by the border
            self.frame = StartFrame.of(judged)
        time_s = self._jump_time_s = judged.time_s - self.start_s
        torque, force = self.feed_forward(time_s, judged, self.frame or ORIGIN_FRAME)
        torque, force = self.border.within_limits(torque, force)
        position, velocity = self.set_points(time_s)
        row = self.reference.row(time_s)
        return self.border.sent(Command(torque, position, velocity, self.kp[row], self.kd[row], force))

    def count_fallback(self, reason: str) -> None:
        """Count a fallback command at the present time."""
        self.fallbacks[reason] += 1
        self.substituted.append((self._jump_time_s, reason))

    @abstractmethod
    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Joint torques (joints,), N·m, and their planar pair forces (4,), N, at a time since the start, s."""

    def set_points(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Set points of the joint PD at a time since the start, rad and rad/s, (joints,); asked after ``feed_forward``.

        They are those of the reference, without velocities after the planned landing.
        """
        row, moving = self.reference.row(time_s), time_s <= self.reference.schedule.landing_s
        velocity = self.reference.joint_vel[row]
        return self.reference.joint_pos[row], velocity if moving else 0.0 * velocity

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


@dataclass(frozen=True)
class Excitation:
    """Largest random force on each axis of each pair, N, and how long each draw is held, s."""

    force_n: float = 0.0
    hold_s: float = 0.1

    def __post_init__(self) -> None:
        if not (0 <= self.force_n < np.inf and 0 < self.hold_s < np.inf):
            raise ValueError("force_n finite and not below 0, hold_s finite and above 0")


class ExcitedController(JumpController):
    """Adds random forces to those of another jump controller, for the pairs that push."""

    def __init__(self, inner: JumpController, excitation: Excitation, rng: np.random.Generator) -> None:
        self.inner, self.excitation = inner, excitation
        self.reference, self.robot = inner.reference, inner.robot
        self.legs, self.border = inner.legs, inner.border
        self.fallbacks, self.substituted = inner.fallbacks, inner.substituted
        held = int(np.ceil(inner.reference.schedule.take_off_s / excitation.hold_s))
        self.force = rng.uniform(-excitation.force_n, excitation.force_n, (held, FORCES))
        """Random force of each interval of ``hold_s``: front x z, rear x z, N, (intervals, 4)."""
        self.start_s = None
        self.frame = None

    def command(self, estimate: StateEstimate) -> Command:
        """The other controller's command with the random force of this moment added."""
        command = self.inner.command(estimate)
        self.start_s, self.frame = self.inner.start_s, self.inner.frame
        judged = self.border.newest
        if judged is None:
            return command
        torque, force = self.feed_forward(judged.time_s - (self.start_s or 0.0), judged, self.frame or ORIGIN_FRAME)
        torque, force = self.border.within_limits(command.torque + torque, command.planned_force + force)
        return self.border.sent(replace(command, torque=torque, planned_force=force))

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques and forces of the excitation alone."""
        contact = self.reference.schedule.in_contact(np.array(time_s))
        if not contact.any() or not np.isfinite([*estimate.base_quaternion, *estimate.joint_pos]).all():
            return self.zero_feed_forward()
        force = self.force[max(0, int(time_s / self.excitation.hold_s + 1e-6))] * per_axis(contact)
        return self.legs.torque(estimate.base_quaternion, estimate.joint_pos, frame.in_world(force)), force
