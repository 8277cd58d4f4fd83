"""Reflected rotor inertia."""

from dataclasses import dataclass
from math import inf

import numpy as np

from leapgap.effects.base import AddedToJoints, ForceContext, parameter


@dataclass(frozen=True)
class Armature(AddedToJoints):
    """Rotor inertia added to the model's own; a negative value takes some of it away, down to zero."""

    name = "armature"
    model_field = "dof_armature"
    most = 0.004  # s²/rad

    inertia: float = parameter(0.0, "kg·m²", 0.0, 0.15, 0.02, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the acceleration."""
        return at.at_joints(location, -at.acceleration)
