"""Feet or ground softer than believed."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, decide_contact, foot_geoms, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class FootCompliance(Effect):
    """Time constant of the feet's contacts (the first number of MuJoCo's ``solref``), in place of the model's own."""

    name = "foot_compliance"
    places = "feet"

    time_constant_s: float = parameter(0.02, "s", 0.004, 0.1, 0.04)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the time constant of the feet."""
        if self.is_nominal:
            return
        feet = foot_geoms(model, robot, self.location)
        decide_contact(model, feet)
        model.geom_solref[feet, 0] = self.time_constant_s
