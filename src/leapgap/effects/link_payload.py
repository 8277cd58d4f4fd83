"""Payload at a link."""

from dataclasses import dataclass, replace
from math import inf

import mujoco

from leapgap.effects.base import Parameter, parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.effects.links import add_mass, along, links_at, square_to
from leapgap.robot.model import Robot

LARGEST_LOSS = 0.9
"""Share of a link's mass that may be taken away; a moving body needs a positive mass."""
LARGEST, MODERATE = (3.0, 0.5), (0.3, 0.02)
"""Limit of the search and noticeable value: the larger of a share of the link's mass and of the robot's."""
FARTHEST_M, MODERATE_M = 0.3, 0.1
"""Limit of the search for the distance of a heavy payload, and a noticeable one."""
LIGHT = 0.1
"""A payload below this share of its link's mass adds less inertia than a point at moment / mass, and none at zero mass:
there a moment is a centre of mass that is elsewhere."""


@dataclass(frozen=True)
class LinkPayload(InertialEffect):
    """A point mass at the links that the located joints move; negative where they are lighter.

    It lies beyond the link's centre of mass, away from the joint, by ``moment_kg_m`` / ``mass_kg``. Gravity and inertia
    answer to the two numbers almost linearly, also where the mass is small, which they do not to a distance. Only
    what is added is looked for: lighter links are scaled ones (``leg_mass``).
    """

    name = "link_payload"
    by_default = False
    places = "joints"

    mass_kg: float = parameter(0.0, "kg", -inf, inf, 0.2)
    moment_kg_m: float = parameter(0.0, "kg·m", -inf, inf, 0.02)

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no mass upwards; the moment either way."""
        mass, moment = super().parameters(robot, location)
        own = robot.model.body_mass[links_at(robot, location)]
        whole = float(robot.model.body_mass[robot.bodies].sum())
        upper, moderate = (max(a * float(own.max()), b * whole) for a, b in (LARGEST, MODERATE))
        scale = float(own.mean())
        far = FARTHEST_M * upper
        return (
            replace(mass, lower=0.0, lower_is_physical=True, upper=upper, moderate=moderate, scale=scale),
            replace(moment, lower=-far, upper=far, moderate=MODERATE_M * moderate),
        )

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the mass of each link, of which a tenth always stays."""
        for link in links_at(robot, self.location):
            own = float(model.body_mass[link])
            mass = max(self.mass_kg, -LARGEST_LOSS * own)
            inertia = self.moment_kg_m**2 * mass / max(mass**2, (LIGHT * own) ** 2)
            outward = along(robot, int(link))
            add_mass(model, int(link), mass, self.moment_kg_m * outward, inertia * square_to(outward))
