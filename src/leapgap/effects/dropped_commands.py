"""Lost command packets."""

from dataclasses import dataclass

import numpy as np

from leapgap.effects.base import Commands, CommandStage, MotorEffect, parameter
from leapgap.effects.recursion import first_order
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class DroppedCommands(MotorEffect):
    """Share of the commands that are lost, each by chance and on its own; the joint PD goes on with the last one.

    Which ones were lost is not known, so the mean over all losses acts: with the share p, command u of row t is
    (1 − p) Σ pᵏ u(t − k). That is late by p / (1 − p) rows on average, and smooth. Each row has one command, however
    long it lasts.
    """

    name = "dropped_commands"
    by_default = False
    command_stage = CommandStage.CHOICE

    share: float = parameter(0.0, "1", 0.0, 0.95, 0.5)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Replace the commands of the joints by their mean over the losses."""
        at = robot.joints_at(self.location)
        row = np.arange(len(commands.torque)) if commands.row is None else commands.row
        begins = np.diff(row, prepend=-1) != 0

        def received(sent: np.ndarray) -> np.ndarray:
            mean, of_rows = sent.copy(), sent[begins][:, at]
            held = first_order(of_rows, self.share, of_rows[:1])  # the first command has arrived
            mean[:, at] = held[np.cumsum(begins) - 1]
            return mean

        return commands.each(received)
