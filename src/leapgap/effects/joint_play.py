"""Backlash."""

from dataclasses import dataclass
from math import inf

import mujoco

from leapgap.effects.base import parameter
from leapgap.effects.rotor_effect import RotorEffect
from leapgap.robot.model import Robot
from leapgap.robot.rotors import joints_with_rotors, mount_rotors, widen_play


@dataclass(frozen=True)
class JointPlay(RotorEffect):
    """Angle within which a rotor turns without a torque on its joint, from stop to stop.

    A motion starts with the teeth on the side to which the first command pushes.
    """

    name = "joint_play"

    play_rad: float = parameter(0.0, "rad", 0.0, 0.1, 0.01, limits=(0.0, inf))

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Widen the range in which the rotors turn freely."""
        if self.is_nominal:
            return
        widen_play(model, mount_rotors(model, robot, joints_with_rotors(robot, self.location)), self.play_rad)
