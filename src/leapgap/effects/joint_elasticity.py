"""Gears and belts that give: a spring between motor and joint."""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from math import inf

import mujoco

from leapgap.effects.base import Effect, Parameter, parameter
from leapgap.robot.model import Robot
from leapgap.robot.rotors import (
    add_rotors,
    joints_with_rotors,
    lacks_rotors,
    mount_rotors,
    reduced_inertia,
    soften,
)

STIFF_RAD_S = 1000.0
"""Natural frequency of rotor against link above which a joint counts as stiff."""
MODERATE, LARGEST = 5.0, 50.0
"""Noticeable and largest compliance, over that of a stiff joint."""


@dataclass(frozen=True)
class JointElasticity(Effect):
    """Angle by which a joint gives under 1 N·m of its motor: 1 / stiffness of the spring between rotor and joint.

    The armature is the rotor's inertia. The joint PD acts on the rotor, and the log reports the joint.
    """

    name = "joint_elasticity"
    by_default = False
    places = "joints"
    needs_motor = True
    has_rotors = True

    compliance_rad_nm: float = parameter(0.0, "rad/(N·m)", 0.0, 0.01, 0.001, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """A rotor without inertia would swing without end."""
        return super().lacks(robot) or lacks_rotors(robot)

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """In units of the compliance with which rotor and link swing at 1000 rad/s."""
        (declared,) = super().parameters(robot, location)
        at = joints_with_rotors(robot, location)
        stiff = float(1 / (reduced_inertia(robot, at).min() * STIFF_RAD_S**2))
        return (replace(declared, upper=LARGEST * stiff, moderate=MODERATE * stiff),)

    @property
    def structure(self) -> Hashable | None:
        """Key of the joints that get a rotor; None where none gives."""
        return None if self.is_nominal else (self.name, self.location)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Put rotors beside the joints."""
        add_rotors(spec, robot, joints_with_rotors(robot, self.location).tolist())

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the compliance of the springs."""
        if self.is_nominal:
            return
        joints = joints_with_rotors(robot, self.location)
        soften(model, robot, joints, mount_rotors(model, robot, joints), self.compliance_rad_nm)
