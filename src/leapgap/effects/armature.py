"""Reflected rotor inertia."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import (
    Effect,
    ForceContext,
    Parameter,
    add_nonnegative,
    addition,
    parameter,
    recompute_constants,
    widened,
)
from leapgap.robot.model import Robot

MOST = 0.004
"""Upper end of the search, as a share of the largest torque of the motors, s²/rad, if that is more than declared."""


@dataclass(frozen=True)
class Armature(Effect):
    """Rotor inertia added to the model's own; a negative value takes some of it away, down to zero."""

    name = "armature"
    places = "joints"
    along_joints = True

    inertia: float = parameter(0.0, "kg·m²", 0.0, 0.15, 0.02, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no armature at all upwards."""
        (declared,) = super().parameters(robot, location)
        declared = widened(declared, robot, location, MOST)
        return (addition(declared, robot.model.dof_armature[robot.joint_dofs[robot.joints_at(location)]]),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the acceleration."""
        return at.at_joints(location, -at.acceleration)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the armature of the joints."""
        if self.is_nominal:
            return
        dofs = robot.joint_dofs[robot.joints_at(self.location)]
        model.dof_armature[dofs] = add_nonnegative(model.dof_armature[dofs], self.inertia)
        recompute_constants(model)
