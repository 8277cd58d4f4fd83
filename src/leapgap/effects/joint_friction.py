"""Coulomb friction of the gears, or motors that make up for more of it than the log says."""

from dataclasses import dataclass, replace
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, Parameter, add_nonnegative, addition, parameter
from leapgap.robot.model import Robot

MADE_UP = 0.03
"""Torque that motors may add along the motion, beyond the model's own friction, as a share of their largest torque."""
STILL_RAD_S = 0.05
"""Below such speeds that torque fades out, as it does in controllers that make up for friction."""


@dataclass(frozen=True)
class JointFriction(Effect):
    """Friction torque of the gears added to the model's own; negative values reduce it.

    Below no friction at all, motors help the motion by the joint velocities that the log reports: so does a controller
    that makes up for friction by a torque which the log does not hold.
    """

    name = "joint_friction"
    places = "joints"

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0, 1.0, limits=(-inf, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From what motors may make up for upwards; the end of a model that states no torque is no friction at all."""
        (declared,) = super().parameters(robot, location)
        at = robot.joints_at(location)
        own = robot.model.dof_frictionloss[robot.joint_dofs[at]]
        found = addition(declared, own)
        limits = robot.torque_limits[at]
        most = MADE_UP * float(limits[np.isfinite(limits)].max(initial=0.0))
        return (replace(found, lower=found.lower - most),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the friction loss of the joints."""
        dofs = robot.joint_dofs[robot.joints_at(self.location)]
        model.dof_frictionloss[dofs] = add_nonnegative(model.dof_frictionloss[dofs], self.torque_nm)

    def torque_by_velocity(self, velocity: np.ndarray, robot: Robot) -> np.ndarray | None:
        """What is below no friction, along the motion."""
        at = robot.joints_at(self.location)
        below = np.maximum(-robot.model.dof_frictionloss[robot.joint_dofs[at]] - self.torque_nm, 0.0) * robot.driven[at]
        if not below.any():
            return None
        torque = np.zeros_like(velocity)
        torque[:, at] = below * np.tanh(velocity[:, at] / STILL_RAD_S)
        return torque
