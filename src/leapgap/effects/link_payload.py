"""Mass at a link that the model does not have: a tool, a camera, a gearbox that was left out."""

from dataclasses import dataclass, replace
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, Parameter, parameter, recompute_constants
from leapgap.effects.links import links_at
from leapgap.robot.model import Robot

LARGEST_LOSS = 0.9
"""Share of a link's mass that may be taken away; a moving body needs a positive mass."""
LARGEST, MODERATE = (3.0, 0.5), (0.3, 0.02)
"""Limit of the search and noticeable value: the larger of a share of the link's mass and of the robot's."""


@dataclass(frozen=True)
class LinkPayload(Effect):
    """A point mass at the centre of mass of the links that the located joints move; negative where they are lighter."""

    name = "link_payload"
    by_default = False
    places = "joints"

    mass_kg: float = parameter(0.0, "kg", -inf, inf, 0.2)

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From links that weigh a tenth of the model's upwards."""
        (declared,) = super().parameters(robot, location)
        own = robot.model.body_mass[links_at(robot, location)]
        whole = float(robot.model.body_mass[robot.bodies].sum())
        upper, moderate = (max(a * float(own.max()), b * whole) for a, b in (LARGEST, MODERATE))
        scale = float(own.mean())
        return (replace(declared, lower=-LARGEST_LOSS * float(own.min()), upper=upper, moderate=moderate, scale=scale),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the mass of each link, of which a tenth always stays."""
        if self.is_nominal:
            return
        links = links_at(robot, self.location)
        own = model.body_mass[links]
        model.body_mass[links] = np.maximum(own + self.mass_kg, (1 - LARGEST_LOSS) * own)
        recompute_constants(model)
