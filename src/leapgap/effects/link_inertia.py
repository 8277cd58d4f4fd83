"""Rotational inertia of the links."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.effects.links import links_at
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class LinkInertia(InertialEffect):
    """Ratio of true to nominal rotational inertia of links about their centres of mass; masses and centres stay."""

    name = "link_inertia"
    by_default = False
    places = "joints"

    scale: float = parameter(1.0, "1", 0.1, 5.0, 1.5)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale the inertia of the links that the located joints move."""
        model.body_inertia[links_at(robot, self.location)] *= self.scale
