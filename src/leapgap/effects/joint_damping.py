"""Viscous friction of the gears."""

from dataclasses import dataclass
from math import inf

import mujoco

from leapgap.effects.base import Effect, Parameter, add_nonnegative, addition, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class JointDamping(Effect):
    """Damping added to the model's own; negative values reduce it, down to zero."""

    name = "joint_damping"
    places = "joints"

    damping: float = parameter(0.0, "N·m·s/rad", 0.0, 4.0, 0.4, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no damping at all upwards."""
        (declared,) = super().parameters(robot, location)
        return (addition(declared, robot.model.dof_damping[robot.joint_dofs[robot.joints_at(location)]]),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the damping of the joints."""
        dofs = robot.joint_dofs[robot.joints_at(self.location)]
        model.dof_damping[dofs] = add_nonnegative(model.dof_damping[dofs], self.damping)
