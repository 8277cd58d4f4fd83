"""Foot-ground friction coefficient."""

from dataclasses import dataclass
from math import inf

import mujoco

from leapgap.effects.base import Effect, Parameter, mean_of, parameter
from leapgap.effects.contact import decide_contact, foot_contacts, foot_geoms
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class FootFriction(Effect):
    """Coefficient of sliding friction between feet and ground, in place of the model's own.

    Where the model has feet of different friction this is their mean, and each foot keeps its ratio to it.
    """

    name = "foot_friction"
    places = "feet"

    mu: float | None = parameter(None, "1", 0.2, 1.5, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From a quarter of the model's own friction to half as much again, and in any case from 0.2 to 1.5."""
        own = mean_of(foot_contacts(robot, location).friction[:, 0])
        about = cls.declarations()["mu"]
        lower, upper = min(about.lower, own / 4), max(about.upper, 1.5 * own)
        return (Parameter("mu", about.unit, own, lower, upper, own / 2, own),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the friction of the feet."""
        if self.mu is None or self.is_nominal_for(robot):
            return
        own = foot_contacts(robot, self.location).friction[:, 0]
        feet = foot_geoms(model, robot, self.location)
        decide_contact(model, robot, self.location)
        model.geom_friction[feet, 0] = self.mu * (own / mean_of(own))
