"""Does the loop take equally long throughout a log, by the joints' own clock?"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult
from leapgap.diagnosis.checks.clocks import CLAIMED, SURE, local_clocks, resolution_in_words
from leapgap.logs.log import Log
from leapgap.robot.model import Robot


class EvenClock(Check):
    """How much the true length of a row changes within a log."""

    name = "even_clock"
    threshold = 0.012
    place: ClassVar[int] = 2
    needs_robot = False
    velocities_in_time = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Take the standard deviation of each log's local clock, beyond what the columns resolve."""
        clocks = local_clocks(logs, robot)
        if clocks is None:
            return None
        error = SURE * float(np.median([clock.error for clock in clocks.values()]))
        threshold = max(threshold, error)
        spread = {name: float(clock.values.std()) for name, clock in clocks.items()}
        statistic = float(np.median(list(spread.values())))
        passed = statistic <= threshold
        low, high = (float(f([f(clock.values) for clock in clocks.values()])) for f in (min, max))
        says = f"the true sample period changes by {100 * statistic:.1f} % within a log (standard deviation)" + (
            resolution_in_words(error, threshold) if passed else f", from {low:.2f} to {high:.2f} times the claimed one"
        )
        of_logs = {log.name: tuple(clocks[log.name].values.tolist()) if log.name in clocks else CLAIMED for log in logs}
        return CheckResult(self.name, passed, statistic, threshold, says, spread, of_logs)
