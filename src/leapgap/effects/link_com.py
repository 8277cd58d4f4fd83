"""Centre-of-mass offset of the links."""

from dataclasses import dataclass, replace
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Parameter, parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.effects.links import arm_of_centre, links_at, move_centre, outward
from leapgap.robot.model import Robot

LEAST_RANGE_M, MODERATE = 0.05, 0.2
"""Least limit of the search, and the noticeable value as a share of the limit."""


@dataclass(frozen=True)
class LinkCom(InertialEffect):
    """Shift of a link's centre of mass away from the axis of its joint; negative towards it, and beyond.

    A joint feels mass · g · shift of it. Mass and inertia about the centre stay.
    """

    name = "link_com"
    by_default = False
    places = "joints"

    outward_m: float = parameter(0.0, "m", -0.05, 0.05, 0.01, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """As far as the centre is from the axis, to either side, and at least 5 cm."""
        (declared,) = super().parameters(robot, location)
        arms = [float(np.linalg.norm(arm_of_centre(robot, int(body)))) for body in links_at(robot, location)]
        most = max(LEAST_RANGE_M, *arms)
        return (replace(declared, lower=-most, upper=most, moderate=MODERATE * most),)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the inertial frames of the links."""
        for body in links_at(robot, self.location):
            move_centre(model, int(body), self.outward_m * outward(robot, int(body)))
