"""True over claimed sample period, from positions that must be the integral of velocities."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from leapgap.diagnosis.checks.base import CheckResult, have_joints, joints_of
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

T = TypeVar("T")
CLAIMED = (1.0,)
"""The clock of a log that is too short or too still to have one of its own: that which it claims."""
RESOLVED_S = 0.002
"""Up to this period velocities between rows are taken as straight lines, at longer ones as splines. At longer ones the
threshold of a clock grows with the period: commands that are held for a row move a joint between the instants at which
its velocity is logged."""
SPAN_S = 0.02
"""Increments of position are compared with summed velocities over this time."""


def clock_scale(
    position: np.ndarray, velocity: np.ndarray, period_s: float, lengths: np.ndarray | None = None
) -> float | None:
    """True over claimed period, from positions that must be the integral of velocities; both (rows, channels).

    ``lengths`` of the rows in periods, (rows,), where they are uneven (``row_lengths``).

    Sensors measure velocity in true time, while positions advance by v · (true period) a row: the regression of
    position increments on claimed-time integrals of velocity has that ratio as slope. None where there is none: in less
    than ``SPAN_S``, or where nothing moves.
    """
    span = max(1, round(SPAN_S / period_s))
    moved = position[span:] - position[:-span]
    summed = integrated(velocity, period_s, lengths)
    integral = summed[span:] - summed[:-span]
    square = float((integral**2).sum())
    return float((moved * integral).sum()) / square if square > 0 else None


def integrated(velocity: np.ndarray, period_s: float, lengths: np.ndarray | None) -> np.ndarray:
    """Integral of velocities (rows, channels) from the first row to each; ``lengths`` of the rows in periods."""
    if period_s > RESOLVED_S and len(velocity) > 3:
        from scipy.interpolate import CubicSpline  # half a second, and logs at 1 kHz need none

        rows = np.ones(len(velocity)) if lengths is None else lengths
        time = np.concatenate([[0.0], np.cumsum(rows[:-1])]) * period_s
        return np.asarray(CubicSpline(time, velocity).antiderivative()(time))
    middle = (velocity[1:] + velocity[:-1]) / 2 * (1.0 if lengths is None else lengths[:-1, None])
    return np.concatenate([np.zeros((1, velocity.shape[1])), np.cumsum(middle, axis=0) * period_s])


def of_joints(
    clock: Callable[[Log, np.ndarray, np.ndarray], T], logs: Sequence[Log], robot: Robot | None
) -> dict[str, T] | None:
    """A clock of each log by its name, from the log and its joints' positions and velocities (rows, joints).

    None where a log lacks these columns.
    """
    joints = joints_of(logs, robot)
    if not have_joints(logs, joints):
        return None
    return {log.name: clock(log, *(log.per_joint(of, joints) for of in ("joint_pos", "joint_vel"))) for log in logs}


LOCAL_S = 0.02
"""Half width, standard deviation, of the window of a local clock."""
LOCAL_PRIOR = 0.05
"""Weight of the log's mean clock in a local one, as a share of what a window says on average."""


def local_clock(
    position: np.ndarray, velocity: np.ndarray, period_s: float, every: int, lengths: np.ndarray | None = None
) -> np.ndarray | None:
    """The same ratio as it changes within a log, one value every so many rows, (values,).

    The regression of ``clock_scale`` in a window that slides along; where little moves, the whole log's ratio.
    None, and ``lengths``, as in ``clock_scale``.
    """
    span = max(1, round(SPAN_S / period_s))
    if len(position) <= span:
        return None
    moved = np.diff(position, axis=0)
    if period_s > RESOLVED_S:
        integral = np.diff(integrated(velocity, period_s, lengths), axis=0)
    else:
        integral = (velocity[1:] + velocity[:-1]) / 2 * period_s * (1.0 if lengths is None else lengths[:-1, None])
    box = np.ones(span)
    moved, integral = (np.apply_along_axis(np.convolve, 0, x, box, "same") for x in (moved, integral))
    product, square = (moved * integral).sum(axis=1), (integral**2).sum(axis=1)
    if not square.any():
        return None
    rows = np.arange(len(moved)) + 0.5
    at = np.linspace(0, len(position) - 1, max(2, len(position) // every))
    window = np.exp(-0.5 * ((at[:, None] - rows) * period_s / LOCAL_S) ** 2)
    mean, prior = product.sum() / square.sum(), LOCAL_PRIOR * (window @ square).mean()
    return np.asarray((window @ product + prior * mean) / (window @ square + prior))


LOCAL_EVERY_S = 0.02
"""A local clock has one value for each stretch of this length."""


def local_clocks(logs: Sequence[Log], robot: Robot | None = None) -> dict[str, np.ndarray] | None:
    """The joints' clock as it changes within each log, by the log's name.

    A log that is too short or in which no joint moves is left out; None where a log lacks the columns or none is left.
    """

    def local(log: Log, position: np.ndarray, velocity: np.ndarray) -> np.ndarray | None:
        every = log.info.rows(LOCAL_EVERY_S)
        return local_clock(position, velocity, log.info.sample_period_s, every, log.row_lengths)

    clocks = of_joints(local, logs, robot) or {}
    return {name: clock for name, clock in clocks.items() if clock is not None} or None


def longest_period(logs: Sequence[Log]) -> float:
    """The longest sample period of some logs, s."""
    return max(log.info.sample_period_s for log in logs)


def judge_clocks(
    name: str, what: str, clocks: Mapping[str, float | None], threshold: float, period_s: float = 0.0
) -> CheckResult | None:
    """Judge the clocks of all logs, by the log's name, by their median; ``what`` says whose positions they are of.

    ``period_s`` is the longest sample period of the logs.

    Logs without a clock are left out; None where no log has one.
    """
    scales = {log: clock for log, clock in clocks.items() if clock is not None}
    if not scales:
        return None
    statistic, threshold = float(np.median(list(scales.values()))) - 1, threshold * max(1.0, period_s / RESOLVED_S)
    passed = abs(statistic) <= threshold
    low, high = min(scales.values()), max(scales.values())
    says = (
        f"positions of {what} agree with their velocities at the claimed sample period (median {1 + statistic:.3f})"
        if passed
        else f"{what} move {100 * statistic:+.0f} % against their own velocities at the claimed sample period "
        f"(logs {low:.2f} to {high:.2f}): the loop runs {'slower' if statistic > 0 else 'faster'} than the log claims"
    )
    return CheckResult(name, passed, abs(statistic), threshold, says, scales)
