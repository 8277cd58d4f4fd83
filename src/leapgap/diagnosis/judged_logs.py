"""What is compared between logs and replays: rows, channels and their scales, chosen from the logs alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.channels import HEADLINE, Channel, scaled_channels
from leapgap.errors import InputError
from leapgap.logs.contacts import has_feet_in_world, sole_heights
from leapgap.logs.log import Log
from leapgap.logs.segments import FLIGHT, TOUCH_DOWN
from leapgap.robot.model import Robot

GAIN_CHANGE_MARGIN_S = 0.010
"""Time left out before a change of gains, which reaches the motors at an unknown instant near its row."""
SURELY_IN_FLIGHT = 1 / 3
"""After this share of the planned flight no foot can still be at the ground from before."""
TOUCHING_M = 0.005
"""Largest height of a sole above the ground that counts as touching."""


def headline_rows(log: Log, robot: Robot) -> int:
    """Number of judged rows: up to touch-down or the first change of gains, whichever is first."""
    rows = log.rows_before_gain_change
    if rows < len(log):
        rows -= round(GAIN_CHANGE_MARGIN_S / log.info.sample_period_s)
    return max(2, min(rows, touch_down_row(log, robot)))


def touch_down_row(log: Log, robot: Robot) -> int:
    """First row after the beginning of flight in which a sole is at the ground; all rows of a log without a flight."""
    segments = {segment.name: segment for segment in log.info.segments}
    if not {FLIGHT, TOUCH_DOWN} <= set(segments):
        return len(log)
    flight = segments[FLIGHT]
    if not has_feet_in_world(log, robot):
        return min(len(log), int(np.searchsorted(log.time, flight.end_s)) + 1)
    begin = int(np.searchsorted(log.time, flight.begin_s + SURELY_IN_FLIGHT * (flight.end_s - flight.begin_s)))
    if begin >= len(log):
        return len(log)
    touching = (sole_heights(log, robot, slice(begin, None)) < TOUCHING_M).any(axis=1)
    return begin + int(np.argmax(touching)) if touching.any() else len(log)


@dataclass(frozen=True)
class JudgedLogs:
    """Logs with the rows and channels that are compared."""

    logs: tuple[Log, ...]
    """Logs, cut after the judged rows."""
    channels: tuple[Channel, ...]
    """Headline channels that every log has."""

    @staticmethod
    def of(logs: Sequence[Log], robot: Robot) -> "JudgedLogs":
        """Choose rows and channels from the logs alone, so that every hypothesis is judged on the same ones."""
        if not logs:
            raise InputError("diagnose.logs", "no log", "one or more", "import or collect logs first")
        headline = tuple(c for c in scaled_channels(logs, robot) if c.name in HEADLINE or not robot.has_free_base)
        if not headline:
            raise InputError(
                logs[0].name,
                "no base state in every log",
                f"some of {', '.join(HEADLINE)}",
                "log the base state",
            )
        return JudgedLogs(tuple(log.first_rows(headline_rows(log, robot)) for log in logs), headline)

    @property
    def rows(self) -> tuple[int, ...]:
        """Number of judged rows of each log."""
        return tuple(len(log) for log in self.logs)

    @property
    def value_counts(self) -> np.ndarray:
        """Number of compared values of each log, (logs,)."""
        return np.array(self.rows) * len(self.channels)

    @property
    def scales(self) -> np.ndarray:
        """Scale of each channel, (channels,)."""
        return np.array([c.scale for c in self.channels], dtype=float)
