"""Elasticity and play between a motor and its joint: a rotor beside the joint."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import MotorEffect, Parameter, parameter
from leapgap.robot.model import Robot
from leapgap.robot.rotors import add_rotors, joints_with_rotors, mount_rotors, reduced_inertia, soften


@dataclass(frozen=True)
class RotorEffect(MotorEffect):
    """An effect between rotor and joint: the joint PD acts on the rotor, and the log reports the joint.

    The armature is the rotor's inertia.
    """

    by_default = False
    has_rotors = True

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """A rotor without inertia would swing without end."""
        rotors = robot.model.dof_armature[robot.joint_dofs[robot.driven]]
        have = len(rotors) and (rotors > 0).all()
        return super().lacks(robot) or (None if have else "the inertia of its rotors (armature)")

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Put rotors beside the joints."""
        add_rotors(spec, robot, joints_with_rotors(robot, self.location).tolist())

    @abstractmethod
    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """What holds rotor and joint together."""


STIFF_RAD_S = 1000.0  # natural frequency of rotor against link above which a joint counts as stiff
MODERATE_COMPLIANCE, LARGEST_COMPLIANCE = 5.0, 50.0  # noticeable and largest compliance, over that of a stiff joint


@dataclass(frozen=True)
class JointElasticity(RotorEffect):
    """Angle by which a joint gives under 1 N·m of its motor: 1 / stiffness of the spring between rotor and joint."""

    name = "joint_elasticity"
    words = "joint elasticity"

    compliance_rad_nm: float = parameter(0.0, "rad/(N·m)", 0.0, 0.01, 0.001, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """In units of the compliance with which rotor and link swing at 1000 rad/s."""
        (declared,) = super().parameters(robot, location)
        at = joints_with_rotors(robot, location)
        stiff = float(1 / (reduced_inertia(robot, at).min() * STIFF_RAD_S**2))
        return (replace(declared, upper=LARGEST_COMPLIANCE * stiff, moderate=MODERATE_COMPLIANCE * stiff),)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the compliance of the springs."""
        if self.is_nominal:
            return
        joints = joints_with_rotors(robot, self.location)
        soften(model, robot, joints, mount_rotors(model, robot, joints), self.compliance_rad_nm)


@dataclass(frozen=True)
class JointPlay(RotorEffect):
    """Angle within which a rotor turns without a torque on its joint, from stop to stop.

    A motion starts with the teeth on the side to which the first command pushes.
    """

    name = "joint_play"
    words = "backlash"

    play_rad: float = parameter(0.0, "rad", 0.0, 0.1, 0.01, limits=(0.0, inf))

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Widen the range in which the rotors turn freely."""
        if self.is_nominal:
            return
        tendons = mount_rotors(model, robot, joints_with_rotors(robot, self.location))
        ends = self.play_rad / 2 * np.array([-1.0, 1.0])
        model.tendon_range[tendons] += ends
        model.tendon_lengthspring[tendons] += ends
