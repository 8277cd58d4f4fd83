"""Do the joints' positions follow from their velocities at the claimed sample period?"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from leapgap.diagnosis.checks.base import Check, CheckResult, joints_of
from leapgap.diagnosis.checks.clocks import CLAIMED, Clock, judge_clocks, of_joints, ripple_of
from leapgap.logs.log import Log
from leapgap.robot.model import Robot


class JointClock(Check):
    """The clock of the log, by the joints: encoders and their velocities are measured in true time."""

    name = "joint_clock"
    threshold = 0.02
    place: ClassVar[int] = 1
    needs_robot = False
    velocities_in_time = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Compare position increments with summed velocities, over all joints of each log."""
        clocks = of_joints(Clock.of, logs, robot)
        if clocks is None:
            return None
        named = joints_of(logs, robot)
        clocks = {log.name: replace(clocks[log.name], ripple=ripple_of(log, named)) for log in logs}
        result = judge_clocks(self.name, "the joints", clocks, threshold)
        scales = {name: CLAIMED if own.scale is None else (own.scale,) for name, own in clocks.items()}
        return result and replace(result, clocks=scales)
