"""Motor torque gain."""

from dataclasses import dataclass

import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, parameter
from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class TorqueGain(MotorEffect):
    """Ratio of delivered to commanded torque: feed-forward, joint PD and limit are all scaled."""

    name = "torque_gain"

    scale: float = parameter(1.0, "1", 0.3, 1.5, 0.85)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """All that the motors give."""
        return at.at_motors(location, at.torque)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Scale the gain of the motors."""
        return drive.scaled("gain", robot.joints_at(self.location), self.scale)
