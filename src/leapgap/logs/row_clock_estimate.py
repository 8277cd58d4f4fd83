"""When each row of a log was written, and each of its samples taken, by the motion of the joints.

A joint's position changes by its velocity times the time that passed. Twelve joints agree on that time row by row, so
a log whose rows last unequally long, or which repeats messages that it received, tells its own true clock. No model of
the robot is needed. The base's state is placed by its own motion; it does not decide the clock of the rows.

Of a noisy log the lengths of rows are found by a Kalman smoother whose unknown is time. Between two samples that both
err, what one row seems to gain its neighbour loses; the smoother knows that, so that noise does not add up over the
log. Lengths are drawn around their mean with a width that is found from the log, and with far tails for stalls.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.row_clock import (
    BASE,
    CURVATURE,
    MOVES,
    NOISE_WINDOW,
    OUTLIER,
    RowClock,
    Stream,
    mean_row,
    merge,
    quiet_noise,
    streams_of,
)

BLOCK, OVERLAP = 400, 25  # rows that are smoothed together, and those at each end of them that are smoothed twice
TOGETHER = 64  # blocks that are smoothed side by side, which bounds the memory
ROUNDS = 8  # passes over the log, each with the width of lengths that the one before gives
FREEDOM = 3.0  # degrees of freedom of Student's distribution of lengths: stalls are rare and far away
BEST_KNOWN = 0.75  # the mean length of a row is taken from rows that are better known than this share of them
NARROWEST = 0.01  # least width of lengths, as a share of their mean
FIRST_WIDTH = 0.3  # width with which the first pass begins
DELAY_ROWS, LONGEST_DELAY = 20, 3.0
"""Rows over which changes of velocity are held against motion, and the longest delay of velocities, in mean rows."""
START = 0.05  # standard deviation of a position before its first sample, rad or m
LEAST_NOISE = 1e-6  # least standard deviation of the noise of a position, rad or m
UNKNOWN = 1e3  # standard deviation of a sample that a row does not have, rad or m


@dataclass(frozen=True)
class Samples:
    """What rows show of some channels."""

    position: np.ndarray  # (rows, channels), rad or m
    velocity: np.ndarray  # (rows, channels), per s
    fresh: np.ndarray  # whether a row shows a new sample, bool, (rows, channels)
    noise: np.ndarray  # standard deviation of the noise of positions, (channels,)
    velocity_noise: np.ndarray  # standard deviation of the noise of velocities, (channels,)


def smooth_lengths(samples: Samples, claimed: np.ndarray) -> np.ndarray:
    """Lengths of all rows but the last around the ``claimed`` ones, s, (rows − 1,), times one factor."""
    mean = float(claimed.mean())
    scale, width = 1.0, FIRST_WIDTH * mean
    weight, lasted, delay = np.ones(len(claimed)), claimed, velocity_delay(samples, claimed)
    for _ in range(ROUNDS):
        before = width / np.sqrt(weight)
        in_time = replace(samples, position=samples.position - delay * samples.velocity)  # velocities are older by it
        found, spread = smooth(in_time, lasted, scale * claimed, before)
        off = found - scale * claimed
        square = off**2 + spread**2
        weight = (FREEDOM + 1) / (FREEDOM + square / width**2)
        delay = velocity_delay(samples, found)
        lasted, usual = np.maximum(found, claimed), scale * claimed
        scale += float((weight * off * claimed).sum() / (weight * claimed**2).sum())
        width = max(float(np.sqrt((weight * square).mean())), NARROWEST * mean)
    # Stalls have no counterpart: where samples would not show one, a row lasts as long as the mean, not the usual one.
    told = (1 / np.maximum(spread, 1e-12) ** 2 - 1 / before**2) * float(square.mean())
    known = told / (1 + told)
    longer = float(off[known >= np.quantile(known, BEST_KNOWN)].mean())
    return np.maximum(usual + off + (1 - known) * longer, 0.0)


def velocity_delay(samples: Samples, lengths: np.ndarray) -> float:
    """How much older the velocities of all channels are than their positions, s; below zero where they are younger.

    Simulations advance positions by the velocities after a step, or before it. What the sums of velocities over rows of
    these lengths, s, (rows − 1,), leave of the motion is then a share of the change of velocity.
    """
    velocity = at_every_row(samples.velocity, samples.fresh)
    speed = (velocity[1:] + velocity[:-1]) / 2
    left = samples.position[1:] - np.cumsum(speed * lengths[:, None], axis=0)
    span = max(1, min(DELAY_ROWS, len(left) // 4))
    new = samples.fresh[1:]
    weight = (new[span:] & new[:-span]) / np.maximum(samples.noise, LEAST_NOISE) ** 2
    left, change = left[span:] - left[:-span], velocity[1 + span :] - velocity[1:-span]
    square = float((weight * change**2).sum())
    most = LONGEST_DELAY * float(lengths.mean())
    return float(np.clip((weight * change * left).sum() / square, -most, most)) if square > 0 else 0.0


def smooth(
    samples: Samples, lasted: np.ndarray, expected: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of rows and their standard deviations afterwards, s, by their expectations and those beforehand, s.

    (rows − 1,) each. What a row adds to errors grows with how long it ``lasted``, s.
    """
    velocity = at_every_row(samples.velocity, samples.fresh)
    bend, speed = np.abs(np.diff(velocity, axis=0)), (velocity[1:] + velocity[:-1]) / 2
    wander = (CURVATURE * bend * lasted[:, None]) ** 2 + (samples.velocity_noise * lasted[:, None]) ** 2
    variance = np.where(samples.fresh, np.maximum(samples.noise, LEAST_NOISE), UNKNOWN) ** 2
    mean, spread = np.empty(len(expected)), np.empty(len(expected))
    blocks, own = blocks_of(len(samples.position))
    for first in range(0, len(blocks), TOGETHER):
        rows, mine = blocks[first : first + TOGETHER], own[first : first + TOGETHER]
        inside = rows[:, :-1]
        around, before = expected[inside], width[inside] ** 2
        updates = filtered(samples.position[rows], variance[rows], speed[inside], wander[inside], around, before)
        pull, sure = look_back(speed[inside], *updates)
        mean[inside[mine]] = (around + before * pull)[mine]
        spread[inside[mine]] = np.sqrt(np.maximum(before - before**2 * sure, 0.0))[mine]
    return mean, spread


def blocks_of(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Stretches of a log of so many rows, each with rows of its neighbours at both ends.

    The rows of each, (blocks, rows of a block), and whether the length of a row is taken from this block, bool,
    (blocks, rows of a block − 1).
    """
    whole = min(count, BLOCK)
    inner = max(1, whole - 2 * OVERLAP)
    starts = np.unique(np.minimum(np.arange(0, max(1, count - 2 * OVERLAP), inner), count - whole))
    own = np.zeros((len(starts), whole - 1), dtype=bool)
    taken = 0
    for block, start in enumerate(starts):
        end = count - 1 if block == len(starts) - 1 else int(start) + whole - OVERLAP
        own[block, taken - start : end - start] = True
        taken = end
    return starts[:, None] + np.arange(whole), own


def filtered(
    observed: np.ndarray,
    variance: np.ndarray,
    speeds: np.ndarray,
    wander: np.ndarray,
    around: np.ndarray,
    before: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward pass: weighted innovations, their inverse covariances, and what each update leaves of an error.

    Of blocks side by side: positions with their variances, (blocks, rows, channels); mean velocities of the rows but
    the last and the variance of the motion beside them, likewise; lengths and their variances, (blocks, rows − 1).
    """
    blocks, rows, channels = observed.shape
    unit = np.eye(channels)
    state = observed[:, 0].copy()
    covariance = np.broadcast_to(START**2 * unit, (blocks, channels, channels)).copy()
    weighted = np.empty((rows, blocks, channels))
    inverse = np.empty((rows, blocks, channels, channels))
    left = np.empty_like(inverse)
    for row in range(rows):
        inverse[row] = np.linalg.inv(covariance + variance[:, row, :, None] * unit)
        weighted[row] = np.einsum("bij,bj->bi", inverse[row], observed[:, row] - state)
        left[row] = unit - covariance @ inverse[row]
        if row == rows - 1:
            break
        state = state + np.einsum("bij,bj->bi", covariance, weighted[row])
        covariance = left[row] @ covariance
        covariance = (covariance + np.swapaxes(covariance, 1, 2)) / 2
        speed = speeds[:, row]
        state = state + speed * around[:, row, None]
        covariance = covariance + before[:, row, None, None] * speed[:, :, None] * speed[:, None, :]
        covariance = covariance + wander[:, row, :, None] * unit
    return weighted, inverse, left


def look_back(
    speeds: np.ndarray, weighted: np.ndarray, inverse: np.ndarray, left: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Backward pass: how far later samples pull the length of each row, and how surely, (blocks, rows − 1) each."""
    pull, sure = np.empty(speeds.shape[:2]), np.empty(speeds.shape[:2])
    adjoint, square = weighted[-1], inverse[-1]
    for row in range(len(weighted) - 2, -1, -1):
        speed = speeds[:, row]
        pull[:, row] = (speed * adjoint).sum(axis=1)
        sure[:, row] = np.einsum("bi,bij,bj->b", speed, square, speed, optimize=False)
        keep = np.swapaxes(left[row], 1, 2)
        adjoint = weighted[row] + np.einsum("bij,bj->bi", keep, adjoint)
        square = inverse[row] + keep @ square @ left[row]
    return pull, sure


def at_every_row(values: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Values (rows, channels) on straight lines between the rows that show new ones."""
    rows = np.arange(len(values))
    columns = [np.interp(rows, rows[new], column[new]) for column, new in zip(values.T, fresh.T, strict=True)]
    return np.stack(columns, axis=1)


AGREE, FARTHEST = 0.5, 3.0
"""Correlation of what two halves of the channels say of the lengths of rows, from which these are uneven; departures
count up to so many mean rows. Impacts and noise correlate by less than 0.2, uneven rows by more than 0.9."""
SHARPEST, LEAST_SCATTER = 0.2, 0.12
"""Share of the rows in which the halves also have to agree on a scatter of so many mean rows; even rows reach 0.05."""
MOVING = 0.1  # share of the rows in which a channel has to move to have a say in a clock
QUIET = 0.625  # the noise of the quietest windows over that of all; the smoother takes the latter
STALL, STALLS, SURE = 2.5, 2, 4.0
"""A row that lasts longer than others by so many mean rows by both halves of the channels, each so many standard
deviations sure, is a stall; from so many on a log is uneven."""
MOST_FIT = 0.8  # share of motions between samples that even rows have to explain within ``OUTLIER`` deviations
EVEN = 0.06  # rows whose lengths scatter by a smaller share of their mean are even: noise alone makes 0.03
REPEATS = 0.02  # share of repeated samples, while a joint moves, from which a log is one of messages
UNEVEN = 0.15  # rows are uneven whose lengths scatter by more than this share of their mean


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
    return noisy_clock(log, telling) or clock


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
    stream = every.channels(moving)
    summed = (stream.velocity[1:] + stream.velocity[:-1]) / 2 * claimed[:, None]
    weight = 1 / stream.noise**2
    expected = float((weight * summed * np.diff(stream.position, axis=0)).sum() / (weight * summed**2).sum()) * claimed
    halves = [lengths_by(every.channels(moving[k::2]), expected) for k in (0, 1)]
    _, precision = lengths_by(every.channels(moving), expected)
    if hangs(halves, expected) or scatter_alike(halves, expected, precision):
        return noisy_clock(log, streams, whole=True)
    instants = np.concatenate([[0.0], np.cumsum(np.maximum(expected, 0.0))])
    names = [name for stream in streams for name in stream.columns]
    return RowClock(instants, dict.fromkeys(names, instants), None, {})


def moving_channels(log: Log, every: Stream) -> list[int]:
    """Channels that move in enough rows to have a say in a clock."""
    period = float(log.time[-1] - log.time[0]) / (len(log) - 1)
    return [k for k in range(every.position.shape[1]) if every.channels([k]).moves(period).mean() > MOVING]


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


def noisy_clock(log: Log, streams: Sequence[Stream], whole: bool = False) -> RowClock | None:
    """The clock of a log whose instants noise blurs, by a smoother over all joints.

    A sample is taken in the row that first shows it, with ``whole`` rows in each. None where fewer than two channels
    move.
    """
    of_joints = [stream for stream in streams if stream.name != BASE]
    every = merge(of_joints)
    fresh = np.stack([stream.fresh | whole for stream in of_joints for _ in range(stream.position.shape[1])], axis=1)
    moving = moving_channels(log, every)
    if len(moving) < 2:
        return None
    claimed = np.diff(log.time)
    chosen, fresh = every.channels(moving), fresh[:, moving]
    noise, velocity_noise = (
        np.array([quiet_noise(values[new, None])[0] for values, new in zip(table.T, fresh.T, strict=True)]) / QUIET
        for table in (chosen.position, chosen.velocity)
    )
    lengths = smooth_lengths(Samples(chosen.position, chosen.velocity, fresh, noise, velocity_noise), claimed)
    if float(np.std(lengths - claimed)) < EVEN * float(lengths.mean()):
        lengths = claimed * lengths.sum() / claimed.sum()
    instants = np.concatenate([[0.0], np.cumsum(lengths)])
    shown = {stream.name: instants[np.flatnonzero(stream.fresh)][np.cumsum(stream.fresh) - 1] for stream in streams}
    period = log.info.sample_period_s
    repeats = {one.name: repeated for one in streams if (repeated := one.repeats(period)) >= REPEATS}
    return RowClock(
        instants, {name: shown[stream.name] for stream in streams for name in stream.columns}, None, repeats
    )


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
