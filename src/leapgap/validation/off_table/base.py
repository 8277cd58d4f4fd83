"""What the nameless effects share: they may act while the simulation runs, with a memory of their own."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

Process = Callable[[mujoco.MjModel, mujoco.MjData], None]
"""Called before every step, applied forces zeroed: adds forces, or changes a model that is this run's own."""


@dataclass(frozen=True)
class OffTableEffect(Effect):
    """An effect outside ``leapgap.effects``, whose table is what a diagnosis looks for."""

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """What it does step by step on one jump; ``None`` where the methods ``change_…`` say it all."""
        return None
