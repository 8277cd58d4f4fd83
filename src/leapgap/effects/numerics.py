"""Integration error of the simulator."""

from dataclasses import dataclass, replace
from math import inf

from leapgap.effects.base import Effect, Parameter, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class Numerics(Effect):
    """Length of the steps of the simulation that moves as the log does, over that of the replay's own steps.

    0 is the limit of short steps: then a finer simulation closes the gap, and the model is right. 2 is a log of a
    simulation with steps twice as long. The error of a step is taken as proportional to its length; a replay with this
    effect is made of one by the usual steps and one by steps of a quarter.
    """

    name = "numerics"
    by_default = False

    step_ratio: float = parameter(1.0, "1", 0.0, 4.0, 0.25, limits=(0.0, inf))

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From the limit of short steps, which is an answer, upwards."""
        (declared,) = super().parameters(robot, location)
        return (replace(declared, lower_is_physical=True),)

    def change_step(self, ratio: float) -> float:
        """Scale the length of a step."""
        return ratio * self.step_ratio
