"""Do feet that stand keep their place (forward kinematics of base pose and encoders)?"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.logs.contacts import feet_in_world, has_feet_in_world, longest_stance
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

PLANTED_EVERY_S = 0.005  # Planted feet are looked at so often
PLANTED_SHARE = 0.8  # Of the longest time in which all feet stand: at its end some may slip before they leave
SHORTEST_STANCE_S = 0.1  # A shorter stance does not say whether feet stay


class PlantedFeet(Check):
    """A foot that stands stays where it is, whatever the base and the joints do."""

    name = "planted_feet"
    threshold = 0.01
    place: ClassVar[int] = 5

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Take how far any foot seems to move while all of them stand, m."""
        if robot is None or not all(has_feet_in_world(log, robot) for log in logs):
            return None
        drift = {}
        for log in logs:
            stance = longest_stance(log, robot)
            end = stance.start + round(PLANTED_SHARE * (stance.stop - stance.start))
            if end - stance.start < log.info.rows(SHORTEST_STANCE_S):
                continue
            feet = feet_in_world(log, robot, slice(stance.start, end, log.info.rows(PLANTED_EVERY_S)))
            drift[log.name] = float(np.linalg.norm(feet - feet[0], axis=2).max())
        if not drift:
            return None
        statistic = float(np.median(list(drift.values())))
        says = f"planted feet wander by {1000 * statistic:.0f} mm (median over logs) while all of them stand"
        return CheckResult(self.name, statistic <= threshold, statistic, threshold, says, drift)
