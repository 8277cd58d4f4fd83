"""Do feet that stand keep their place, and does the robot fall in flight as gravity has it, by kinematics alone?"""

from collections.abc import Sequence

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.logs.contacts import feet_in_world, has_feet_in_world, in_flight, longest_run, longest_stance
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import centre_of_mass
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of

GRAVITY = 9.81  # Of a model for which the check speaks of g, m/s²
SHORTEST_FALL_S = 0.05  # A shorter stretch of flight does not say how the robot falls
MARGIN_S = 0.03
"""So much at both ends of a flight is left out: a foot that is a little above the ground may still touch it."""
PLANTED_EVERY_S = 0.005  # Planted feet are looked at so often
PLANTED_SHARE = 0.8  # Of the longest time in which all feet stand: at its end some may slip before they leave
SHORTEST_STANCE_S = 0.1  # A shorter stance does not say whether feet stay


class FreeFall(Check):
    """Nothing but gravity moves the centre of mass of a robot in the air."""

    name = "free_fall"
    threshold = 0.08
    place = 4

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


class PlantedFeet(Check):
    """A foot that stands stays where it is, whatever the base and the joints do."""

    name = "planted_feet"
    threshold = 0.01
    place = 5

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
