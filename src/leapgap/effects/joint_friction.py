"""Joint Coulomb friction."""

from dataclasses import dataclass
from math import inf

import numpy as np

from leapgap.effects.base import AddedToJoints, ForceContext, parameter

STILL_RAD_S = 0.01
"""Speed below which a joint that starts or stops is between both directions."""


@dataclass(frozen=True)
class JointFriction(AddedToJoints):
    """Friction torque of the gears added to the model's own; negative values reduce it, down to zero."""

    name = "joint_friction"
    model_field = "dof_frictionloss"
    most = 0.15

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0, 1.0, limits=(-inf, inf))

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the motion as MuJoCo's soft constraint sees it, which looks ahead by half its time constant.

        A joint that stands is held by what pushes it, so that its force is not known.
        """
        dofs = at.robot.joint_dofs
        ahead_s = np.maximum(at.model.dof_solref[dofs, 0], 0.0) * at.model.dof_solimp[dofs, 1] / 2
        return at.at_joints(location, -np.tanh((at.velocity + ahead_s * at.acceleration) / STILL_RAD_S))
