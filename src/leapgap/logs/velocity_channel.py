"""What a log's velocity columns are against its positions: late, filtered or coarse, from the columns alone.

Registers of servos, drives that smooth what they differentiate, and encoders of few counts report a velocity that is
not the one of the row. The displacement over a while is the integral of the velocity, of a late one by so much later:
Δp(t) = s ∫ v(t + d) dt. The lag d and the clock s are found together, so that a late velocity is no wrong clock. All
joints have one clock: where s of one joint departs from the others', its positions and velocities have two units.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of, ticks_of

LONGEST_S = 0.25  # lags are looked for up to this
SHORTEST_SPAN_S, LONGEST_SPAN_S = 0.05, 0.4  # displacements are taken over this time; over more where a joint is slow
SEEN = 20.0  # a span is long enough in which joints move by so many standard deviations of what their encoders resolve
LEAST_ROWS, OF_DIFFERENCE, OF_REGISTER = 0.25, 0.48, 0.75
"""Shortest lag beyond the usual, and shortest lags of differences of two rows and of registers, in rows."""
PARTS = 8  # parts of a log that are left out in turn, for the standard error of a lag
SURE = 3.0  # standard errors by which a lag is one
EXPLAINS = 2.0  # a lag leaves at most 1/so much of the variance that velocities without it leave
FITS = 0.8  # least share of the variance of displacements that velocities with their lag explain
LEAST_REST = 0.02  # share of its size by which a velocity must be off without lag or ticks to be told
LATE, FILTERED, UNCLEAR, OF_TWO_ROWS = "late", "filtered", "late or filtered", "differences of two rows, late"
OTHER_UNIT, FEWEST_JOINTS = 1.25, 3
"""Of so many joints or more one has two units, where its s is so many times that of the others, or they of it."""
CLEARER = 1.5  # one description of a lag is told, and not the other, where it leaves so much less unexplained


@dataclass(frozen=True)
class VelocityLag:
    """Lag of a velocity behind its positions."""

    late_s: float  # lag that suits it best, s; 0 where none is sure
    error_s: float  # standard error of the lag, s
    kind: str  # ``LATE``, ``FILTERED``, ``UNCLEAR`` where nothing tells them apart, or ``OF_TWO_ROWS``
    scale: float  # displacement of the positions over the integral of the velocity with its lag
    fits: bool  # whether that integral explains the displacements


@dataclass(frozen=True)
class VelocityColumn(VelocityLag):
    """What one velocity column is against its positions.

    Its ``scale`` is over that of all joints, 1 where none is sure to be another. Errors are standard deviations.
    """

    tick: float  # width of the grid on which its values lie, rad/s or m/s; 0 where there is none
    position_tick: float  # the same of the positions, rad or m
    rest: float
    """What else it is off by from a velocity fitted through the positions, where far beyond noise and the fit's error.

    Standard deviation, rad/s or m/s; 0 where it is not.
    """
    error: float  # error of the reported velocity by lag, ticks, unit and rest, standard deviation, rad/s or m/s
    noise: float  # standard deviation of its noise; 0 where rounding to its ticks explains it
    error_if_derived: float  # of a velocity fitted through the positions, by what they resolve and how they bend

    @property
    def of_two_rows(self) -> bool:
        """Whether it is late by half a row and right else."""
        return self.kind == OF_TWO_ROWS and self.rest == 0 and self.scale == 1


def velocity_columns(
    log: Log, joints: Sequence[str], window_s: float, usual_lag_s: float = 0.0
) -> dict[str, VelocityColumn]:
    """What each joint's velocity column is, by joint; those that lack one, or move too little to tell, are left out.

    ``window_s`` is that in which velocities are fitted through positions. A lag of ``usual_lag_s`` is none: velocities
    of simulations are late by half their step.
    """
    named = [joint for joint in joints if f"joint_pos/{joint}" in log and f"joint_vel/{joint}" in log]
    if not named or len(log) < 4 * PARTS:
        return {}
    period = log.info.sample_period_s
    position, velocity = (log.stack([f"{of}/{joint}" for joint in named]) for of in ("joint_pos", "joint_vel"))
    ticks = [ticks_of(table) for table in (velocity, position)]
    even = np.arange(len(log)) * (log.time[-1] - log.time[0]) / (len(log) - 1) + log.time[0]
    if not log.is_even:
        position, velocity = (
            np.stack([np.interp(even, log.time, values) for values in table.T], axis=1)
            for table in (position, velocity)
        )
    resolved = np.maximum(ticks[1] / np.sqrt(12), noise_of(np.diff(position, axis=0), period))
    # Rows over which displacements (rows, channels) are taken, so that they are well above what is resolved
    span = max(1, round(SHORTEST_SPAN_S / period))
    longest = max(span, min(round(LONGEST_SPAN_S / period), len(position) // PARTS))
    while span < longest:
        size = np.sqrt(np.mean((position[span:] - position[:-span]) ** 2, axis=0))
        if np.median(size / np.maximum(resolved, np.finfo(float).tiny)) > SEEN:
            break
        span = min(2 * span, longest)
    span = max(1, min(span, len(position) // 4))
    fit, finer = (velocity_fit(even, position, window) for window in (window_s, window_s / 2))
    bent = np.sqrt(np.mean((fit.velocity - finer.velocity) ** 2, axis=0))
    derived = np.maximum(float(np.median(fit.noise_gain)) * resolved, bent)
    noise = noise_of(np.diff(velocity, axis=0), period)
    noise[ticks[0] > noise] = 0.0  # rounding, which the ticks stand for
    moved = position[span:] - position[:-span]
    tells = (np.sqrt(np.mean(moved**2, axis=0)) > SEEN / 4 * resolved) & (np.ptp(velocity, axis=0) > 0)
    lags = lags_of(moved[:, tells], velocity[:, tells], span, period, usual_lag_s)
    at = np.flatnonzero(tells).tolist()
    sizes = np.sqrt(np.mean(velocity**2, axis=0))
    scales = [lag.scale for lag in lags if lag.fits]
    usual = float(np.median(scales)) if len(scales) >= FEWEST_JOINTS else np.nan
    found: dict[str, VelocityColumn] = {}
    for k, lag in zip(at, lags, strict=True):
        tick, scale = float(ticks[0][k]), lag.scale / usual
        sure = SURE * tick / np.sqrt(12) / sizes[k] < abs(scale - 1)
        scale = scale if lag.fits and sure and not 1 / OTHER_UNIT < scale < OTHER_UNIT else 1.0
        in_place = np.interp(even + lag.late_s, even, velocity[:, k]) * scale
        off = in_place - velocity[:, k]
        edge = round((window_s + lag.late_s) / period) + 1
        own, fitted = in_place[edge:-edge], fit.velocity[edge:-edge, k]
        by = np.stack([own, np.gradient(own)], axis=1) if len(own) > 1 else np.ones((len(own), 1))
        alike = by @ np.linalg.lstsq(by, fitted, rcond=None)[0]  # whatever the clock and half a row of lag
        rest = float(np.sqrt(np.mean((alike - fitted) ** 2))) if len(own) else 0.0
        known = np.hypot(np.hypot(noise[k], derived[k]), tick / np.sqrt(12))
        rest = rest if rest > max(SURE * known, LEAST_REST * sizes[k]) else 0.0
        found[named[k]] = VelocityColumn(
            lag.late_s,
            lag.error_s,
            lag.kind,
            scale if np.isfinite(scale) else 1.0,
            lag.fits,
            tick,
            float(ticks[1][k]),
            rest,
            float(np.sqrt(np.mean(off**2) + tick**2 / 12 + rest**2)),
            float(noise[k]),
            float(derived[k]),
        )
    return found


def lags_of(
    moved: np.ndarray, velocity: np.ndarray, span: int, period_s: float, usual_lag_s: float = 0.0
) -> list[VelocityLag]:
    """Lag of each velocity (rows, channels) behind displacements over ``span`` rows, (rows − span, channels).

    One of less than ``OF_REGISTER`` rows is that beyond the usual.
    """
    integral = np.concatenate([0 * velocity[:1], np.cumsum((velocity[1:] + velocity[:-1]) / 2, axis=0)]) * period_s
    summed = integral[span:] - integral[:-span]
    reach = max(1, min(int(LONGEST_S / period_s), len(moved) // 4))
    used = len(moved) - 2 * reach
    if used < PARTS:
        return [VelocityLag(0.0, np.inf, LATE, 1.0, False)] * moved.shape[1]
    part = np.arange(PARTS) * used // PARTS
    y, of_lags = moved[reach : reach + used], []
    for lag in range(2 * reach + 1):
        x = summed[lag : lag + used]
        of_lags.append([np.add.reduceat(y * x, part), np.add.reduceat(x * x, part)])
    sums: np.ndarray = np.array(of_lags)  # (lags, 2, parts, channels)
    square = np.add.reduceat(y * y, part)
    found: list[VelocityLag] = []
    for k in range(moved.shape[1]):
        own, size = sums[:, :, :, k], square[:, k]
        best, left, left_at_zero = best_lag(own.sum(axis=2), size.sum())
        parts = [best_lag(own.sum(axis=2) - own[:, :, one], size.sum() - size[one])[0] for one in range(PARTS)]
        error = float(np.std(parts)) * np.sqrt(PARTS - 1) * period_s
        products, squares = own[reach].sum(axis=1)
        scale = float(products / max(squares, np.finfo(float).tiny))  # 0 for a velocity that stands
        none = VelocityLag(0.0, error, LATE, scale, left < 1 - FITS)
        beyond = best - usual_lag_s / period_s
        long = best >= OF_DIFFERENCE and beyond >= LEAST_ROWS
        sure = left_at_zero > EXPLAINS * left and long and beyond * period_s > SURE * error
        if not none.fits or not sure:
            found.append(none)
            continue
        products, squares = own[reach + round(best)].sum(axis=1)
        if best < OF_REGISTER:
            found.append(VelocityLag(beyond * period_s, error, OF_TWO_ROWS, scale, True))
            continue
        change = (velocity[span:, k] - velocity[:-span, k])[reach : reach + used]
        x = np.stack([summed[reach : reach + used, k], change], axis=1)
        fit, *_ = np.linalg.lstsq(x, y[:, k], rcond=None)
        by_filter = float(np.sum((y[:, k] - x @ fit) ** 2) / size.sum())
        if CLEARER * by_filter < left:
            found.append(VelocityLag(float(fit[1] / fit[0]), error, FILTERED, float(fit[0]), True))
        else:
            kind = LATE if CLEARER * left < by_filter else UNCLEAR
            found.append(VelocityLag(best * period_s, error, kind, float(products / squares), True))
    return found


def best_lag(sums: np.ndarray, square: float) -> tuple[float, float, float]:
    """Best lag in rows, and what share of the variance of displacements it and none leave unexplained.

    ``sums`` (lags, 2): of products with the displacements and of squares; ``square`` of the displacements.
    """
    tiny = np.finfo(float).tiny
    left = 1 - np.maximum(sums[:, 0], 0.0) ** 2 / np.maximum(sums[:, 1] * square, tiny)
    at, middle = int(np.argmin(left)), len(left) // 2
    best = float(at - middle)
    if 0 < at < len(left) - 1:
        before, here, after = left[at - 1 : at + 2]
        bend = before - 2 * here + after
        if bend > 0:  # the error of a lag grows with its square
            best += float((before - after) / (2 * bend))
            return best, max(float(here - (before - after) ** 2 / (8 * bend)), 0.0), float(left[middle])
    return best, float(left[at]), float(left[middle])


def in_time(log: Log, columns: Mapping[str, VelocityColumn]) -> Log:
    """The log with velocities moved to where they belong, in their ticks and in the unit of the positions.

    Last rows, whose velocities are not in the log, are cut.
    """
    wrong = {f"joint_vel/{joint}": of for joint, of in columns.items() if of.late_s > 0 or of.scale != 1}
    if not wrong:
        return log
    moved = {name: as_moved(log, log[name], of) for name, of in wrong.items()}
    lag = max(of.late_s for of in wrong.values())
    last = int(np.searchsorted(log.time, log.time[-1] - lag, "right"))
    return replace(log, columns={**log.columns, **moved}).first_rows(max(2, last))


def as_moved(log: Log, velocity: np.ndarray, of: VelocityColumn) -> np.ndarray:
    """A velocity column (rows,) as it is without lag, or before its filter, and in the unit of the positions."""
    if of.kind == FILTERED and of.late_s > 0:
        from scipy.interpolate import CubicSpline  # half a second, for filters alone

        return np.asarray(of.scale * (velocity + of.late_s * CubicSpline(log.time, velocity)(log.time, 1)))
    moved = np.interp(log.time + of.late_s, log.time, velocity)
    in_ticks = of.tick > 0 and of.kind != OF_TWO_ROWS  # a mean of two values is between their ticks
    return of.scale * (of.tick * np.round(moved / of.tick) if in_ticks else moved)


def without(log: Log, joints: Sequence[str]) -> Log:
    """The log without the velocity columns of some joints."""
    dropped = {f"joint_vel/{joint}" for joint in joints}
    return replace(log, columns={name: values for name, values in log.columns.items() if name not in dropped})
