"""Does the loop take equally long throughout a log, by the joints' own clock?"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.diagnosis.checks.clocks import CLAIMED, RESOLVED_S, local_clocks, longest_period
from leapgap.logs.log import Log
from leapgap.robot.model import Robot


class EvenClock(Check):
    """How much the true length of a row changes within a log."""

    name = "even_clock"
    threshold = 0.012
    place: ClassVar[int] = 2
    needs_robot = False

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Take the standard deviation of each log's local clock; longer periods resolve it less (``RESOLVED_S``)."""
        clocks = local_clocks(logs, robot)
        if clocks is None:
            return None
        threshold *= max(1.0, longest_period(logs) / RESOLVED_S)
        spread = {name: float(clock.std()) for name, clock in clocks.items()}
        statistic = float(np.median(list(spread.values())))
        passed = statistic <= threshold
        low, high = (float(f([f(clock) for clock in clocks.values()])) for f in (min, max))
        says = f"the true period of a row changes by {100 * statistic:.1f} % within a log (standard deviation)" + (
            "" if passed else f", from {low:.2f} to {high:.2f} times the claimed one"
        )
        of_logs = {log.name: tuple(clocks[log.name].tolist()) if log.name in clocks else CLAIMED for log in logs}
        return CheckResult(self.name, passed, statistic, threshold, says, spread, of_logs)
