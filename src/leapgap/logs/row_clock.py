"""When each row of a log was written, and each of its samples taken, by the motion of the joints.

A joint's position changes by its velocity times the time that passed. Twelve joints agree on that time row by row, so
a log whose rows last unequally long, or which repeats messages that it received, tells its own true clock. No model of
the robot is needed. The base's state is placed by its own motion; it does not decide the clock of the rows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from leapgap.logs.filtered_velocity import VelocityFilter, filter_of, obeyed_filters, without_filter
from leapgap.logs.log import Log
from leapgap.logs.row_smoother import Samples, SmoothedLengths, smooth_lengths
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY

BASE = "base"
POSITION, VELOCITY = "joint_pos/", "joint_vel/"
"""Columns of a joint begin so."""
NOISE_WINDOW = 20
"""Rows over which noise is taken; the quietest windows count, since uneven rows scatter moving joints."""
QUIETEST = 0.02
"""Share of the windows that is quieter than the noise."""
CURVATURE = 0.1
"""Error of a mean of two velocities, as a share of their difference."""
FREE = 25.0
"""Standard deviation of a row's length that is assumed beforehand, in sample periods: next to no assumption."""
LAG, LAG_SPREAD = 0.3, 0.4
"""How late a sample is in the row that first shows it: mean and standard deviation, in sample periods."""
OUTLIER = 2.0
"""An equation that misses by more standard deviations counts less and less."""
ROUNDS = 3
"""Solutions, each with the weights and the delay of velocities that the one before gives."""
ORIGIN = 1e5
"""Weight, 1/s, with which the first row is put at instant 0."""
PRECISE = 0.15
"""Instants known to this share of a step of a whole-number clock are precise."""
MOVES = 3.0
"""A channel moves where its velocity carries it by more than this many standard deviations of its noise in a row."""
AGREE, FARTHEST = 0.5, 3.0
"""Correlation of what two halves of the channels say of the lengths of rows, from which these are uneven; departures
count up to so many mean rows. Impacts and noise correlate by less than 0.2, uneven rows by more than 0.9."""
SHARPEST, LEAST_SCATTER = 0.2, 0.12
"""Share of the rows in which the halves also have to agree on a scatter of so many mean rows; even rows reach 0.05."""
MOVING = 0.1
"""Share of the rows in which a channel has to move to have a say in a clock."""
COUNTS = 2.0
"""It also moves by more than so many counts of its encoder: between counts an encoder repeats itself."""
QUIET = 0.625
"""The noise of the quietest windows over that of all; the smoother takes the latter."""
STALL, STALLS, SURE = 2.5, 2, 4.0
"""A row that lasts longer than others by so many mean rows by both halves of the channels, each so many standard
deviations sure, is a stall; from so many on a log is uneven."""
MOST_FIT = 0.8
"""Share of the motions between samples that even rows have to explain within ``OUTLIER`` standard deviations."""
EVEN = 0.06
"""Rows whose lengths scatter by a smaller share of their mean are even: noise alone lets them scatter by 0.03."""
REPEATS = 0.02
"""Share of repeated samples, while a joint moves, from which a log is one of messages."""
UNEVEN = 0.15
"""Rows are uneven whose lengths scatter by more than this share of their mean."""


@dataclass(frozen=True)
class Stream:
    """Channels that one message brings: their positions and velocities are sampled at the same instants."""

    name: str
    columns: tuple[str, ...]
    """All columns of the message."""
    position: np.ndarray
    """(rows, channels), rad or m."""
    velocity: np.ndarray
    """(rows, channels), per s."""

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
        of_channels = [np.diff(np.unique(values)) for values in self.position.T]
        return np.array([np.quantile(steps, QUIETEST) if len(steps) else np.inf for steps in of_channels])

    def share_in_motion(self, period_s: float) -> float:
        """Share of the rows in which its velocity moves a channel visibly."""
        return float(self.moves(period_s).mean())

    def channel(self, chosen: int | Sequence[int]) -> "Stream":
        """The message with some of its channels."""
        at = [chosen] if isinstance(chosen, int) else list(chosen)
        return replace(self, position=self.position[:, at], velocity=self.velocity[:, at])

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
    found = [
        joint_stream(log, joint) for joint in joints if f"joint_pos/{joint}" in log and f"joint_vel/{joint}" in log
    ]
    together: dict[bytes, list[Stream]] = {}
    for stream in found:
        together.setdefault(stream.fresh.tobytes(), []).append(stream)
    merged = [merge(streams) for streams in together.values()]
    if all(name in log for name in (*BASE_POSITION, *BASE_VELOCITY)):
        own = tuple(name for name in log.columns if name.startswith("base_"))
        merged.append(Stream(BASE, own, log.stack(BASE_POSITION), log.stack(BASE_VELOCITY)))
    return merged


def joint_stream(log: Log, joint: str) -> Stream:
    """The message of one joint."""
    columns = (f"joint_pos/{joint}", f"joint_vel/{joint}")
    position, velocity = (log[name][:, None] for name in columns)
    return Stream(joint, columns, position, velocity)


def merge(streams: Sequence[Stream]) -> Stream:
    """One message with the channels of several."""
    return Stream(
        streams[0].name,
        tuple(name for stream in streams for name in stream.columns),
        np.concatenate([stream.position for stream in streams], axis=1),
        np.concatenate([stream.velocity for stream in streams], axis=1),
    )


@dataclass(frozen=True)
class RowClock:
    """The clock of one log."""

    instants: np.ndarray
    """When each row was written, s since the first, never decreasing, (rows,)."""
    sampled: Mapping[str, np.ndarray]
    """Column → when the sample was taken that each row shows, s, (rows,)."""
    spread_s: np.ndarray
    """Standard deviation of the length of each row but the last, s, (rows − 1,)."""
    step_s: float | None
    """Step of which all instants are whole multiples; None where there is none."""
    repeats: Mapping[str, float]
    """Message → share of the rows, while it moves, that repeat the sample of the row before."""
    velocity_delay_s: Mapping[str, float]
    """Message → how long before its position the motion was as fast as its velocity says, s; none for whole rows."""
    filters: Mapping[str, VelocityFilter] = field(default_factory=dict)
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


def row_clock(log: Log, joints: Sequence[str]) -> RowClock | None:
    """The clock of a log by its joints; None where too few of them move, or have position and velocity."""
    streams = streams_of(log, joints)
    of_joints = [stream for stream in streams if stream.name != BASE]
    if not of_joints or len(log) < 2 * NOISE_WINDOW:
        return None
    if max(stream.repeats(log.info.sample_period_s) for stream in of_joints) < REPEATS:
        return clock_of_whole_rows(log, of_joints)
    telling = [stream for stream in streams if stream.fresh.mean() > MOVING]  # the others' samples only look old
    of_joints = [stream for stream in telling if stream.name != BASE]
    if not of_joints:
        return None
    clock = clock_of_messages(log, telling)
    if clock.step_s is not None and not even_rows_fit(log, of_joints):
        return clock
    every, fresh = merge(of_joints), np.stack([one.fresh for one in of_joints for _ in range(one.position.shape[1])], 1)
    return noisy_clock(log, telling, every, fresh) or clock


def uneven_clocks(logs: Sequence[Log], joints: Sequence[str]) -> dict[str, RowClock]:
    """Clocks, by the log's name, of the logs whose rows are uneven in a way that their time does not say."""
    clocks = {log.name: row_clock(log, joints) for log in logs}
    return {
        log.name: clock for log in logs if (clock := clocks[log.name]) is not None and clock.unevenness(log) > UNEVEN
    }


def clock_of_whole_rows(log: Log, streams: Sequence[Stream]) -> RowClock | None:
    """The clock of a log whose rows are sampled at once: rows of one length, unless the joints agree that they are not.

    Two halves of the channels tell the lengths apart; what both say is no chance, and a smoother over all of them then
    finds the lengths. None where fewer than two channels move.
    """
    every = merge(streams)
    moving = moving_channels(log, every)
    if len(moving) < 2:
        return None
    claimed = np.diff(log.time)
    expected = mean_scale(every.channel(moving), claimed) * claimed
    halves = [lengths_by(every.channel(moving[k::2]), expected) for k in (0, 1)]
    _, precision = lengths_by(every.channel(moving), expected)
    if hangs(halves, expected) or scatter_alike(halves, expected, precision):
        return noisy_clock(log, streams, every, np.ones(every.position.shape, dtype=bool))
    instants = np.concatenate([[0.0], np.cumsum(np.maximum(expected, 0.0))])
    names = [name for stream in streams for name in stream.columns]
    return RowClock(instants, dict.fromkeys(names, instants), np.zeros(len(expected)), None, {}, {})


def moving_channels(log: Log, every: Stream) -> list[int]:
    """Channels that move in enough rows to have a say in a clock."""
    period = mean_step(log)
    return [k for k in range(every.position.shape[1]) if every.channel(k).share_in_motion(period) > MOVING]


def scatter_alike(halves: Sequence[tuple[np.ndarray, np.ndarray]], expected: np.ndarray, precision: np.ndarray) -> bool:
    """Whether two halves of the channels agree on the departures of lengths, in the rows that they tell sharply.

    That is the better half of the rows. In the best fifth less noise hides rows of which few are longer; there the
    departures also have to be large. ``halves``: lengths and 1 over their variances, (rows − 1,) each; ``precision`` of
    all channels, likewise.
    """
    most = FARTHEST * float(np.mean(expected))
    for share, least in ((0.5, 0.0), (SHARPEST, LEAST_SCATTER * float(np.mean(expected)))):
        sharp = precision >= np.quantile(precision, 1 - share)
        first, second = (np.clip((lengths - expected)[sharp], -most, most) for lengths, _ in halves)
        agreed = float(np.mean(first * second))
        if agreed > least**2 and agreed > AGREE * float(np.sqrt(np.mean(first**2) * np.mean(second**2))):
            return True
    return False


def hangs(halves: Sequence[tuple[np.ndarray, np.ndarray]], usual: np.ndarray) -> bool:
    """Whether rows are stalls by both halves of the channels: their lengths and 1 over the variances, (rows − 1,)."""
    longer = [lengths - usual for lengths, _ in halves]
    sure = [more * np.sqrt(precision) > SURE for more, (_, precision) in zip(longer, halves, strict=True)]
    stalls = np.logical_and.reduce([*sure, *(more > STALL * usual.mean() for more in longer)])
    return int(stalls.sum()) >= STALLS


def even_rows_fit(log: Log, streams: Sequence[Stream]) -> bool:
    """Whether rows of one length explain how far the joints moved between new samples, where they moved visibly.

    Such rows are whole multiples of many steps, and messages that are late do not make them uneven.
    """
    period, missed = mean_row(log, streams), [np.zeros(0)]
    for stream in streams:
        at = np.flatnonzero(stream.fresh)
        position, velocity, noise = stream.position[at], stream.velocity[at], stream.noise / QUIET
        lasted = period * np.diff(at)[:, None]
        expected, bend = (velocity[1:] + velocity[:-1]) / 2 * lasted, np.diff(velocity, axis=0) * lasted
        spread = np.hypot(np.sqrt(2) * noise, CURVATURE * bend)
        off = np.abs(np.diff(position, axis=0) - expected) / spread
        missed.append(off[np.abs(expected) > MOVES * spread])
    of_all = np.concatenate(missed)
    return len(of_all) >= NOISE_WINDOW and float(np.quantile(of_all, MOST_FIT)) < OUTLIER


def noisy_clock(log: Log, streams: Sequence[Stream], every: Stream, fresh: np.ndarray) -> RowClock | None:
    """The clock of a log whose instants noise blurs, by a smoother over all joints.

    A sample is taken in the row that first shows it. ``every`` are the channels of all joints and ``fresh``, (rows,
    channels), the rows that show new samples of them. None where fewer than two channels move.
    """
    moving = moving_channels(log, every)
    if len(moving) < 2:
        return None
    claimed = np.diff(log.time)
    lengths = smoothed_lengths(every.channel(moving), fresh[:, moving], claimed)
    if float(np.std(lengths.mean - claimed)) < EVEN * float(lengths.mean.mean()):
        lengths = SmoothedLengths(claimed * lengths.mean.sum() / claimed.sum(), np.zeros(len(claimed)))
    instants = np.concatenate([[0.0], np.cumsum(lengths.mean)])
    shown = {stream.name: instants[np.flatnonzero(stream.fresh)][np.cumsum(stream.fresh) - 1] for stream in streams}
    period = log.info.sample_period_s
    repeats = {one.name: repeated for one in streams if (repeated := one.repeats(period)) >= REPEATS}
    return RowClock(
        instants,
        {name: shown[stream.name] for stream in streams for name in stream.columns},
        lengths.spread,
        None,
        repeats,
        {},
    )


def smoothed_lengths(every: Stream, fresh: np.ndarray, claimed: np.ndarray) -> SmoothedLengths:
    """Lengths of rows by a smoother; ``fresh`` as in ``noisy_clock``, ``claimed`` lengths, s, (rows − 1,)."""
    noise, velocity_noise = (
        np.array([quiet_noise(values[new, None])[0] for values, new in zip(table.T, fresh.T, strict=True)]) / QUIET
        for table in (every.position, every.velocity)
    )
    return smooth_lengths(Samples(every.position, every.velocity, fresh, noise, velocity_noise), claimed)


def mean_step(log: Log) -> float:
    """Mean time from row to row as the log claims it, s."""
    return float(log.time[-1] - log.time[0]) / (len(log) - 1)


def mean_scale(stream: Stream, claimed: np.ndarray) -> float:
    """True over claimed length of rows, by all of the motion of a message; ``claimed`` lengths (rows − 1,), s."""
    summed = (stream.velocity[1:] + stream.velocity[:-1]) / 2 * claimed[:, None]
    weight = 1 / stream.noise**2
    return float((weight * summed * np.diff(stream.position, axis=0)).sum() / (weight * summed**2).sum())


def lengths_by(stream: Stream, around: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length of each row, s, and 1 over its variance, (rows − 1,) each, by the motion of a message alone.

    A row in which nothing moves lasts as long as it is expected to (``around``, (rows − 1,)), and says nothing.
    """
    mean = (stream.velocity[1:] + stream.velocity[:-1]) / 2
    bend = np.abs(np.diff(stream.velocity, axis=0))
    weight = 1 / (2 * stream.noise**2 + (CURVATURE * bend * around[:, None]) ** 2)
    precision = (weight * mean**2).sum(axis=1)
    moved = (weight * mean * np.diff(stream.position, axis=0)).sum(axis=1)
    return np.where(precision > 0, moved / np.maximum(precision, 1e-300), around), precision


@dataclass(frozen=True)
class Equations:
    """Weighted linear equations for the instants of rows and samples."""

    matrix: sp.csr_matrix
    right: np.ndarray
    weight: np.ndarray
    """1 over the standard deviation of each equation."""
    bend: np.ndarray
    """Change of velocity in equations of motion, by which its delay acts on their right side; 0 elsewhere."""
    stream: np.ndarray
    """Index of the message of each equation of motion; −1 elsewhere."""
    first: np.ndarray
    """Index of the first sample of each message among the unknowns; before them stand the rows."""
    sharpness: tuple[np.ndarray, ...]
    """For each message, standard deviation of the time between its samples by their motion alone, s."""


def clock_of_messages(log: Log, streams: Sequence[Stream]) -> RowClock:
    """The clock of a log that shows the latest message of each kind, whether it is new or not.

    Unknown are the instants of all rows and of all samples. Motion between the samples of a message says how much time
    passed; a row is written a little after the samples that it shows first.
    """
    period = mean_row(log, streams)
    equations = equations_of(streams, period)
    found = solve(equations, streams, period)
    step = whole_step(found.samples, equations.sharpness, period)
    if step is not None:
        found = solve(with_whole_steps(equations, found.samples, step), streams, period)
    shown = {stream.name: found.samples[k][np.cumsum(stream.fresh) - 1] for k, stream in enumerate(streams)}
    instants = instants_of_rows(found, streams, shown, equations.sharpness, step or period)
    if step is not None:
        instants = step * np.round((instants - instants[0]) / step)
    return RowClock(
        instants - instants[0],
        {name: shown[stream.name] - instants[0] for stream in streams for name in stream.columns},
        np.full(len(log) - 1, 0.0 if step else LAG_SPREAD * period),
        step,
        {stream.name: stream.repeats(log.info.sample_period_s) for stream in streams},
        {stream.name: float(delay) for stream, delay in zip(streams, found.delay, strict=True)},
        {} if step is None else velocity_filters(streams, found, step),
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


@dataclass(frozen=True)
class Differences:
    """Equations ``by · (plus − minus) = right`` between two unknowns each."""

    plus: np.ndarray
    minus: np.ndarray
    by: np.ndarray
    right: np.ndarray
    spread: np.ndarray
    """Standard deviation of each equation."""
    bend: np.ndarray | float = 0.0
    """Change of velocity, by which its delay acts on the right side."""
    stream: int = -1
    """Index of the message whose motion they tell; −1 where they tell none."""

    def column(self, values: np.ndarray | float) -> np.ndarray:
        """One value for each equation."""
        return np.broadcast_to(np.asarray(values, dtype=float), len(self.plus))


def equations_of(streams: Sequence[Stream], period: float) -> Equations:
    """All equations of a log of so many rows; ``period`` is the mean length of a row, s."""
    rows = len(streams[0].fresh)
    first = rows + np.concatenate([[0], np.cumsum([int(stream.fresh.sum()) for stream in streams])])
    parts, sharpness = [], []
    for k, stream in enumerate(streams):
        moves, sharp = motion_equations(stream, k, int(first[k]), period)
        at = np.flatnonzero(stream.fresh)
        after = first[k] + np.arange(1, len(at))
        lasts = period * np.diff(at)
        shown, one = first[k] + np.cumsum(stream.fresh) - 1, np.ones(rows)
        late = np.where(stream.fresh, LAG_SPREAD, 3 * LAG_SPREAD) * period
        parts += [
            *moves,
            Differences(after, after - 1, one[: len(after)], lasts, FREE * period * one[: len(after)]),
            Differences(np.arange(rows), shown, one, LAG * period * one, late),
        ]
        sharpness.append(sharp)
    return assemble(parts, first, tuple(sharpness))


def motion_equations(stream: Stream, index: int, first: int, period: float) -> tuple[list[Differences], np.ndarray]:
    """What the motion of each channel says of the times between samples, and how precisely the best one does, s."""
    at = np.flatnonzero(stream.fresh)
    after, between = first + np.arange(1, len(at)), np.diff(at)
    found, sharp = [], np.full(len(between), np.inf)
    for channel in range(stream.position.shape[1]):
        q, v = stream.position[at, channel], stream.velocity[at, channel]
        mean, bend = (v[1:] + v[:-1]) / 2, np.diff(v)
        curved = CURVATURE * period * np.abs(bend) * np.hypot(1.0, between / 5)
        spread = np.hypot(np.sqrt(2) * stream.noise[channel], curved)
        found.append(Differences(after, after - 1, mean, np.diff(q), spread, bend, index))
        sharp = np.minimum(sharp, spread / np.maximum(np.abs(mean), 1e-9))
    return found, sharp


def assemble(parts: Sequence[Differences], first: np.ndarray, sharpness: tuple[np.ndarray, ...]) -> Equations:
    """One system of all equations; the first row is written at instant 0."""
    plus, minus, by = (np.concatenate([getattr(part, name) for part in parts]) for name in ("plus", "minus", "by"))
    number, origin = np.arange(len(plus)), len(plus)
    matrix = sp.csr_matrix(
        (
            np.concatenate([by, -by, [1.0]]),
            (np.concatenate([number, number, [origin]]), np.concatenate([plus, minus, [0]])),
        ),
        shape=(origin + 1, int(first[-1])),
    )
    return Equations(
        matrix,
        np.concatenate([*(part.column(part.right) for part in parts), [0.0]]),
        np.concatenate([*(1 / part.column(part.spread) for part in parts), [ORIGIN]]),
        np.concatenate([*(part.column(part.bend) for part in parts), [0.0]]),
        np.concatenate([*(np.full(len(part.plus), part.stream) for part in parts), [-1]]),
        first,
        sharpness,
    )


@dataclass(frozen=True)
class Solution:
    """Instants that fit the equations."""

    rows: np.ndarray
    """When each row was written, s, (rows,)."""
    samples: tuple[np.ndarray, ...]
    """When the samples of each message were taken, s, (samples,) each."""
    delay: np.ndarray
    """Delay of the velocities of each message, s, (messages,)."""


def solve(equations: Equations, streams: Sequence[Stream], period: float) -> Solution:
    """Solve the equations by robust least squares.

    A velocity may be that of a moment before its position; this delay of each message is found on the way.
    """
    delay = np.full(len(streams), period / 2)
    weight, found = equations.weight, np.zeros(0)
    row_of_unknown = [np.arange(equations.first[0]) + 0.5, *(np.flatnonzero(stream.fresh) for stream in streams)]
    order = np.argsort(np.concatenate(row_of_unknown), kind="stable")
    for _ in range(ROUNDS):
        right = equations.right - delay_term(equations, delay)
        weighted = sp.diags(weight) @ equations.matrix
        found = solve_in_order(weighted.T @ weighted, weighted.T @ (weight * right), order)
        missed = equations.matrix @ found - right
        weight = equations.weight / np.sqrt(1 + (missed * equations.weight / OUTLIER) ** 2)
        delay = delay - delay_change(equations, weight, missed, len(streams))
    ends = zip(equations.first, equations.first[1:], strict=False)
    return Solution(found[: equations.first[0]], tuple(found[a:b] for a, b in ends), delay)


def solve_in_order(matrix: sp.csr_matrix, right: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Solve a symmetric positive definite system whose unknowns, in this order, depend on near ones alone."""
    options = {"SymmetricMode": True}
    factors = splu(matrix[order][:, order].tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0, options=options)
    found = np.empty(len(right))
    found[order] = factors.solve(right[order])
    return found


def delay_term(equations: Equations, delay: np.ndarray) -> np.ndarray:
    """What the delay of velocities (messages,) adds to the motion in each equation."""
    return np.where(equations.stream >= 0, delay[equations.stream] * equations.bend, 0.0)


def delay_change(equations: Equations, weight: np.ndarray, missed: np.ndarray, streams: int) -> np.ndarray:
    """By how much the delay of each message's velocities has to fall to explain what is missed, s, (messages,)."""
    change = np.zeros(streams)
    for k in range(streams):
        own = equations.stream == k
        square = float((weight[own] ** 2 * equations.bend[own] ** 2).sum())
        change[k] = float((weight[own] ** 2 * equations.bend[own] * missed[own]).sum()) / square if square > 0 else 0.0
    return change


STEPS_S = (0.02, 0.01, 0.005, 0.004, 0.0025, 0.002, 0.001, 0.0005, 0.00025)
"""Steps of simulations and control loops that are looked for, s, longest first."""


def velocity_filters(streams: Sequence[Stream], found: Solution, step: float) -> dict[str, VelocityFilter]:
    """Rules by which velocities were computed from positions, by the velocity columns of joints that obey one."""
    joints = [(stream, samples) for stream, samples in zip(streams, found.samples, strict=True) if stream.name != BASE]
    rules = obeyed_filters(
        {
            stream.name: filter_of(stream.position[stream.fresh], stream.velocity[stream.fresh], samples, step)
            for stream, samples in joints
        }
    )
    return {
        column: rules[stream.name]
        for stream, _ in joints
        if stream.name in rules
        for column in stream.columns
        if column.startswith(VELOCITY)
    }


LEAST_WHOLE = 0.85
"""Share of the precise times between samples that are one or more whole steps, from which all are."""


def whole_step(samples: Sequence[np.ndarray], sharpness: Sequence[np.ndarray], period: float) -> float | None:
    """The longest step of which the times between samples are whole multiples; None where there is none.

    ``period`` is the mean length of a row, s; steps much shorter than it would fit anything.
    """
    for step in (step for step in STEPS_S if step > period / 5):
        sharp = [np.diff(own)[spread < PRECISE * step] for own, spread in zip(samples, sharpness, strict=True)]
        steps = np.concatenate(sharp) / step
        whole = (np.abs(steps - np.round(steps)) < PRECISE) & (steps > 0.5)
        if len(steps) >= NOISE_WINDOW and whole.mean() > LEAST_WHOLE:
            return step
    return None


def with_whole_steps(equations: Equations, samples: Sequence[np.ndarray], step: float) -> Equations:
    """The equations with one more for each time between samples that is precisely so many steps."""
    plus: list[np.ndarray] = []
    right: list[np.ndarray] = []
    for first, own, sharp in zip(equations.first, samples, equations.sharpness, strict=False):
        number = np.round(np.diff(own) / step)
        near = (np.abs(np.diff(own) / step - number) < PRECISE) & (sharp < PRECISE * step) & (number >= 1)
        plus.append(first + 1 + np.flatnonzero(near))
        right.append(step * number[near])
    after, known = np.concatenate(plus), np.concatenate(right)
    each = np.arange(len(after))
    more = sp.csr_matrix(
        (np.repeat([1.0, -1.0], len(after)), (np.tile(each, 2), np.concatenate([after, after - 1]))),
        shape=(len(after), equations.matrix.shape[1]),
    )
    none = np.zeros(len(after))
    return replace(
        equations,
        matrix=sp.vstack([equations.matrix, more]).tocsr(),
        right=np.concatenate([equations.right, known]),
        weight=np.concatenate([equations.weight, np.full(len(after), 100 / step)]),
        bend=np.concatenate([equations.bend, none]),
        stream=np.concatenate([equations.stream, none.astype(int) - 1]),
    )


def instants_of_rows(
    found: Solution,
    streams: Sequence[Stream],
    shown: Mapping[str, np.ndarray],
    sharpness: Sequence[np.ndarray],
    step: float,
) -> np.ndarray:
    """When each row was written, s, never decreasing, (rows,): at the latest sample that it shows.

    The second latest of the precise ones is taken, since a single one may err; where fewer are precise, the solution.
    """
    columns = []
    for stream, sharp in zip(streams, sharpness, strict=True):
        precise = np.concatenate([[False], sharp < PRECISE * step])[np.cumsum(stream.fresh) - 1]
        columns.append(np.where(precise, shown[stream.name], -np.inf))
    latest = np.sort(np.stack(columns, axis=1), axis=1)[:, -min(2, len(columns))]
    return np.maximum.accumulate(np.where(np.isfinite(latest), latest, found.rows - LAG * step))


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
