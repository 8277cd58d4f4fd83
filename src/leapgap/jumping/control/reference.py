"""A planned jump as controllers follow it: planar motion, forces and joints, in the frame of the jump's start."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.learning.window_extraction import feet, states
from leapgap.logs.log import Log
from leapgap.logs.pair_force import by_pair, flat, per_axis
from leapgap.logs.segments import ContactSchedule
from leapgap.robot.model import Robot
from leapgap.robot.rotations import pitch_of, yaw_of
from leapgap.simulation.controller import StateEstimate


@dataclass(frozen=True)
class Reference:
    """Rows of equal period from the start of the jump on; before the first and after the last row, those are held."""

    name: str
    schedule: ContactSchedule
    period_s: float
    state: np.ndarray
    """x z pitch and rates, m, rad, s, (rows, 6); x from the start of the jump."""
    force: np.ndarray
    """Planned ground force on the robot, front x z, rear x z, N, zero where no contact is planned, (rows, 4)."""
    foot: np.ndarray
    """Foot − base, mean of each pair, front x z, rear x z, m, (rows, 4)."""
    joint_pos: np.ndarray
    joint_vel: np.ndarray
    torque: np.ndarray
    """(rows, joints) each, rad, rad/s, N·m, joint order of the robot."""

    @staticmethod
    def of(jump: Log, robot: Robot) -> "Reference":
        """From a planned jump (stage optimize); ``InputError`` where it lacks something or ends too early."""
        missing = [joint for joint in robot.joints if f"cmd_pos/{joint}" not in jump]
        if missing:
            raise InputError(jump.name, f"no joint {', '.join(missing)}", f"the joints of {robot.name}", "plan it anew")
        schedule, period = jump.info.schedule, jump.info.sample_period_s
        if jump.time[-1] < schedule.take_off_s:
            raise InputError(
                jump.name,
                f"a reference that ends at {jump.time[-1]:g} s",
                f"one that reaches its take-off at {schedule.take_off_s:g} s",
                "plan it anew (stages.optimize)",
            )
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
        )

    def row(self, time_s: float) -> int:
        """The nearest row."""
        return min(max(round(time_s / self.period_s), 0), len(self.state) - 1)

    def rows(self, times_s: np.ndarray) -> np.ndarray:
        """The nearest row of each time."""
        return np.clip(np.round(np.asarray(times_s) / self.period_s).astype(int), 0, len(self.state) - 1)

    def mean_force(self, times_s: np.ndarray) -> np.ndarray:
        """Mean planned force between successive times (n + 1,), N, (n, 4): the same impulse as the plan's."""
        begin, end = (time[:, None] for time in (times_s[:-1], times_s[1:]))
        at = np.clip(times_s / self.period_s, 0, len(self.force))
        impulse = np.stack([np.interp(at, np.arange(len(self.force) + 1), column) for column in self._impulse.T], 1)
        return np.diff(impulse, axis=0) * self.period_s / (end - begin)

    @cached_property
    def _impulse(self) -> np.ndarray:
        """Sum of all forces before each row, each held for one period, (rows + 1, 4)."""
        return np.concatenate([np.zeros((1, self.force.shape[1])), np.cumsum(self.force, axis=0)])


@dataclass(frozen=True)
class StartFrame:
    """Where a jump began: its reference's x runs from there along the heading, its z from the level it stands on."""

    x_m: float
    y_m: float
    yaw_rad: float
    level_m: float = 0.0
    """Height in the world of the ground that the reference calls zero."""

    @staticmethod
    def of(estimate: StateEstimate, level_m: float = 0.0) -> "StartFrame":
        """At the robot's present place and heading."""
        x, y, _ = estimate.base_position
        return StartFrame(float(x), float(y), float(yaw_of(estimate.base_quaternion)), level_m)

    @cached_property
    def forward(self) -> np.ndarray:
        """Unit vector of the heading in the world, (3,)."""
        return np.array([np.cos(self.yaw_rad), np.sin(self.yaw_rad), 0.0])

    def state(self, estimate: StateEstimate) -> np.ndarray:
        """x z pitch and rates as in ``Reference``, (6,)."""
        x, y, z = estimate.base_position
        return np.array(
            [
                (x - self.x_m) * self.forward[0] + (y - self.y_m) * self.forward[1],
                z - self.level_m,
                pitch_of(estimate.base_quaternion),
                estimate.base_velocity @ self.forward,
                estimate.base_velocity[2],
                estimate.base_angular_velocity[1],
            ]
        )

    def foot(self, estimate: StateEstimate, legs: LegKinematics) -> np.ndarray:
        """Foot − base, mean of each pair, front x z, rear x z, m, as in ``Reference``, (4,)."""
        offset = legs.pair_offsets(estimate.base_quaternion, estimate.joint_pos)
        return flat(np.stack([offset @ self.forward, offset[:, 2]], axis=1))

    def in_world(self, force: np.ndarray) -> np.ndarray:
        """Planar pair forces (4,) along the heading as vectors in the world, (2, 3)."""
        planar = by_pair(force)
        return planar[:, :1] * self.forward + planar[:, 1:] * np.array([0.0, 0.0, 1.0])
