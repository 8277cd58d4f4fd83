"""What effects between a motor and its joint share: a rotor beside the joint."""

from abc import abstractmethod
from dataclasses import dataclass

import mujoco

from leapgap.effects.base import MotorEffect
from leapgap.robot.model import Robot
from leapgap.robot.rotors import add_rotors, joints_with_rotors, lacks_rotors


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
        return super().lacks(robot) or lacks_rotors(robot)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Put rotors beside the joints."""
        add_rotors(spec, robot, joints_with_rotors(robot, self.location).tolist())

    @abstractmethod
    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """What holds rotor and joint together."""
