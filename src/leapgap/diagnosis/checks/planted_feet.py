"""Do feet that are planned to stand keep their place (forward kinematics of base pose and encoders)?"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import feet_positions
from leapgap.robot.model import Robot

PLANTED_EVERY_S = 0.005
"""Planted feet are looked at so often."""
PLANTED_SHARE = 0.8
"""Of the phase in which all feet are planned to stand: at its end some may leave early."""


class PlantedFeet(Check):
    """A foot that stands stays where it is, whatever the base and the joints do."""

    name = "planted_feet"
    threshold = 0.01
    place: ClassVar[int] = 5

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Take how far any foot seems to move while all of them are planned to stand, m."""
        if robot is None or not robot.has_free_base or not robot.feet or any("base_pos_x" not in log for log in logs):
            return None
        drift = {}
        for log in logs:
            end = int(np.searchsorted(log.time, PLANTED_SHARE * log.info.schedule.double_contact_s))
            rows = slice(0, end, log.info.rows(PLANTED_EVERY_S))
            feet = feet_positions(robot, motion_of(log, robot, rows).qpos)
            drift[log.name] = float(np.linalg.norm(feet - feet[0], axis=2).max())
        statistic = float(np.median(list(drift.values())))
        says = f"planted feet wander by {1000 * statistic:.0f} mm (median over logs) while all four stand"
        return CheckResult(self.name, statistic <= threshold, statistic, threshold, says, drift)
