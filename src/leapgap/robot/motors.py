"""Motor constants of a robot; MuJoCo has no field for them, so a model file states them as custom numbers."""

from dataclasses import dataclass

import mujoco

RESISTANCE, TOP_SPEED = "motor_resistance", "motor_top_speed"
"""Names of the custom numbers: ``<custom><numeric name="motor_resistance" data="…"/> …</custom>``."""


@dataclass(frozen=True)
class MotorConstants:
    """Of every joint's motor, seen at the joint through its gear: the motor constant is 1 there, and 1 V is 1 rad/s."""

    resistance: float
    """V/(N·m): R i with the current i as torque at the joint, hence the winding's R over (gear · Kt)²."""
    top_speed_rad_s: float
    """Largest speed that a joint is designed for, rad/s."""


def motors_of(model: mujoco.MjModel) -> MotorConstants | None:
    """Motor constants that a model file states; None unless it states both numbers."""
    stated = {model.numeric(i).name: float(model.numeric(i).data[0]) for i in range(model.nnumeric)}
    if not {RESISTANCE, TOP_SPEED} <= stated.keys():
        return None
    return MotorConstants(stated[RESISTANCE], stated[TOP_SPEED])
