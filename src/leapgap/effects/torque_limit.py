"""Motor torque limit."""

from dataclasses import dataclass
from math import inf

import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, parameter
from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class TorqueLimit(MotorEffect):
    """Ratio of the motors' largest torque to the model's; what is asked for below it is delivered as before."""

    name = "torque_limit"
    by_default = False

    scale: float = parameter(1.0, "1", 0.02, 5.0, 0.5, limits=(0.0, inf), logarithmic=True)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """Without any stated limit there is nothing to scale."""
        stated = np.isfinite(robot.torque_limits[robot.driven]).any()
        return super().lacks(robot) or (None if stated else "limits of its torques")

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """What the motors give at their limits."""
        return at.at_motors(location, at.torque * (1 - at.within))

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Scale the limit of the motors."""
        return drive.scaled("limit_scale", robot.joints_at(self.location), self.scale)
