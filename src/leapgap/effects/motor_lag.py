"""Motor lag (first order)."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, parameter
from leapgap.effects.drive import Drive, add_lag
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class MotorLag(MotorEffect):
    """First-order lag between commanded torque, joint PD included, and delivered torque, T τ̇ = τ_commanded − τ.

    Integrated exactly over each step with the command held. Torque limits act on what is delivered, after the lag.
    A motion starts with the torque that its first command asks for.
    """

    name = "motor_lag"

    time_constant_s: float = parameter(0.0, "s", 0.0, 0.15, 0.005)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The torque is late."""
        return at.at_motors(location, at.late(at.torque))

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Give the motors their torque as a state."""
        add_lag(spec, robot, self.location)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Add to the motors' time constant."""
        return drive.added("lag_s", robot.joints_at(self.location), self.time_constant_s)
