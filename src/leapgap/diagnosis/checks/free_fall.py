"""Does the centre of mass fall with g in flight, judged from the base's position and the joints?"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import centre_of_mass
from leapgap.robot.model import Robot

GRAVITY = 9.81
SHORTEST_FALL_S = 0.05
"""A shorter stretch of flight does not say how the robot falls."""
MARGIN_S = 0.05
"""So much at both ends of the planned flight is left out: feet may leave late and touch early."""


class FreeFall(Check):
    """Nothing but gravity moves the centre of mass of a robot in the air."""

    name = "free_fall"
    threshold = 0.08
    place: ClassVar[int] = 4

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Fit a parabola to the height of the centre of mass during the planned flight."""
        if robot is None or not robot.has_free_base or any("base_pos_z" not in log for log in logs):
            return None
        falls = {}
        for log in logs:
            schedule = log.info.schedule
            begin = int(np.searchsorted(log.time, schedule.take_off_s + MARGIN_S))
            end = int(np.searchsorted(log.time, schedule.landing_s - MARGIN_S))
            if end - begin < log.info.rows(SHORTEST_FALL_S):
                continue
            height = centre_of_mass(robot, motion_of(log, robot, slice(begin, end)).qpos)[:, 2]
            time = log.time[begin:end] - log.time[begin]
            falls[log.name] = float(-2 * np.polyfit(time, height, 2)[0] / GRAVITY)
        if not falls:
            return None
        statistic = float(np.median(list(falls.values()))) - 1
        passed = abs(statistic) <= threshold
        says = f"in flight the centre of mass falls with {1 + statistic:.2f} g" + (
            ""
            if passed
            else f" by the log's clock, which would be right if a row took {np.sqrt(1 + statistic):.2f} "
            "times the claimed period"
        )
        return CheckResult(self.name, passed, abs(statistic), threshold, says, falls)
