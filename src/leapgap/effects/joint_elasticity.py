"""Joint elasticity."""

from dataclasses import dataclass, replace
from math import inf

import mujoco

from leapgap.effects.base import Parameter, parameter
from leapgap.effects.rotor_effect import RotorEffect
from leapgap.robot.model import Robot
from leapgap.robot.rotors import joints_with_rotors, mount_rotors, reduced_inertia, soften

STIFF_RAD_S = 1000.0
"""Natural frequency of rotor against link above which a joint counts as stiff."""
MODERATE, LARGEST = 5.0, 50.0
"""Noticeable and largest compliance, over that of a stiff joint."""


@dataclass(frozen=True)
class JointElasticity(RotorEffect):
    """Angle by which a joint gives under 1 N·m of its motor: 1 / stiffness of the spring between rotor and joint."""

    name = "joint_elasticity"

    compliance_rad_nm: float = parameter(0.0, "rad/(N·m)", 0.0, 0.01, 0.001, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """In units of the compliance with which rotor and link swing at 1000 rad/s."""
        (declared,) = super().parameters(robot, location)
        at = joints_with_rotors(robot, location)
        stiff = float(1 / (reduced_inertia(robot, at).min() * STIFF_RAD_S**2))
        return (replace(declared, upper=LARGEST * stiff, moderate=MODERATE * stiff),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the compliance of the springs."""
        if self.is_nominal:
            return
        joints = joints_with_rotors(robot, self.location)
        soften(model, robot, joints, mount_rotors(model, robot, joints), self.compliance_rad_nm)
