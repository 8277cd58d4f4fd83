"""Friction compensation missing from the log."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, Parameter, parameter
from leapgap.robot.model import Robot

LARGEST, MODERATE = 0.05, 0.01
"""Limit of the search and noticeable value, as shares of the largest torque of the motors."""
STILL_RAD_S = 0.02
"""Below such speeds the torque fades out, as controllers let it lest it chatter."""


@dataclass(frozen=True)
class FrictionCompensation(MotorEffect):
    """Torque that motors add along the measured joint velocity, on top of the logged command."""

    name = "friction_compensation"
    by_default = False

    torque_nm: float = parameter(0.0, "N·m", 0.0, 2.0, 0.2, limits=(-np.inf, np.inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """Shares of the motors' largest torque, where the model states one."""
        (declared,) = super().parameters(robot, location)
        declared, most = replace(declared, lower_is_physical=True), robot.largest_torque(location)
        return (declared if most is None else replace(declared, upper=LARGEST * most, moderate=MODERATE * most),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Along the motion."""
        return at.at_motors(location, at.within * np.tanh(at.velocity / STILL_RAD_S))

    def torque_by_velocity(self, velocity: np.ndarray, robot: Robot) -> np.ndarray | None:
        """Along the motion, as large at every speed at which the joint clearly moves."""
        if self.is_nominal:
            return None
        at = [joint for joint in robot.joints_at(self.location) if robot.driven[joint]]
        torque = np.zeros_like(velocity)
        torque[:, at] = self.torque_nm * np.tanh(velocity[:, at] / STILL_RAD_S)
        return torque
