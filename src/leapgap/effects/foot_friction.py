"""Ground more or less slippery than believed."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, decide_contact, foot_geoms, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class FootFriction(Effect):
    """Coefficient of sliding friction between feet and ground, in place of the model's own."""

    name = "foot_friction"
    places = "feet"

    mu: float = parameter(0.8, "1", 0.2, 1.5, 0.4)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the friction of the feet."""
        if self.is_nominal:
            return
        feet = foot_geoms(model, robot, self.location)
        decide_contact(model, feet)
        model.geom_friction[feet, 0] = self.mu
