"""Effects that simulated hardware may have and that a diagnosis does not look for.

They are kept out of ``leapgap.effects``, which holds the effects that a diagnosis looks for.
"""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter
from leapgap.effects.contacts import foot_geoms
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class BentCalf(Effect):
    """A calf bent in a fall: the foot sits off the line that the encoders are read with, along the calf's x axis."""

    name = "bent_calf"
    places = "feet"

    offset_m: float = parameter(0.0, "m", -0.03, 0.03)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the feet at the location."""
        model.geom_pos[foot_geoms(model, robot, self.location), 0] += self.offset_m
