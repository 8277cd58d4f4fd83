"""Do the base's positions follow from its velocities at the claimed sample period?"""

from collections.abc import Sequence
from typing import ClassVar

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.diagnosis.checks.clocks import Clock, judge_clocks
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

PAIRS = (("base_pos_x", "base_linvel_x"), ("base_pos_z", "base_linvel_z"))
"""Positions and the velocities that they are the integrals of."""


class BaseClock(Check):
    """The clock of the log, by the base."""

    name = "base_clock"
    threshold = 0.02
    place: ClassVar[int] = 3
    needs_robot = False

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Compare position increments with summed velocities, forward and up."""
        floats = robot is None or robot.has_free_base
        if not floats or any(name not in log for log in logs for pair in PAIRS for name in pair):
            return None
        clocks = {
            log.name: Clock.of(log, *(log.stack(columns) for columns in zip(*PAIRS, strict=True))) for log in logs
        }
        return judge_clocks(self.name, "the base", clocks, threshold)
