"""A planned jump in the form that controllers follow: planar motion, forces and joints, in the frame of its start."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.window_extraction import feet, states
from leapgap.jumping.task import ContactSchedule, Target, schedule_of, target_of
from leapgap.logs.log import Log
from leapgap.logs.pair_force import per_axis
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Reference:
    """A planned jump in rows of equal period; the first and the last row are held before and after the jump."""

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
    target: Target = field(default_factory=lambda: Target(0.0))
    """Where it lands, from its start, m."""

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
            raise InputError(
                jump.name,
                f"a reference that ends at {jump.time[-1]:g} s",
                f"one that reaches its take-off at {schedule.take_off_s:g} s",
                "plan it again (stages.optimize)",
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
