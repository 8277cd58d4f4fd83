"""Quadratic friction."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, Parameter, add_nonnegative, addition, parameter
from leapgap.robot.model import Robot

QUADRATIC = 0
"""Column of MuJoCo's ``dof_dampingpoly`` that multiplies |q̇| q̇."""


@dataclass(frozen=True)
class QuadraticDamping(Effect):
    """Torque −coefficient · |q̇| q̇ added to the model's own (MuJoCo's polynomial damping), down to none of it."""

    name = "quadratic_damping"
    by_default = False
    places = "joints"
    along_joints = True

    coefficient: float = parameter(0.0, "N·m·s²/rad²", 0.0, 1.0, 0.05, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no quadratic damping at all upwards."""
        (declared,) = super().parameters(robot, location)
        own = robot.model.dof_dampingpoly[robot.joint_dofs[robot.joints_at(location)], QUADRATIC]
        return (addition(declared, own),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the velocity, by its square."""
        return at.at_joints(location, -np.abs(at.velocity) * at.velocity)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the quadratic damping of the joints."""
        dofs = robot.joint_dofs[robot.joints_at(self.location)]
        model.dof_dampingpoly[dofs, QUADRATIC] = add_nonnegative(
            model.dof_dampingpoly[dofs, QUADRATIC], self.coefficient
        )
