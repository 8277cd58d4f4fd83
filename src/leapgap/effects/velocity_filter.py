"""Low-pass filter on the velocity feedback."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, parameter
from leapgap.effects.drive import Drive, add_velocity_filter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class VelocityFilter(MotorEffect):
    """First-order low-pass in front of the damper of the joint PD, T v̇_f = q̇ − v_f with τ = kp e + kd (q̇* − v_f).

    Drives differentiate their encoders and smooth the result. The position is fed back at once, as are the commands.
    Integrated exactly over each step with the velocity held; a motion starts with v_f = q̇. A limit of the motors'
    voltage (``torque_speed_limit``) acts on the torque without its damper.
    """

    name = "velocity_filter"
    in_controller = True
    by_default = False
    beside_clock = True

    time_constant_s: float = parameter(0.0, "s", 0.0, 0.01, 0.001)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """The damper misses the newest change of the velocity."""
        return at.at_motors(location, at.within * at.kd * at.acceleration)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Give the joints the actuators of their dampers."""
        add_velocity_filter(spec, robot, self.location)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Add to the filters' time constant."""
        return drive.added("filter_s", robot.joints_at(self.location), self.time_constant_s)
