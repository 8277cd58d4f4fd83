"""Play in the gears (backlash): the motor turns freely within it before its teeth push the joint."""

from collections.abc import Hashable
from dataclasses import dataclass
from math import inf

import mujoco

from leapgap.effects.base import Effect, parameter
from leapgap.robot.model import Robot
from leapgap.robot.rotors import add_rotors, joints_with_rotors, lacks_rotors, mount_rotors, widen_play


@dataclass(frozen=True)
class JointPlay(Effect):
    """Angle within which a rotor turns without a torque on its joint, from stop to stop.

    The armature is the rotor's inertia. The joint PD acts on the rotor, and the log reports the joint. A motion starts
    with the teeth on the side to which the first command pushes.
    """

    name = "joint_play"
    by_default = False
    places = "joints"
    needs_motor = True
    has_rotors = True

    play_rad: float = parameter(0.0, "rad", 0.0, 0.1, 0.01, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """A rotor without inertia would swing without end."""
        return super().lacks(robot) or lacks_rotors(robot)

    @property
    def structure(self) -> Hashable | None:
        """Key of the joints that get a rotor; None without play."""
        return None if self.is_nominal else (self.name, self.location)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Put rotors beside the joints."""
        add_rotors(spec, robot, joints_with_rotors(robot, self.location).tolist())

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Widen the range in which the rotors turn freely."""
        if self.is_nominal:
            return
        widen_play(model, mount_rotors(model, robot, joints_with_rotors(robot, self.location)), self.play_rad)
