"""True over claimed sample period, from positions that must be the integral of velocities."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from leapgap.diagnosis.checks.base import CheckResult, have_joints, joints_of
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of, ticks_of
from leapgap.robot.model import Robot

T = TypeVar("T")
CLAIMED = (1.0,)  # The clock of a log that is too short or too still to have one of its own: that which it claims
RESOLVED_S = 0.002  # Up to this period velocities between rows are taken as straight lines, at longer ones as splines
SURE = 3.0  # A clock is another than the claimed one from so many standard deviations on of what the columns resolve
SPAN_S = 0.02  # Increments of position are compared with summed velocities over this time


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
    return slope(position, integrated(velocity, period_s, lengths), span)


def slope(position: np.ndarray, integral: np.ndarray, span: int) -> float | None:
    """Regression of increments over ``span`` rows of positions on those of their integrals, (rows, channels)."""
    moved, summed = position[span:] - position[:-span], integral[span:] - integral[:-span]
    square = float((summed**2).sum())
    return float((moved * summed).sum()) / square if square > 0 else None


def clock_error(
    position: np.ndarray, velocity: np.ndarray, period_s: float, lengths: np.ndarray | None = None
) -> float:
    """Standard deviation of ``clock_scale`` by what its columns resolve.

    Noise, and ticks of the positions, are independent from row to row. A velocity stays within a tick for long: its
    error does not average out. Between rows nobody knows a velocity: straight lines and splines differ by as much.
    """
    span = max(1, round(SPAN_S / period_s))
    integral = integrated(velocity, period_s, lengths)
    summed = integral[span:] - integral[:-span]
    square = float((summed**2).sum())
    if square == 0:
        return 0.0
    weights = np.zeros_like(position)
    weights[span:] += summed
    weights[:-span] -= summed
    of_positions = float(np.sqrt(((resolved(position, period_s) * weights) ** 2).sum())) / square
    ticks, noise = (of * span * period_s for of in tick_and_noise(velocity, period_s))
    of_ticks = float(np.sqrt(((ticks * np.abs(summed).sum(axis=0)) ** 2).sum()) / np.sqrt(12)) / square
    of_noise = float(np.sqrt((noise**2 * summed**2).sum())) / square
    lines, splines = (slope(position, of, span) for of in (by_lines(velocity, period_s, lengths), integral))
    return float(np.sqrt(of_positions**2 + of_ticks**2 + of_noise**2 + ((lines or 1.0) - (splines or 1.0)) ** 2))


def resolved(position: np.ndarray, period_s: float) -> np.ndarray:
    """Standard deviation of what positions (rows, channels) do not resolve: their ticks, and their noise."""
    tick, noise = tick_and_noise(position, period_s)
    return np.asarray(np.maximum(tick / np.sqrt(12), noise))


def tick_and_noise(values: np.ndarray, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Width of the grid and standard deviation of the noise of columns (rows, channels)."""
    return ticks_of(values), noise_of(np.diff(values, axis=0), period_s)


def integrated(velocity: np.ndarray, period_s: float, lengths: np.ndarray | None) -> np.ndarray:
    """Integral of velocities (rows, channels) from the first row to each; ``lengths`` of the rows in periods."""
    if period_s > RESOLVED_S and len(velocity) > 3:
        from scipy.interpolate import CubicSpline  # half a second, and logs at 1 kHz need none

        rows = np.ones(len(velocity)) if lengths is None else lengths
        time = np.concatenate([[0.0], np.cumsum(rows[:-1])]) * period_s
        return np.asarray(CubicSpline(time, velocity).antiderivative()(time))
    return by_lines(velocity, period_s, lengths)


def by_lines(velocity: np.ndarray, period_s: float, lengths: np.ndarray | None) -> np.ndarray:
    """``integrated``, with velocities on straight lines between rows."""
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


SHRUNK = 3.0
"""Stiffness over inertia of a joint over what the change of its velocity over a row shows of it, at most: 2.6 in a
simulated arm that goes half of the way to its set points within a row."""
LOCAL_S = 0.02  # Half width, standard deviation, of the window of a local clock
LOCAL_REACH = 8.0  # That window ends after so many standard deviations
LOCAL_PRIOR = 0.05  # Weight of the log's mean clock in a local one, as a share of what a window says on average


@dataclass(frozen=True)
class LocalClock:
    """A clock as it changes within a log."""

    values: np.ndarray  # True over claimed period, one value every so many rows
    error: float  # Standard deviation of such a value by what the columns resolve, root mean square


def local_clock(
    position: np.ndarray, velocity: np.ndarray, period_s: float, every: int, lengths: np.ndarray | None = None
) -> LocalClock | None:
    """The same ratio as it changes within a log, one value every so many rows.

    The regression of ``clock_scale`` in a window that slides along; where little moves, the whole log's ratio.
    None, and ``lengths``, as in ``clock_scale``.
    """
    span = max(1, round(SPAN_S / period_s))
    if len(position) <= span:
        return None
    box = np.ones(span)
    moved, integral, lines = (
        np.apply_along_axis(np.convolve, 0, np.diff(of, axis=0), box, "same")
        for of in (position, integrated(velocity, period_s, lengths), by_lines(velocity, period_s, lengths))
    )
    if not integral.any():
        return None
    at = np.linspace(0, len(position) - 1, max(2, len(position) // every))
    reach = int(np.ceil(LOCAL_REACH * LOCAL_S / period_s))
    rows = np.floor(at).astype(int)[:, None] + np.arange(-reach, reach + 1)
    inside = (rows >= 0) & (rows < len(moved))
    window = np.exp(-0.5 * ((at[:, None] - rows - 0.5) * period_s / LOCAL_S) ** 2) * inside
    rows = np.where(inside, rows, 0)

    def within(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return np.asarray((weights * values[rows]).sum(axis=1))

    def ratio(summed: np.ndarray) -> np.ndarray:
        product, square = (moved * summed).sum(axis=1), (summed**2).sum(axis=1)
        prior = LOCAL_PRIOR * (own := within(square, window)).mean()
        return np.asarray((within(product, window) + prior * product.sum() / square.sum()) / (own + prior))

    values, square = ratio(integral), integral**2
    weight = (own := within(square.sum(axis=1), window)) + LOCAL_PRIOR * own.mean()
    of_positions = 2 * within(square @ resolved(position, period_s) ** 2, window**2)
    ticks, noise = (of * span * period_s for of in tick_and_noise(velocity, period_s))
    of_ticks = sum((within(np.abs(own), window) * tick) ** 2 for own, tick in zip(integral.T, ticks, strict=True)) / 12
    of_noise = within(square @ noise**2, window**2)
    between = values - ratio(lines)
    error = np.sqrt(np.mean((of_positions + of_ticks + of_noise) / weight**2) + np.var(between))
    return LocalClock(values, float(error))


LOCAL_EVERY_S = 0.02  # A local clock has one value for each stretch of this length


def local_clocks(logs: Sequence[Log], robot: Robot | None = None) -> dict[str, LocalClock] | None:
    """The joints' clock as it changes within each log, by the log's name.

    A log that is too short or in which no joint moves is left out; None where a log lacks the columns or none is left.
    """

    def local(log: Log, position: np.ndarray, velocity: np.ndarray) -> LocalClock | None:
        every = log.info.rows(LOCAL_EVERY_S)
        return local_clock(position, velocity, log.info.sample_period_s, every, log.row_lengths)

    clocks = of_joints(local, logs, robot) or {}
    return {name: clock for name, clock in clocks.items() if clock is not None} or None


@dataclass(frozen=True)
class Clock:
    """The clock of a whole log."""

    scale: float | None  # True over claimed period; None where nothing tells it
    error: float  # Standard deviation of it by what the columns resolve
    ripple: float = 0.0  # By how much set points that are held for a row may bias it (``ripple_of``)

    @staticmethod
    def of(log: Log, position: np.ndarray, velocity: np.ndarray) -> "Clock":
        """The clock of a log by positions and velocities (rows, channels)."""
        columns = (position, velocity, log.info.sample_period_s, log.row_lengths)
        scale = clock_scale(*columns)
        return Clock(scale, 0.0 if scale is None else clock_error(*columns))


def ripple_of(log: Log, joints: Sequence[str]) -> float:
    """Share by which joints move more than their velocities at the rows say, where a PD pulls them to held set points.

    Set points that step by Δc at every row of length h pull with a sawtooth about its mean, and velocities at the rows
    miss their mean by A h Δc / 12, with A the accelerations of all joints by distances from the set points. A is fitted
    to the changes of measured velocities, beside velocities and positions; within a row those distances shrink by half
    or so, and A is larger.
    """
    pulled = [j for j in joints if f"cmd_pos/{j}" in log and log[f"cmd_kp/{j}"].any() and np.ptp(log[f"cmd_pos/{j}"])]
    if not pulled or len(log) < 2 * (2 * len(joints) + len(pulled)):
        return 0.0
    period = log.info.sample_period_s
    position, velocity = (log.per_joint(of, tuple(joints)) for of in ("joint_pos", "joint_vel"))
    wanted = log.per_joint("cmd_pos", tuple(pulled))
    away = wanted - log.per_joint("joint_pos", tuple(pulled))
    state = np.concatenate([away, velocity, position, np.ones((len(log), 1))], axis=1)[:-1]
    slopes, *_ = np.linalg.lstsq(state, np.diff(velocity, axis=0) / period, rcond=None)
    missed = np.diff(wanted, axis=0) @ slopes[: len(pulled)] * period / 12
    return SHRUNK * abs(float((missed * velocity[1:]).sum())) / max(float((velocity**2).sum()), np.finfo(float).tiny)


def judge_clocks(name: str, what: str, clocks: Mapping[str, Clock], threshold: float) -> CheckResult | None:
    """Judge the clocks of all logs, by the log's name, by their median; ``what`` says whose positions they are of.

    Logs without a clock are left out; None where no log has one.
    """
    scales = {log: clock.scale for log, clock in clocks.items() if clock.scale is not None}
    if not scales:
        return None
    error = float(np.median([SURE * clocks[log].error + clocks[log].ripple for log in scales]))
    statistic, threshold = float(np.median(list(scales.values()))) - 1, max(threshold, error)
    passed = abs(statistic) <= threshold
    low, high = min(scales.values()), max(scales.values())
    says = (
        f"positions of {what} agree with their velocities at the claimed sample period (median {1 + statistic:.3f}"
        f"{resolution_in_words(error, threshold)})"
        if passed
        else f"{what} move {100 * statistic:+.0f} % against their own velocities at the claimed sample period "
        f"(logs {low:.2f} to {high:.2f}): the loop runs {'slower' if statistic > 0 else 'faster'} than the log claims"
    )
    return CheckResult(name, passed, abs(statistic), threshold, says, scales)


def resolution_in_words(error: float, threshold: float) -> str:
    """What a clock cannot tell, where its columns are too coarse for less than an error; empty where they are not."""
    coarse = error >= threshold
    return f"; the columns are too coarse to show less than {100 * threshold:.2g} %" if coarse else ""
