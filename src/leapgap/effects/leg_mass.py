"""Link mass error."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class LegMass(InertialEffect):
    """Ratio of true to nominal mass and inertia of the links that the located joints move; shapes and centres stay.

    Robots whose base is held have no legs: there it is called ``link_mass``.
    """

    name = "leg_mass"
    other_names = ("link_mass",)
    places = "joints"

    scale: float = parameter(1.0, "1", 0.1, 2.0, 1.3)

    @classmethod
    def called(cls, robot: Robot) -> str:
        """Links are called legs on a robot with a free base."""
        return cls.name if robot.has_free_base else cls.other_names[0]

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale mass and inertia of the links and of the bodies fixed to them."""
        links = np.isin(model.body_weldid, robot.joint_bodies[robot.joints_at(self.location)])
        model.body_mass[links] *= self.scale
        model.body_inertia[links] *= self.scale
