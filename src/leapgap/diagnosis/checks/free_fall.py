"""Does the centre of mass fall with the model's gravity in flight, judged from the base's position and the joints?"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.logs.contacts import has_feet_in_world, in_flight, longest_run
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import centre_of_mass
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of

GRAVITY = 9.81  # Of a model for which the check speaks of g, m/s²
SHORTEST_FALL_S = 0.05  # A shorter stretch of flight does not say how the robot falls
MARGIN_S = 0.03
"""So much at both ends of a flight is left out: a foot that is a little above the ground may still touch it."""


class FreeFall(Check):
    """Nothing but gravity moves the centre of mass of a robot in the air."""

    name = "free_fall"
    threshold = 0.08
    place: ClassVar[int] = 4

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Fit a parabola to the height of the centre of mass in the longest time in which no foot touches."""
        if robot is None or not all(has_feet_in_world(log, robot) for log in logs):
            return None
        gravity, falls = float(-gravity_of(robot.model)[2]), {}
        unit = "g" if gravity == GRAVITY else f"times {gravity:g} m/s², the gravity of the model,"
        for log in logs:
            flight = longest_run(in_flight(log, robot))
            margin = log.info.rows(MARGIN_S)
            begin, end = flight.start + margin, flight.stop - margin
            if end - begin < log.info.rows(SHORTEST_FALL_S):
                continue
            height = centre_of_mass(robot, motion_of(log, robot, slice(begin, end)).qpos)[:, 2]
            time = log.time[begin:end] - log.time[begin]
            falls[log.name] = float(-2 * np.polyfit(time, height, 2)[0] / gravity)
        if not falls:
            return None
        statistic = float(np.median(list(falls.values()))) - 1
        passed = abs(statistic) <= threshold
        says = f"in flight the centre of mass falls with {1 + statistic:.2f} {unit}" + (
            ""
            if passed
            else f" by the log's clock, which would be right if a sample took {np.sqrt(1 + statistic):.2f} "
            "times the claimed period"
        )
        return CheckResult(self.name, passed, abs(statistic), threshold, says, falls)
