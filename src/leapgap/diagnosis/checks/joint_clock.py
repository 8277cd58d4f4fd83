"""Do the joints' positions follow from their velocities at the claimed sample period?"""

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints, joints_of
from leapgap.diagnosis.checks.clocks import CLAIMED, clock_scale, judge_clocks, longest_period
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
        joints = joints_of(logs, robot)
        if not have_joints(logs, joints):
            return None
        scales = {
            log.name: clock_scale(
                log.per_joint("joint_pos", joints),
                log.per_joint("joint_vel", joints),
                log.info.sample_period_s,
                log.row_lengths,
            )
            for log in logs
        }
        result = judge_clocks(self.name, "the joints", scales, threshold, longest_period(logs))
        clocks = {name: CLAIMED if scale is None else (scale,) for name, scale in scales.items()}
        return result and replace(result, clocks=clocks)
