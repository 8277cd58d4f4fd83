"""Constants of a robot's motors that no MuJoCo model file states."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MotorConstants:
    """Of every joint's motor, seen at the joint through its gear: the motor constant is 1 there, and 1 V is 1 rad/s.

    The defaults are those of a small quadruped's joints, as published with the controller of the A1. Another robot
    states its own; without a voltage limit or a motor lag among the effects they are not used.
    """

    resistance: float = 0.34602
    """V/(N·m): R = 25 Kt² over (gear · Kt)² = 1, with Kt = 4/34."""
    top_speed_rad_s: float = 21.0
    """The fastest that a joint is meant to turn."""
