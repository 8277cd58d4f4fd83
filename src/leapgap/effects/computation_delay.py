"""Controller computation time."""

from dataclasses import dataclass

import numpy as np

from leapgap.effects.base import Commands, CommandStage, Effect, parameter
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class ComputationDelay(Effect):
    """Commands of a sample reach the joints after a share of the sample period; until then the former commands hold.

    A process that reads the state, computes, sends and logs once a loop writes the state of the loop's beginning
    beside commands of its end. Where rows last unequally long, so does this delay: a stalled loop sends late. Where all
    rows are equally long it would be a ``command_delay``, and only that is looked for.
    """

    name = "computation_delay"
    needs_motor = True
    by_default = False
    beside_clock = True
    command_stage = CommandStage.SENDING

    share: float = parameter(0.0, "rows", 0.0, 2.0, 0.5)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Mean of what has arrived in each period, hence the exact impulse."""
        count = len(commands.torque)
        if self.is_nominal or not count:
            return commands
        row = np.arange(count) if commands.row is None else commands.row
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        # Row r + share, in periods: a share above one reaches into the next row.
        arrive = np.interp(np.arange(len(starts)) + self.share, np.arange(len(starts) + 1), [*starts, count])
        return commands.each(lambda sent: arrivals(sent[starts], arrive, count))


def arrivals(sent: np.ndarray, arrive: np.ndarray, count: int) -> np.ndarray:
    """Mean in each of ``count`` periods of commands (commands, joints) that hold from ``arrive`` (commands,) on.

    ``arrive`` in periods; before anything arrives the first command holds.
    """
    knots = np.concatenate([[min(0.0, arrive[0])], arrive[1:], [max(count, arrive[-1]) + 1.0]])
    impulse = np.concatenate([np.zeros((1, sent.shape[1])), np.cumsum(np.diff(knots)[:, None] * sent, axis=0)])
    at = np.arange(count + 1.0)
    return np.stack([np.diff(np.interp(at, knots, of)) for of in impulse.T], axis=1)
