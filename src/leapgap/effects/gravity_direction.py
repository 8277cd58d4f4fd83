"""Tilt of gravity against the model's vertical."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.effects.leaning import lean, rotated
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of


@dataclass(frozen=True)
class GravityDirection(InertialEffect):
    """Gravity turned by a roll about the world's x axis, then a pitch about its y axis; its size stays.

    For a robot on a floor it is the same as a floor and a measuring frame that both lean the other way.
    """

    name = "gravity_direction"
    by_default = False

    roll_rad: float = parameter(0.0, "rad", -0.5, 0.5, 0.05)
    pitch_rad: float = parameter(0.0, "rad", -0.5, 0.5, 0.05)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """Without gravity there is no direction of it."""
        return super().lacks(robot) or (None if np.any(gravity_of(robot.model)) else "gravity")

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Turn the gravity of the model."""
        model.opt.gravity = rotated(model.opt.gravity[None], lean(self.roll_rad, self.pitch_rad))[0]
