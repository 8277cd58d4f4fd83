"""The messages that a log was written from, the clock of its rows as data, and the log by that clock.

A message has channels that are sampled at the same instants. ``row_clock_estimate`` finds the clock.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.noise import resolution_of
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY

BASE = "base"
POSITION, VELOCITY = "joint_pos/", "joint_vel/"  # columns of a joint begin so
NOISE_WINDOW = 20  # rows over which noise is taken; the quietest windows count, since uneven rows scatter moving joints
QUIETEST = 0.02  # share of the windows that is quieter than the noise
MOVES = 3.0  # a channel moves where its velocity carries it by so many deviations of its noise in a row
COUNTS = 2.0  # it also moves by more than so many counts of its encoder: between counts an encoder repeats itself

CURVATURE = 0.1  # error of a mean of two velocities, as a share of their difference
OUTLIER = 2.0  # an equation of motion that misses by more standard deviations counts less and less


@dataclass(frozen=True)
class Stream:
    """Channels that one message brings: their positions and velocities are sampled at the same instants."""

    name: str
    columns: tuple[str, ...]  # all columns of the message
    position: np.ndarray  # (rows, channels), rad or m
    velocity: np.ndarray  # (rows, channels), per s

    @cached_property
    def fresh(self) -> np.ndarray:
        """Whether each row shows a sample that the row before did not, bool, (rows,)."""
        both = np.concatenate([self.position, self.velocity], axis=1)
        return np.concatenate([[True], (np.diff(both, axis=0) != 0).any(axis=1)])

    @cached_property
    def noise(self) -> np.ndarray:
        """Standard deviation of the positions' noise or rounding, (channels,)."""
        return quiet_noise(self.position[self.fresh])

    def moves(self, period_s: float) -> np.ndarray:
        """Whether its velocity moves a channel visibly within a row, for all rows but the last, bool, (rows − 1,)."""
        least = np.maximum(MOVES * self.noise, COUNTS * self.resolution)
        return np.asarray((np.abs(self.velocity[:-1]) * period_s > least).any(axis=1))

    @cached_property
    def resolution(self) -> np.ndarray:
        """Distance between neighbouring values of each position, (channels,): an encoder's count, or the last digit."""
        return resolution_of(self.position)

    def channels(self, chosen: Sequence[int]) -> "Stream":
        """The message with some of its channels."""
        return replace(self, position=self.position[:, chosen], velocity=self.velocity[:, chosen])

    def repeats(self, period_s: float) -> float:
        """Share of the rows that repeat the sample of the row before, of those in which a channel moves."""
        moves = self.moves(period_s)
        return float((~self.fresh[1:])[moves].mean()) if moves.any() else 0.0


def quiet_noise(values: np.ndarray) -> np.ndarray:
    """Noise of values (samples, channels) in the windows in which it is least, standard deviation, (channels,)."""
    second = np.diff(values, n=2, axis=0) / np.sqrt(6)
    if len(second) < 2:
        return np.full(values.shape[1], 1e-9)
    windows = np.array_split(second, max(1, len(second) // NOISE_WINDOW))
    spread = np.array([np.sqrt((window**2).mean(axis=0)) for window in windows])
    return np.maximum(np.quantile(spread, QUIETEST, axis=0), 1e-9)


def streams_of(log: Log, joints: Sequence[str]) -> list[Stream]:
    """The messages that a log was written from: joints that repeat together come together, and the base."""
    together: dict[bytes, list[Stream]] = {}
    for joint in joints:
        columns = (f"joint_pos/{joint}", f"joint_vel/{joint}")
        if all(name in log for name in columns):
            stream = Stream(joint, columns, *(log[name][:, None] for name in columns))
            together.setdefault(stream.fresh.tobytes(), []).append(stream)
    merged = [merge(streams) for streams in together.values()]
    if all(name in log for name in (*BASE_POSITION, *BASE_VELOCITY)):
        own = tuple(name for name in log.columns if name.startswith("base_"))
        merged.append(Stream(BASE, own, log.stack(BASE_POSITION), log.stack(BASE_VELOCITY)))
    return merged


def merge(streams: Sequence[Stream]) -> Stream:
    """One message with the channels of several."""
    return Stream(
        streams[0].name,
        tuple(name for stream in streams for name in stream.columns),
        np.concatenate([stream.position for stream in streams], axis=1),
        np.concatenate([stream.velocity for stream in streams], axis=1),
    )


def mean_row(log: Log, streams: Sequence[Stream]) -> float:
    """Mean length of a row by the motion of all joints, s."""
    moved = span = 0.0
    for stream in (stream for stream in streams if stream.name != BASE):
        rows = np.flatnonzero(stream.fresh)
        mean = (stream.velocity[rows][1:] + stream.velocity[rows][:-1]) / 2
        moved += float((np.diff(stream.position[rows], axis=0) * mean).sum())
        span += float((mean**2 * np.diff(rows)[:, None]).sum())
    return moved / span if moved > 0 else log.info.sample_period_s


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
    filters: Mapping[str, float] = field(default_factory=dict)
    """Velocity column of a joint → share of the velocity before that a filter keeps, where one is known."""

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
                of_samples = without_filter(position, of_samples, taken[new], clock.step_s, clock.filters[name])
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
