"""Command latency."""

import math
from dataclasses import dataclass

import numpy as np

from leapgap.effects.base import Commands, MotorEffect, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class CommandDelay(MotorEffect):
    """Torque feed-forward and set points arrive later; the joint PD itself runs at the joint, at once.

    Each command is held for one period. Where the delay is no whole number of periods, a period sees the end of one
    command and the beginning of the next: it gets their mean, weighted by time, hence the exact impulse. Before
    anything arrives the first command holds.
    """

    name = "command_delay"

    delay_s: float = parameter(0.0, "s", 0.0, 0.15, 0.005)

    @property
    def memory_s(self) -> float:
        """All of the delay."""
        return self.delay_s

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Shift the commands of the joints."""
        at = robot.joints_at(self.location)
        rows = np.arange(len(commands.torque)) - self.delay_s / period_s
        whole = np.floor(rows + 1e-9).astype(int)  # a delay of whole periods is one in spite of rounding
        share = np.clip(rows - whole, 0.0, 1.0)[:, None]
        before, after = np.maximum(whole, 0), np.maximum(whole + 1, 0).clip(max=len(rows) - 1)

        def late(sent: np.ndarray) -> np.ndarray:
            arrived = sent.copy()
            arrived[:, at] = (1 - share) * sent[before][:, at] + share * sent[after][:, at]
            return arrived

        return commands.each(late)

    def change_newest_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """The same for the last period, by the same arithmetic."""
        last = len(commands.torque) - 1
        row = last - self.delay_s / period_s
        whole = math.floor(row + 1e-9)
        share = min(max(row - whole, 0.0), 1.0)
        before, after = max(whole, 0), min(max(whole + 1, 0), last)
        at = slice(None) if self.location == "all" else robot.joints_at(self.location)

        def late(sent: np.ndarray) -> np.ndarray:
            arrived = sent[-1:].copy()
            arrived[0, at] = (1 - share) * sent[before, at] + share * sent[after, at]
            return arrived

        return commands.each(late)
