"""Motor lag (first order)."""

from collections.abc import Hashable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, parameter
from leapgap.effects.drive import Drive, add_lag
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class MotorLag(Effect):
    """First-order lag between commanded torque, joint PD included, and delivered torque, T τ̇ = τ_commanded − τ.

    Integrated exactly over each step with the command held. Torque limits act on what is delivered, after the lag.
    A motion starts with the torque that its first command asks for.
    """

    name = "motor_lag"
    places = "joints"
    along_joints = True
    needs_motor = True

    time_constant_s: float = parameter(0.0, "s", 0.0, 0.15, 0.005)

    @property
    def structure(self) -> Hashable | None:
        """Key of the motors whose torque becomes a state; None at nominal lag."""
        return None if self.is_nominal else (self.name, self.location)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The torque is late."""
        return at.at_motors(location, at.late(at.torque))

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Give the motors their torque as a state."""
        add_lag(spec, robot, self.location)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Add to the motors' time constant."""
        lag = drive.lag_s.copy()
        lag[robot.joints_at(self.location)] += self.time_constant_s
        return replace(drive, lag_s=lag)
