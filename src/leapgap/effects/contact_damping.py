"""Contact damping of feet and ground."""

from dataclasses import dataclass
from math import inf

import mujoco

from leapgap.effects.base import Effect, parameter
from leapgap.effects.contact import decide_contact, foot_geoms
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class ContactDamping(Effect):
    """Ratio of true to nominal damping of the feet's contacts (MuJoCo's ``solref``); their stiffness stays.

    MuJoCo lets no contact have a time constant below two steps, which bounds the damping of stiff feet.
    """

    name = "contact_damping"
    by_default = False
    places = "feet"

    scale: float = parameter(1.0, "1", 0.2, 5.0, 2.0, limits=(0.0, inf), logarithmic=True)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale the damping of the feet: in its form of time constant T and ratio ζ, T ζ is what stiffness has."""
        if self.is_nominal:
            return
        decide_contact(model, robot, self.location)
        for foot in foot_geoms(model, robot, self.location):
            if model.geom_solref[foot, 0] > 0:
                model.geom_solref[foot] *= (1 / self.scale, self.scale)
            else:
                model.geom_solref[foot, 1] *= self.scale
