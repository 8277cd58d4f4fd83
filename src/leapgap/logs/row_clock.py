"""The clock of a log's rows as data, and the log by that clock.

``row_clock_estimate`` finds it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.logs.filtered_velocity import FilterRule, without_filter
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_QUATERNION
from leapgap.logs.streams import POSITION, VELOCITY


@dataclass(frozen=True)
class RowClock:
    """The clock of one log."""

    instants: np.ndarray
    """When each row was written, s since the first, never decreasing, (rows,)."""
    sampled: Mapping[str, np.ndarray]
    """Column → when the sample was taken that each row shows, s, (rows,)."""
    step_s: float | None
    """Step of which all instants are whole multiples; None where there is none."""
    repeats: Mapping[str, float]
    """Message → share of the rows, while it moves, that repeat the sample of the row before."""
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
