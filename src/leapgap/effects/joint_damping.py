"""Viscous friction."""

from dataclasses import dataclass
from math import inf

import numpy as np

from leapgap.effects.base import AddedToJoints, ForceContext, parameter


@dataclass(frozen=True)
class JointDamping(AddedToJoints):
    """Damping added to the model's own; negative values reduce it, down to zero."""

    name = "joint_damping"
    model_field = "dof_damping"
    most = 0.1  # s/rad

    damping: float = parameter(0.0, "N·m·s/rad", 0.0, 4.0, 0.4, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the velocity."""
        return at.at_joints(location, -at.velocity)
