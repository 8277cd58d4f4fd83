"""Voltage limit of the motors."""

from dataclasses import dataclass, replace
from math import ceil, inf

import numpy as np

from leapgap.effects.base import MotorEffect, Parameter, parameter
from leapgap.effects.drive import Drive
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.robot.motors import RESISTANCE, TOP_SPEED, MotorConstants


@dataclass(frozen=True)
class TorqueSpeedLimit(MotorEffect):
    """The delivered torque obeys |R τ + q̇| ≤ voltage (τ N·m, q̇ rad/s, at the joint), beside the model's own limit of τ.

    R is the resistance of the robot's motors (``MotorConstants``); a robot that does not state it cannot have this
    effect. Beyond the speed at which no torque is left the motor brakes. The nominal robot has no voltage limit. In a
    fit its nominal value is the smallest whole voltage that allows full torque at the joints' top speed.
    """

    name = "torque_speed_limit"

    voltage_v: float | None = parameter(None, "V", 0.0, inf, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The law needs the resistance of the motors."""
        return super().lacks(robot) or ("constants of its motors" if robot.motors is None else None)

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From 10/33 of the nominal voltage, which limits nothing, up to it; 16/33 of it is moderate."""
        torque = float(torque_limits(robot)[robot.joints_at(location)].max())
        motors = stated_motors(robot)
        ample = float(ceil(motors.resistance * torque + motors.top_speed_rad_s))
        unit = cls.declarations()["voltage_v"].unit
        return (Parameter("voltage_v", unit, ample, ample * 10 / 33, ample, ample * 16 / 33, ample),)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        """Bound the voltage of the motors."""
        if self.voltage_v is None or self.is_nominal_for(robot):
            return drive
        voltage = drive.voltage_v.copy()
        at = robot.joints_at(self.location)
        voltage[at] = np.minimum(voltage[at], self.voltage_v)
        return replace(drive, voltage_v=voltage)


def torque_limits(robot: Robot) -> np.ndarray:
    """Largest torque of each joint's motor by the model, N·m, (joints,).

    Where the model states none: the stall torque at the voltage of the motor's top speed.
    """
    motors = stated_motors(robot)
    return np.where(np.isfinite(robot.torque_limits), robot.torque_limits, motors.top_speed_rad_s / motors.resistance)


def stated_motors(robot: Robot) -> MotorConstants:
    """Constants of the motors; ``InputError`` where nobody states them."""
    if robot.motors is None:
        raise InputError(
            robot.path,
            "no constants of the motors",
            f"the custom numbers {RESISTANCE} and {TOP_SPEED}",
            "add them to the model file (docs/reference/log_format.md), or leave torque_speed_limit out",
        )
    return robot.motors
