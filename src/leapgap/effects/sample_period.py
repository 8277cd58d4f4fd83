"""A control loop that runs slower or faster than its log claims."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class SamplePeriod(Effect):
    """True over claimed period of a row: commands are held longer, and everything happens at another pace.

    Depends on the load of the computer, hence differs from log to log.
    """

    name = "sample_period"
    differs_per_log = True

    scale: float = parameter(1.0, "1", 0.8, 1.3)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Stretch the time that passes a step; the number of steps a row stays."""
        model.opt.timestep *= self.scale
