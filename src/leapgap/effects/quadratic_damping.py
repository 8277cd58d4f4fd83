"""Quadratic friction."""

from dataclasses import dataclass
from math import inf

import numpy as np

from leapgap.effects.base import AddedToJoints, ForceContext, parameter


@dataclass(frozen=True)
class QuadraticDamping(AddedToJoints):
    """Torque −coefficient · |q̇| q̇ added to the model's own (MuJoCo's polynomial damping), down to none of it."""

    name = "quadratic_damping"
    by_default = False
    model_field = "dof_dampingpoly"

    coefficient: float = parameter(0.0, "N·m·s²/rad²", 0.0, 1.0, 0.05, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the velocity, by its square."""
        return at.at_joints(location, -np.abs(at.velocity) * at.velocity)
