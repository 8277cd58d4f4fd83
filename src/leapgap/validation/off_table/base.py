"""Base class of the off-table effects, which may act at every simulation step and keep a state of their own."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

Process = Callable[[mujoco.MjModel, mujoco.MjData], None]
"""Called before every simulation step, after applied forces were set to zero.

It adds forces or changes the model, which belongs to this run alone.
"""


@dataclass(frozen=True)
class OffTableEffect(Effect):
    """An effect outside ``leapgap.effects``, the table of hypotheses of a diagnosis."""

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """The process that acts at each step of one jump; ``None`` where the methods ``change_…`` do everything."""
        return None
