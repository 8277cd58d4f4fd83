"""Coulomb friction of the gears."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class JointFriction(Effect):
    """Gears eat up to a constant torque, added to the model's own."""

    name = "joint_friction"
    places = "joints"

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0, 1.0)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the friction loss of the joints."""
        model.dof_frictionloss[robot.joint_dofs[robot.joints_at(self.location)]] += self.torque_nm
