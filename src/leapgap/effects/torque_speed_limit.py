"""Motors that run out of voltage: less torque the faster they turn."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.effects.base import Effect, parameter
from leapgap.effects.drive import Drive
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class TorqueSpeedLimit(Effect):
    """The delivered torque obeys |0.34602 τ + q̇| ≤ voltage (τ N·m, q̇ rad/s, at the joint), beside |τ| ≤ 33.5.

    Published for the A1 with 21.5 V: full torque up to 9.91 rad/s, none at 21.5 rad/s; beyond that the motor brakes.
    The nominal robot has no such law. 33 V stands for that: 33.5 N·m at 21 rad/s, the joints' own limit, need 32.6 V.
    """

    name = "torque_speed_limit"
    places = "joints"

    voltage_v: float = parameter(33.0, "V", 10.0, 33.0, 16.0)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Bound the voltage of the motors."""
        if self.is_nominal:
            return drive
        voltage = drive.voltage_v.copy()
        at = robot.joints_at(self.location)
        voltage[at] = np.minimum(voltage[at], self.voltage_v)
        return replace(drive, voltage_v=voltage)
