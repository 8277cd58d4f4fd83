"""Inertia of rotors and gears, seen at the joint."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter, recompute_constants
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Armature(Effect):
    """Rotor inertia, added to the model's own."""

    name = "armature"
    places = "joints"

    inertia: float = parameter(0.0, "kg·m²", 0.0, 0.15, 0.02)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the armature of the joints."""
        if self.is_nominal:
            return
        model.dof_armature[robot.joint_dofs[robot.joints_at(self.location)]] += self.inertia
        recompute_constants(model)
