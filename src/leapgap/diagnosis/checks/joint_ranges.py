"""Do the joints stay within the ranges that the model states?"""

from collections.abc import Sequence

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.logs.log import Log
from leapgap.logs.reach import BEYOND, reaches
from leapgap.robot.model import Robot


class JointRanges(Check):
    """A stop lets no joint far through: a robot that goes beyond has none there, or its zero is another."""

    name = "joint_ranges"
    threshold = BEYOND
    place = 6

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Take how far any joint goes beyond its range, as a share of the range; nothing where no joint has one."""
        if robot is None:
            return None
        found = {log.name: reaches([log], robot) for log in logs}
        if not any(found.values()):
            return None
        per_log = {name: max((reach.beyond for reach in of), default=0.0) for name, of in found.items()}
        beyond = [reach for reach in reaches(logs, robot) if reach.beyond > threshold]
        says = "; ".join(reach.says for reach in beyond) or "all joints stay within the ranges of the model"
        return CheckResult(self.name, not beyond, max(per_log.values()), threshold, says, per_log)
