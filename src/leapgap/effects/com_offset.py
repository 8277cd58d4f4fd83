"""Centre-of-mass offset of the trunk."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.effects.links import move_centre
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class ComOffset(InertialEffect):
    """Shift of the base body's centre of mass along its own axes: forward and up."""

    name = "com_offset"
    needs_base = True

    x_m: float = parameter(0.0, "m", -0.1, 0.1, 0.03)
    z_m: float = parameter(0.0, "m", -0.1, 0.1, 0.03)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the inertial frame of the base body, its geoms staying where they are."""
        move_centre(model, robot.base_body, np.array([self.x_m, 0.0, self.z_m]))
