"""Do set points that stand for several rows of a log stand in the robot too, or is the log coarser than it?"""

from collections.abc import Sequence
from functools import partial
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints
from leapgap.diagnosis.checks.pieces import Pieces, shares
from leapgap.logs.held_set_points import hold_of, on_lines
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

HOLDS, SHORTEST_S = 6, 0.2  # Pieces last so many holds, and so long at least
FEWEST = 3  # Fewer pieces tell nothing
SURE = 3.0  # Standard errors by which set points stand, or do not


class HeldSetPoints(Check):
    """A controller that goes on in straight lines where the log has steps moves the robot more smoothly.

    The statistic is how much of the steps is missing in the motion: 0 for a robot whose set points stand as they are
    logged, 1 for one that goes on in straight lines; gains that act weaker than logged make some of it, too. Short
    pieces are replayed with both, and what is slower than a hold is left out: that is a matter of causes. Where the
    check fails, the diagnosis goes on with lines.
    """

    name = "held_set_points"
    threshold = 0.8
    place: ClassVar[int] = 8
    velocities_in_time = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Replay pieces with set points as logged, and on straight lines to the next and from the one before."""
        if robot is None or not have_joints(logs, robot.joints):
            return None
        holds = {log.name: hold.rows for log in logs if (hold := hold_of(log)) is not None}
        if 2 * len(holds) <= len(logs):
            return None
        held = [log for log in logs if log.name in holds]
        rows = int(np.median(list(holds.values())))
        period = float(np.median([log.info.sample_period_s for log in held]))
        says = f"set points are held for {rows} samples ({1000 * rows * period:.3g} ms) at a time"
        of_logs = {name: float(own) for name, own in holds.items()}
        length = 1 + max(HOLDS * rows, round(SHORTEST_S / period))
        starts = [list(range(0, len(log) - length, length)) for log in held]
        lines, late = ([on_lines(log, late) for log in held] for late in (False, True))
        of_reads = [Pieces.of(read, robot, starts, length) for read in (held, lines, late)]
        if len(of_reads[0].logs) < FEWEST:
            return None
        rates = not any("joint_vel" in log.derived for log in held)
        (as_held, measured), (ahead, _) = (of.motions(velocities=rates) for of in of_reads[:2])
        errors, steps = (without_mean(of, rows) for of in (measured - ahead, as_held - ahead))
        size, error = size_of_steps(errors, steps, rows)
        missing = 1 - size
        passed = missing <= threshold or missing < SURE * error
        if passed:
            told = size > SURE * error and missing < threshold
            says += (
                ", and so they do in the robot" if told else "; the motion does not show whether they do in the robot"
            )
            return CheckResult(self.name, True, min(max(missing, 0.0), threshold), threshold, says, of_logs)
        (ahead, measured), (behind, _) = (of.motions() for of in of_reads[1:])
        back = bool(shares(measured - ahead, [behind - ahead])[0][0] > 0.5)
        line = "from the one before" if back else "to the next one"
        says += (
            f" while the robot goes on ({100 * missing:.0f} ± {max(1.0, 100 * error):.0f} % of their steps are missing"
            f" in its motion): its controller interpolates, or the log is coarser; read on lines {line}"
        )
        return CheckResult(self.name, False, missing, threshold, says, of_logs, reads=partial(on_lines, late=back))


def size_of_steps(errors: np.ndarray, steps: np.ndarray, rows: int) -> tuple[float, float]:
    """How large the response to steps is in the errors, as a share of what it is in a replay, and its standard error.

    Arrays are (pieces, rows, joints). A robot may be late by any time: the response is looked for as it is and a
    quarter of a hold later.
    """
    if rows < 3:
        (share,), (error,) = shares(errors, [steps])
        return float(abs(share)), float(error)
    later = max(1, round(rows / 4))
    both, errors_of = shares(errors[:, later:], [steps[:, later:], steps[:, :-later]])
    return float(np.hypot(*both)), float(np.hypot(*errors_of) / np.sqrt(2))


def without_mean(values: np.ndarray, rows: int) -> np.ndarray:
    """Values (pieces, rows, joints) less their mean over so many rows about each: what follows steps, and no drift."""
    summed = np.cumsum(np.concatenate([0 * values[:, :1], values], axis=1), axis=1)
    mean = (summed[:, rows:] - summed[:, :-rows]) / rows
    if rows % 2 == 0:  # an even number of rows has its middle between two
        mean = (mean[:, 1:] + mean[:, :-1]) / 2
    return np.asarray(values[:, rows // 2 : rows // 2 + mean.shape[1]] - mean)
