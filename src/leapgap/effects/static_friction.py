"""Static friction (stiction)."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf

import mujoco

from leapgap.effects.base import Effect, Parameter, parameter, widened
from leapgap.robot import dc_motors
from leapgap.robot.model import Robot

STRIBECK_RAD_S = 0.1
"""Speed over which the holding torque falls off as exp(−(q̇/v)²): that of greased gears."""
DEFLECTION_RAD = 0.005
"""Deflection of the teeth at which a joint breaks loose."""
BRISTLE_DAMPING_S = 0.002
"""Damping of the deflection, as a time: what it adds to the friction is that time times the stiffness."""
MOST = 0.15
"""Upper end of the search, as a share of the largest torque of the motors, if that is more than declared."""
SLIDING = 1e-3
"""Friction that is left at speed, as a share of the holding torque; the model's own friction stays beside it."""


@dataclass(frozen=True)
class StaticFriction(Effect):
    """Torque that holds a joint at rest beyond the model's own friction, and vanishes above 0.1 rad/s.

    The LuGre model (Canudas de Wit et al., IEEE Trans. Automatic Control 40, 1995) of MuJoCo's DC motor, in a passive
    actuator beside the joint's own. A motion starts with the teeth as far as its speed has dragged them.
    """

    name = "static_friction"
    by_default = False
    places = "joints"
    along_joints = True

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0, 1.0, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """Up to a share of the motors' largest torque."""
        (declared,) = super().parameters(robot, location)
        return (widened(declared, robot, location, MOST),)

    def _parts(self, robot: Robot) -> Iterator[tuple[str, str]]:
        """Joint and name of its passive actuator."""
        for i in robot.joints_at(self.location):
            yield robot.joints[i], f"{self.name} at {self.location} of {robot.joints[i]}"

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add a passive actuator to each joint that the friction acts at."""
        for joint, part in self._parts(robot):
            dc_motors.add_passive_friction(spec, joint, part)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the size of the friction."""
        if self.is_nominal:
            return
        friction = (SLIDING * self.torque_nm, self.torque_nm, STRIBECK_RAD_S)
        stiffness = self.torque_nm / DEFLECTION_RAD
        for _, part in self._parts(robot):
            actuator = model.actuator(part).id
            dc_motors.set_lugre_friction(model, actuator, stiffness, BRISTLE_DAMPING_S * stiffness, friction)
