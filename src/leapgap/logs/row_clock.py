"""The clock of a log's rows as data, and the log by that clock.

``row_clock_estimate`` finds it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_QUATERNION
from leapgap.logs.streams import POSITION, VELOCITY

LEAST_OBEYED = 0.8  # share of the pairs of samples from which a rule counts as that which made them
DIGITS = 0.02  # a pair obeys where it asks for a share kept that differs by less
LEAST_PAIRS = 20  # fewer pairs of samples tell no rule


@dataclass(frozen=True)
class FilterRule:
    """A velocity that is ``kept`` times the one before and the rest the last difference of positions over a step."""

    kept: float
    share: float  # of the pairs of samples one step apart, those that obey this to their last digits


def filter_of(position: np.ndarray, velocity: np.ndarray, instants: np.ndarray, step: float) -> FilterRule | None:
    """The rule by which velocities (samples, channels) were computed from positions; None where there are few pairs.

    ``instants`` (samples,), s. Pairs of samples one step apart are looked at, the half of them in which the velocity
    changes most.
    """
    next_step = np.round(np.diff(instants) / step) == 1
    moved = np.diff(position, axis=0)[next_step] / step
    before, after = velocity[:-1][next_step], velocity[1:][next_step]
    change = np.abs(moved - before)
    tells = change > np.median(change, axis=0) if len(change) else change > 0
    if tells.sum() < LEAST_PAIRS:
        return None
    kept = (moved - after)[tells] / (moved - before)[tells]
    usual = float(np.median(kept))
    return FilterRule(usual, float((np.abs(kept - usual) < DIGITS).mean()))


def obeyed_filters(filters: Mapping[str, FilterRule | None]) -> dict[str, FilterRule]:
    """The rules, by message, that surely made their velocities; none where no message obeys its own.

    A message with more noise counts where its pairs ask, in the median, for what the others obey.
    """
    told = {name: one for name, one in filters.items() if one is not None and -DIGITS < one.kept < 1 - DIGITS}
    sure = [one.kept for one in told.values() if one.share > LEAST_OBEYED]
    return {
        name: replace(one, kept=max(one.kept, 0.0))
        for name, one in told.items()
        if any(abs(one.kept - kept) < DIGITS for kept in sure)
    }


def without_filter(
    position: np.ndarray, velocity: np.ndarray, instants: np.ndarray, step: float, kept: float
) -> np.ndarray:
    """Velocities (samples,) before a filter, as the last difference of positions over a step of each sample.

    ``position`` and ``velocity`` (samples,), ``instants`` (samples,) s. Over the steps since the sample before, the
    velocity is taken to change evenly; how far the position moved and what the filter shows then tell it at the sample.
    For one step and for two this is exact. Where the two disagree, instants are wrong: the filter's own lag is undone.
    """
    if kept <= 0 or len(velocity) < 2:
        return velocity.copy()
    steps = np.maximum(np.round(np.diff(instants) / step), 1.0)
    before, after = velocity[:-1], velocity[1:]
    lag = kept / (1 - kept)
    # Velocity v − c (n − j) at step j of n: its sum is the distance, its filtered sum what the log shows.
    powers = kept ** np.arange(int(steps.max()) + 1)
    weighted = np.cumsum(np.arange(len(powers)) * powers) * (1 - kept)
    shown, shown_by_slope = 1 - kept**steps, weighted[steps.astype(int) - 1]
    moved_by_slope = steps * (steps - 1) / 2
    distance, seen = np.diff(position) / step, after - kept**steps * before
    determinant = moved_by_slope * shown - steps * shown_by_slope
    one = steps == 1
    by_both = (moved_by_slope * seen - shown_by_slope * distance) / np.where(one, 1.0, determinant)
    by_lag = after + lag * (after - before) / steps
    doubtful = one | (np.abs(by_both - by_lag) > np.abs(after - before) + np.abs(by_lag - after))
    return np.concatenate([velocity[:1], np.where(doubtful, by_lag, by_both)])


@dataclass(frozen=True)
class RowClock:
    """The clock of one log."""

    instants: np.ndarray  # when each row was written, s since the first, never decreasing, (rows,)
    sampled: Mapping[str, np.ndarray]  # column → when the sample was taken that each row shows, s, (rows,)
    step_s: float | None  # step of which all instants are whole multiples; None where there is none
    repeats: Mapping[str, float]  # message → share of the rows, while it moves, that repeat the sample before
    filters: Mapping[str, FilterRule] = field(default_factory=dict)
    """Velocity column of a joint → how it follows from the positions, where it does to the last digit."""

    @property
    def lengths(self) -> np.ndarray:
        """How long each row but the last lasted, s, (rows − 1,)."""
        return np.diff(self.instants)

    def unevenness(self, log: Log) -> float:
        """Standard deviation of the lengths of rows beyond what the log's own time says, as a share of their mean."""
        mean = self.instants[-1] / (len(log) - 1)
        stated = np.diff(log.time) * (self.instants[-1] / log.time[-1])
        return float(np.std(self.lengths - stated) / mean)

    @property
    def repeated(self) -> float:
        """Median share of repeated samples over the messages."""
        return float(np.median(list(self.repeats.values()))) if self.repeats else 0.0


def with_clock(log: Log, clock: RowClock) -> tuple[Log, np.ndarray]:
    """The log by its own clock, and which rows are kept, bool, (rows,).

    Rows that were written at one instant become one with the last of their commands. Measured columns are those at the
    instants of the rows, on straight lines between the samples. Velocities that a known filter made late are as before
    that filter.
    """
    keep = np.append(clock.lengths > 0, True)
    instants = clock.instants[keep]
    columns: dict[str, np.ndarray] = {"time": instants}
    for name, values in log.columns.items():
        if name in clock.sampled:
            taken = clock.sampled[name]
            new = np.concatenate([[True], np.diff(np.maximum.accumulate(taken)) > 0])
            of_samples = values[new]
            if clock.step_s is not None and name in clock.filters:
                position = log[name.replace(VELOCITY, POSITION)][new]
                of_samples = without_filter(position, of_samples, taken[new], clock.step_s, clock.filters[name].kept)
            columns[name] = np.interp(instants, taken[new], of_samples)
        elif name != "time":
            columns[name] = values[keep]
    if all(name in columns for name in BASE_QUATERNION):
        length = np.linalg.norm(np.stack([columns[name] for name in BASE_QUATERNION]), axis=0)
        columns |= {name: columns[name] / length for name in BASE_QUATERNION}
    period = float(instants[-1] / (len(instants) - 1))
    segments = tuple(
        replace(one, begin_s=own_time(log, clock, one.begin_s), end_s=own_time(log, clock, one.end_s))
        for one in log.info.segments
    )
    info = replace(log.info, sample_period_s=period, stated_segments=segments)
    return replace(log, columns=columns, info=info), keep


def own_time(log: Log, clock: RowClock, time_s: float) -> float:
    """The instant, by a log's own clock, of a time that the log claims, s."""
    return float(np.interp(time_s, log.time, clock.instants)) if time_s <= log.time[-1] else time_s
