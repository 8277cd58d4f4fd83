"""Low-pass filter on the set points."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.effects.base import Commands, MotorEffect, parameter
from leapgap.effects.recursion import first_order
from leapgap.robot.model import Robot

REMEMBERED = 30.0
"""Time constants after which a set point is forgotten."""


@dataclass(frozen=True)
class SetPointFilter(MotorEffect):
    """First-order low-pass on the set points of the joint PD, T dq_f/dt = q* − q_f, and on those of velocity alike.

    A period gets the mean of the filtered set point (the exact impulse). Before anything arrives the first command
    holds. Feed-forward torque, and what the joint PD measures, are not filtered.
    """

    name = "set_point_filter"
    by_default = False

    time_constant_s: float = parameter(0.0, "s", 0.0, 0.5, 0.01)

    @property
    def memory_s(self) -> float:
        """Until nothing is left of a set point."""
        return REMEMBERED * self.time_constant_s

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Filter the set points of the joints."""
        if self.is_nominal:
            return commands
        at, periods = robot.joints_at(self.location), self.time_constant_s / period_s
        kept = float(np.exp(-1 / periods))

        def smooth(sent: np.ndarray) -> np.ndarray:
            wanted, found = sent[:, at], sent.copy()
            ends = first_order(wanted, kept, wanted[:1])
            starts = np.concatenate([wanted[:1], ends[:-1]])
            found[:, at] = wanted + (starts - wanted) * (periods * (1 - kept))
            return found

        return replace(commands, position=smooth(commands.position), velocity=smooth(commands.velocity))
