"""Constant motor torque offset."""

from dataclasses import dataclass, replace
from math import inf

from leapgap.effects.base import Commands, MotorEffect, Parameter, parameter
from leapgap.robot.model import Robot

LARGEST, MODERATE = 0.3, 0.03
"""Limit of the search and noticeable value, as shares of the largest torque of the motors."""


@dataclass(frozen=True)
class TorqueOffset(MotorEffect):
    """Constant torque added to what is commanded; the motor's limit and gain act on the sum."""

    name = "torque_offset"
    by_default = False

    torque_nm: float = parameter(0.0, "N·m", -10.0, 10.0, 1.0, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """Shares of the motors' largest torque, where the model states one."""
        (declared,) = super().parameters(robot, location)
        most = robot.largest_torque(location)
        if most is None:
            return (declared,)
        return (replace(declared, lower=-LARGEST * most, upper=LARGEST * most, moderate=MODERATE * most),)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Add to the feed-forward torque of the joints."""
        torque = commands.torque.copy()
        torque[:, robot.joints_at(self.location)] += self.torque_nm
        return replace(commands, torque=torque)
