"""Mass at the trunk that the model does not have: a battery, a sensor, a heavier shell."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter, recompute_constants
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Payload(Effect):
    """A point mass at the trunk's centre of mass."""

    name = "payload"

    mass_kg: float = parameter(0.0, "kg", -0.5, 6.0, 1.0)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the mass of the base body."""
        if self.is_nominal:
            return
        model.body_mass[robot.base_body] += self.mass_kg
        recompute_constants(model)
