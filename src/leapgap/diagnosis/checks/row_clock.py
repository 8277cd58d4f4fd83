"""Does every row of a log last equally long, and does it show new samples, by the motion of the joints?"""

from collections.abc import Mapping, Sequence

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints, joints_of
from leapgap.logs.log import Log
from leapgap.logs.row_clock import RowClock
from leapgap.logs.row_clock_estimate import UNEVEN, row_clock
from leapgap.robot.model import Robot

STALL_S, STALL_ROWS = 0.008, 5  # A row that lasts so long, and so many mean rows, is a stall


class EvenRows(Check):
    """Rows of one length, each with samples of its own."""

    name = "row_clock"
    threshold = UNEVEN
    place = 0
    needs_robot = False
    velocities_in_time = True
    needs_all_rows = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Take the standard deviation of the lengths of rows, as a share of their mean, or that of the ages of samples.

        The larger of the two counts: rows that show old samples are no better than rows of uneven length.
        """
        joints = joints_of(logs, robot)
        if not have_joints(logs, joints):
            return None
        clocks = {log.name: row_clock(log, joints) for log in logs}
        known = {name: clock for name, clock in clocks.items() if clock is not None}
        if not known:
            return None
        spread = {
            name: max(clock.unevenness(log), staleness(clock)) for log in logs if (clock := known.get(name := log.name))
        }
        statistic = float(np.median(list(spread.values())))
        passed = statistic <= threshold
        says = f"samples are evenly spaced (spacing scatters by {100 * statistic:.0f} %)"
        means = {log.name: (float(known[log.name].instants[-1] / log.time[-1]),) for log in logs if log.name in known}
        return CheckResult(
            self.name,
            passed,
            statistic,
            threshold,
            says if passed else in_words(known, statistic, float(np.median([*map(staleness, known.values())]))),
            spread,
            means,
            None if passed else known,
        )


def staleness(clock: RowClock) -> float:
    """Standard deviation of the ages of the joints' samples in the rows that show them, in mean rows."""
    taken = [instants for name, instants in clock.sampled.items() if name.startswith("joint_pos/")]
    ages = clock.instants - np.stack(taken)
    return float(np.std(ages) * (len(clock.instants) - 1) / clock.instants[-1])


def in_words(clocks: Mapping[str, RowClock], statistic: float, stale: float) -> str:
    """What uneven rows show of the process that wrote them; ``stale`` as in ``staleness``."""
    every = list(clocks.values())
    said = [f"samples of these logs are not evenly spaced: the spacing scatters by {100 * statistic:.0f} %"]
    if stale >= statistic:
        said = [
            f"measurements are late by varying times: their ages scatter by {100 * stale:.0f} % of the sample period"
        ]
    repeated = [clock.repeated for clock in every]
    if np.median(repeated) > 0:
        said.append(f"{100 * float(np.median(repeated)):.0f} % of the samples repeat the one before")
    stalls = [int((clock.lengths >= max(STALL_S, STALL_ROWS * float(clock.lengths.mean()))).sum()) for clock in every]
    if max(stalls):
        said.append(f"{min(stalls)} to {max(stalls)} stalls of {1000 * STALL_S:g} ms or more a log")
    steps = {clock.step_s for clock in every}
    (step,) = steps if len(steps) == 1 else (None,)
    if step is None:
        return ", ".join(said)
    said.append(f"all times are whole multiples of {1000 * step:g} ms")
    kept = [share for clock in every for share in clock.filters.values()]
    if kept:
        part = float(np.median(kept))
        said.append(
            f"joint velocities are {part:.2g} of the one before and {1 - part:.2g} of the last difference of positions"
        )
    received = "; they were written by a process that receives messages" if np.median(repeated) > 0 else "; they are"
    return f"{', '.join(said)}{received} of a simulation or controller with steps of {1000 * step:g} ms"
