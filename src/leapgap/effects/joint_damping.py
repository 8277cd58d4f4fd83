"""Viscous friction."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, Parameter, add_nonnegative, addition, parameter, widened
from leapgap.robot.model import Robot

MOST = 0.1
"""Upper end of the search, as a share of the largest torque of the motors, s/rad, if that is more than declared."""


@dataclass(frozen=True)
class JointDamping(Effect):
    """Damping added to the model's own; negative values reduce it, down to zero."""

    name = "joint_damping"
    places = "joints"
    along_joints = True

    damping: float = parameter(0.0, "N·m·s/rad", 0.0, 4.0, 0.4, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no damping at all upwards."""
        (declared,) = super().parameters(robot, location)
        declared = widened(declared, robot, location, MOST)
        return (addition(declared, robot.model.dof_damping[robot.joint_dofs[robot.joints_at(location)]]),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the velocity."""
        return at.at_joints(location, -at.velocity)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the damping of the joints."""
        dofs = robot.joint_dofs[robot.joints_at(self.location)]
        model.dof_damping[dofs] = add_nonnegative(model.dof_damping[dofs], self.damping)
