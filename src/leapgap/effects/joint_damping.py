"""Viscous friction of the gears."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class JointDamping(Effect):
    """Torque against the joint's velocity, added to the model's own."""

    name = "joint_damping"
    places = "joints"

    damping: float = parameter(0.0, "N·m·s/rad", 0.0, 4.0, 0.4)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the damping of the joints."""
        model.dof_damping[robot.joint_dofs[robot.joints_at(self.location)]] += self.damping
