"""Rotational inertia of the trunk."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import parameter
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class TrunkInertia(InertialEffect):
    """Ratio of true to nominal rotational inertia of the base body about its centre of mass; its mass stays."""

    name = "trunk_inertia"
    needs_base = True

    scale: float = parameter(1.0, "1", 0.3, 3.0, 1.5)

    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Scale the inertia of the base body."""
        model.body_inertia[robot.base_body] *= self.scale
