"""Torque-speed limit (duty cycle)."""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, parameter
from leapgap.effects.drive import Drive, lacks_torque_limits
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class DutyLimit(MotorEffect):
    """Share of a motor's largest torque that is lost per rad/s of its joint, by a duty cycle that cannot exceed 1.

    The torque obeys −τ_max (1 + c q̇) ≤ τ ≤ τ_max (1 − c q̇), with τ_max of the model: a straight line from the stall
    torque to the no-load speed 1 / c. It is the law of ``torque_speed_limit`` with the resistance 1 / (c τ_max), for
    robots that state no constants of their motors.
    """

    name = "duty_limit"
    by_default = False

    droop_s_rad: float = parameter(0.0, "s/rad", 0.0, 3.0, 0.05, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The line ends at a stated torque, and motors of stated constants have a law of their own."""
        stated = None if robot.motors is None else "motors without stated constants (see torque_speed_limit)"
        return super().lacks(robot) or stated or lacks_torque_limits(robot)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """At the limits, what a speed along the torque takes of them."""
        along = np.maximum(at.torque * at.velocity, 0.0) * np.sign(at.torque)
        return at.at_motors(location, -(1 - at.within) * along)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Bound the voltage of the motors at the no-load speed."""
        if self.is_nominal:
            return drive
        voltage, resistance = drive.voltage_v.copy(), drive.resistance.copy()
        at = robot.joints_at(self.location)
        at = at[np.isfinite(robot.torque_limits[at])]
        voltage[at], resistance[at] = 1 / self.droop_s_rad, 1 / (self.droop_s_rad * robot.torque_limits[at])
        return replace(drive, voltage_v=voltage, resistance=resistance)
