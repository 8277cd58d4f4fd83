"""Joint Coulomb friction."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, Parameter, add_nonnegative, addition, parameter, widened
from leapgap.robot.model import Robot

MOST = 0.15
"""Upper end of the search, as a share of the largest torque of the motors, if that is more than declared."""

STILL_RAD_S = 0.01
"""Speed below which a joint that starts or stops is between both directions."""


@dataclass(frozen=True)
class JointFriction(Effect):
    """Friction torque of the gears added to the model's own; negative values reduce it, down to zero."""

    name = "joint_friction"
    places = "joints"
    along_joints = True

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0, 1.0, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no friction at all upwards."""
        (declared,) = super().parameters(robot, location)
        declared = widened(declared, robot, location, MOST)
        return (addition(declared, robot.model.dof_frictionloss[robot.joint_dofs[robot.joints_at(location)]]),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the motion as MuJoCo's soft constraint sees it, which looks ahead by half its time constant.

        A joint that stands is held by what pushes it, so that its force is not known.
        """
        dofs = at.robot.joint_dofs
        ahead_s = np.maximum(at.model.dof_solref[dofs, 0], 0.0) * at.model.dof_solimp[dofs, 1] / 2
        return at.at_joints(location, -np.tanh((at.velocity + ahead_s * at.acceleration) / STILL_RAD_S))

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the friction loss of the joints."""
        dofs = robot.joint_dofs[robot.joints_at(self.location)]
        model.dof_frictionloss[dofs] = add_nonnegative(model.dof_frictionloss[dofs], self.torque_nm)
