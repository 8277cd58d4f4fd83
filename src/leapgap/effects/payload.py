"""Payload at the trunk."""

from dataclasses import dataclass, replace
from math import inf

import mujoco

from leapgap.effects.base import Parameter, addition, parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.robot.model import Robot

LARGEST_LOSS = 0.9
"""Share of the trunk's mass that may be taken away; a moving body needs a positive mass."""


@dataclass(frozen=True)
class Payload(InertialEffect):
    """A point mass at the trunk's centre of mass; a negative one where the trunk is lighter than the model has it."""

    name = "payload"
    needs_base = True

    mass_kg: float = parameter(0.0, "kg", 0.0, 6.0, 1.0, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From a trunk that weighs a tenth of the model's upwards."""
        (declared,) = super().parameters(robot, location)
        own = robot.model.body_mass[[robot.base_body]]
        added = addition(declared, own)
        return (replace(added, lower=-LARGEST_LOSS * float(own[0]), lower_is_physical=False),)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the mass of the base body."""
        least = (1 - LARGEST_LOSS) * model.body_mass[robot.base_body]
        model.body_mass[robot.base_body] = max(model.body_mass[robot.base_body] + self.mass_kg, least)
