"""Position gain (kp) of the joint PD."""

from dataclasses import dataclass
from math import inf

import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, parameter
from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class PositionGain(MotorEffect):
    """Ratio of the stiffness with which a joint PD acts to the logged ``cmd_kp``; feed-forward and limits stay.

    Where no position gain is logged there is nothing to scale.
    """

    name = "position_gain"
    by_default = False
    in_controller = True

    scale: float = parameter(1.0, "1", 0.02, 50.0, 1.5, limits=(0.0, inf), logarithmic=True)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The part of stiffness in the joint PD."""
        return at.at_motors(location, at.within * at.kp * (at.commands.position - at.position))

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Scale the stiffness of the joint PDs."""
        return drive.scaled("kp_scale", robot.joints_at(self.location), self.scale)
