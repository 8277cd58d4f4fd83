"""Velocity gain (kd) of the joint PD."""

from dataclasses import dataclass
from math import inf

import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, parameter
from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class VelocityGain(MotorEffect):
    """Ratio of the damping with which a joint PD acts to the logged ``cmd_kd``; feed-forward and limits stay.

    Where no velocity gain is logged there is nothing to scale, and a drive's damping is a ``joint_damping``.
    """

    name = "velocity_gain"
    by_default = False
    in_controller = True

    scale: float = parameter(1.0, "1", 0.02, 50.0, 1.5, limits=(0.0, inf), logarithmic=True)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The part of damping in the joint PD."""
        return at.at_motors(location, at.within * at.kd * (at.commands.velocity - at.velocity))

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Scale the damping of the joint PDs."""
        return drive.scaled("kd_scale", robot.joints_at(self.location), self.scale)
