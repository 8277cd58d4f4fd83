"""Do the joints' positions follow from their velocities at the claimed sample period?"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.diagnosis.checks.clocks import CLAIMED, clock_scale, judge_clocks, longest_period, of_joints
from leapgap.logs.log import Log
from leapgap.robot.model import Robot


class JointClock(Check):
    """The clock of the log, by the joints: encoders and their velocities are measured in true time."""

    name = "joint_clock"
    threshold = 0.02
    place: ClassVar[int] = 1
    needs_robot = False

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Compare position increments with summed velocities, over all joints of each log."""

        def scale(log: Log, position: np.ndarray, velocity: np.ndarray) -> float | None:
            return clock_scale(position, velocity, log.info.sample_period_s, log.row_lengths)

        scales = of_joints(scale, logs, robot)
        if scales is None:
            return None
        result = judge_clocks(self.name, "the joints", scales, threshold, longest_period(logs))
        clocks = {name: CLAIMED if own is None else (own,) for name, own in scales.items()}
        return result and replace(result, clocks=clocks)
