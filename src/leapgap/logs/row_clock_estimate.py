"""When each row of a log was written, and each of its samples taken, by the motion of the joints.

A joint's position changes by its velocity times the time that passed. Twelve joints agree on that time row by row, so
a log whose rows last unequally long, or which repeats messages that it received, tells its own true clock. No model of
the robot is needed. The base's state is placed by its own motion; it does not decide the clock of the rows.
"""

from collections.abc import Sequence

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.row_clock import RowClock
from leapgap.logs.row_smoother import Samples, SmoothedLengths, smooth_lengths
from leapgap.logs.streams import (
    BASE,
    CURVATURE,
    MOVES,
    NOISE_WINDOW,
    OUTLIER,
    Stream,
    mean_row,
    merge,
    quiet_noise,
    streams_of,
)

AGREE, FARTHEST = 0.5, 3.0
"""Correlation of what two halves of the channels say of the lengths of rows, from which these are uneven; departures
count up to so many mean rows. Impacts and noise correlate by less than 0.2, uneven rows by more than 0.9."""
SHARPEST, LEAST_SCATTER = 0.2, 0.12
"""Share of the rows in which the halves also have to agree on a scatter of so many mean rows; even rows reach 0.05."""
MOVING = 0.1
"""Share of the rows in which a channel has to move to have a say in a clock."""
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
    from leapgap.logs.message_clock import clock_of_messages  # imports scipy.sparse, a third of a short check's time

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
    # True over claimed length of rows, by all of the motion of a message; ``claimed`` lengths (rows − 1,), s
    stream = every.channel(moving)
    summed = (stream.velocity[1:] + stream.velocity[:-1]) / 2 * claimed[:, None]
    weight = 1 / stream.noise**2
    expected = float((weight * summed * np.diff(stream.position, axis=0)).sum() / (weight * summed**2).sum()) * claimed
    halves = [lengths_by(every.channel(moving[k::2]), expected) for k in (0, 1)]
    _, precision = lengths_by(every.channel(moving), expected)
    if hangs(halves, expected) or scatter_alike(halves, expected, precision):
        return noisy_clock(log, streams, every, np.ones(every.position.shape, dtype=bool))
    instants = np.concatenate([[0.0], np.cumsum(np.maximum(expected, 0.0))])
    names = [name for stream in streams for name in stream.columns]
    return RowClock(instants, dict.fromkeys(names, instants), None, {})


def moving_channels(log: Log, every: Stream) -> list[int]:
    """Channels that move in enough rows to have a say in a clock."""
    period = float(log.time[-1] - log.time[0]) / (len(log) - 1)
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
    lengths = smoothed_lengths(every.channel(moving), fresh[:, moving], claimed).mean
    if float(np.std(lengths - claimed)) < EVEN * float(lengths.mean()):
        lengths = claimed * lengths.sum() / claimed.sum()
    instants = np.concatenate([[0.0], np.cumsum(lengths)])
    shown = {stream.name: instants[np.flatnonzero(stream.fresh)][np.cumsum(stream.fresh) - 1] for stream in streams}
    period = log.info.sample_period_s
    repeats = {one.name: repeated for one in streams if (repeated := one.repeats(period)) >= REPEATS}
    return RowClock(
        instants, {name: shown[stream.name] for stream in streams for name in stream.columns}, None, repeats
    )


def smoothed_lengths(every: Stream, fresh: np.ndarray, claimed: np.ndarray) -> SmoothedLengths:
    """Lengths of rows by a smoother; ``fresh`` as in ``noisy_clock``, ``claimed`` lengths, s, (rows − 1,)."""
    noise, velocity_noise = (
        np.array([quiet_noise(values[new, None])[0] for values, new in zip(table.T, fresh.T, strict=True)]) / QUIET
        for table in (every.position, every.velocity)
    )
    return smooth_lengths(Samples(every.position, every.velocity, fresh, noise, velocity_noise), claimed)


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
