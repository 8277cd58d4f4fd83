"""Moments at which a force stands out: larger than what the model leaves elsewhere, and absent from all other logs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.evidence.base import NORMAL_MEDIAN
from leapgap.diagnosis.outside_forces.outside_force import OutsideForceSettings
from leapgap.diagnosis.outside_forces.residuals import Residual, Residuals

LENGTHS_S = (0.06, 0.12, 0.24, 0.48)  # Times over which forces are averaged to find moments that stand out
MOST_QUIET, TAIL = 0.8, 0.95
"""Shares of the mean forces that are no outside force; their size says what the model leaves.

The second is for short moments, once the larger forces are known: over a short time, errors of a model are far from
normal.
"""
NORMAL_SIZE = {MOST_QUIET: 1.2816, TAIL: 1.96}  # The size that these shares of standard normal numbers do not exceed
SHORT_S = 0.1  # Moments that stand out most over a shorter time count as short
SMOOTH_S = 0.07  # Forces are averaged over this time where the begin and end of a moment are looked for
REPEAT_S = 0.05  # The same where a force is compared with that of other logs
EDGE, CENTRE = 0.12, 0.35
"""Shares of its peak: a moment ends where its force falls below the first, and its centre is that of what is above the
other."""
MEDIAN_LOGS = 3  # From so many other logs on, what they repeat is their median; of two, the smaller one if they agree
SWING = 0.7
"""A force of the other sign beside a moment, as a share of the moment's own mean, from which on it is no push."""
SURE_SIZE = 20.0  # A moment that stands out by more may be so much smaller beside the forces that the motions need
LEAST_STRANGE_S = 1.0
"""Least time in states that no other log was near to that says how far off a model is there; else all states say it."""
SAME_TIME_S = 0.05  # Centres of forces in several logs are at one time where they differ by less
END_S = 0.1  # No moment is told that begins sooner after the begin of a log
COMPARED_ROWS = 4000  # Number of instants of all logs together in which a similar state is looked for


@dataclass(frozen=True)
class Episode:
    """One moment of one log in which a force acts that no model explains."""

    log: int  # Index of the log
    dof: int
    begin_s: float
    end_s: float
    time_s: float  # Time of its centre, weighted by what the smoothed force has above a third of its peak
    peak: float  # N or N·m, signed
    impulse: float  # N·s or N·m·s, signed
    deviation: float  # Standard deviation of the impulse, by what the model leaves elsewhere over as long a time
    size: float  # Mean force over its best length, in standard deviations of what the model leaves


@dataclass(frozen=True)
class Repeats:
    """What other logs show in the state that a log is in."""

    force: np.ndarray  # Force that the other logs repeat, (instants, nv)
    spread: np.ndarray  # How far the other logs are from that, standard deviation, (instants, nv)
    distance: np.ndarray  # Distance to the nearest state of another log, (instants,)


def episodes_of(residuals: Residuals, settings: OutsideForceSettings) -> list[Episode]:
    """All moments that stand out, in the order of logs and times."""
    of_logs = residuals.of_logs
    repeats = repeats_of(of_logs, settings.near)
    alone = [of.force - own.force for of, own in zip(of_logs, repeats, strict=True)]
    found = [
        one
        for dof in range(len(residuals.scale))
        for one in episodes_at(of_logs, alone, repeats, dof, settings.least_size)
        if abs(one.peak) >= least_peak(one, residuals, settings)
        and abs(one.impulse) >= settings.least_size * one.deviation
        and one.end_s - one.begin_s <= settings.longest_s
        and stands_out_in_its_state(of_logs, alone, repeats, one, settings)
        and is_inside(of_logs[one.log], one)
        and not swings(of_logs[one.log], alone[one.log][:, dof], one)
    ]
    kept = largest_of_each_moment(found)
    alone_in_time = [one for one in kept if not in_most_logs(one, kept, len(of_logs))]
    return sorted(alone_in_time, key=lambda one: (one.log, one.time_s, one.dof))


def least_peak(episode: Episode, residuals: Residuals, settings: OutsideForceSettings) -> float:
    """Smallest peak that a moment needs beside the forces of the motion and the friction of its joint, N or N·m."""
    share = settings.least_share * min(1.0, SURE_SIZE / abs(episode.size))
    return float(max(share * residuals.scale[episode.dof], residuals.friction[episode.dof]))


def largest_of_each_moment(episodes: Sequence[Episode]) -> list[Episode]:
    """One moment of those that overlap in a log: a push at one joint is seen at its neighbours, too."""
    kept: list[Episode] = []
    for one in sorted(episodes, key=lambda one: -abs(one.size)):
        same = (other for other in kept if other.log == one.log)
        if not any(min(one.end_s, other.end_s) > max(one.begin_s, other.begin_s) for other in same):
            kept.append(one)
    return kept


def in_most_logs(episode: Episode, every: Sequence[Episode], logs: int) -> bool:
    """Whether most of the other logs, two at least, have such a force at that time: then their common motion needs it.

    Jumps to other targets, for one, are in other states at a time, so that no state of theirs is near.
    """
    others = {
        one.log
        for one in every
        if one.log != episode.log
        and one.dof == episode.dof
        and one.impulse * episode.impulse > 0
        and abs(one.time_s - episode.time_s) < SAME_TIME_S
    }
    return len(others) >= max(2, (logs - 1) / 2)


def swings(residual: Residual, force: np.ndarray, episode: Episode) -> bool:
    """Whether the force goes the other way in as long a time before or after: a model that is wrong swings, too."""
    length_s, time = episode.end_s - episode.begin_s, residual.time
    before = force[(time >= episode.begin_s - length_s) & (time < episode.begin_s)]
    after = force[(time > episode.end_s) & (time <= episode.end_s + length_s)]
    mean = episode.impulse / length_s
    return any(len(side) > 0 and float(side.mean()) / mean < -SWING for side in (before, after))


def stands_out_in_its_state(
    of_logs: Sequence[Residual],
    alone: Sequence[np.ndarray],
    repeats: Sequence[Repeats],
    episode: Episode,
    settings: OutsideForceSettings,
) -> bool:
    """Whether a force is large for the state in which it acts.

    Where another log was near, it is: that log shows nothing like it. Elsewhere the model may be wrong in a way that no
    log can tell from a push. There the force must be larger than what the model leaves in all other such states.
    """
    during = moment(of_logs[episode.log], episode)
    if np.median(repeats[episode.log].distance[during]) < settings.near:
        return True
    length_s, strange, every = episode.end_s - episode.begin_s, [], []
    for log, (of, force, own) in enumerate(zip(of_logs, alone, repeats, strict=True)):
        mean = box_mean(force[:, episode.dof], rows_of(length_s, of))
        others = ~moment(of, episode, margin_s=length_s) if log == episode.log else np.ones(len(mean), bool)
        every.append(mean[others])
        strange.append(mean[others & (own.distance >= settings.near)])
    few = sum(map(len, strange)) * of_logs[0].every_s < LEAST_STRANGE_S
    return abs(episode.impulse) / length_s >= settings.least_size_alone * quiet_spread(every if few else strange)


def moment(residual: Residual, episode: Episode, margin_s: float = 0.0) -> np.ndarray:
    """Instants of an episode, with a margin on both sides, bool, (instants,)."""
    time = residual.time
    return np.asarray((time >= episode.begin_s - margin_s) & (time <= episode.end_s + margin_s))


def is_inside(residual: Residual, episode: Episode) -> bool:
    """Whether a moment is away from the ends of its log, where smoothing sees one side alone."""
    return residual.time[0] + END_S < episode.begin_s and episode.end_s < residual.time[-1]


def repeats_of(of_logs: Sequence[Residual], near: float) -> list[Repeats]:
    """What all other logs show in the states of each log."""
    stride = max(1, sum(len(of.time) for of in of_logs) // COMPARED_ROWS)
    smooth = [box_mean(of.force, max(1, round(REPEAT_S / of.every_s)))[::stride] for of in of_logs]
    states, quiet = [of.state[::stride] for of in of_logs], [of.quiet[::stride] for of in of_logs]
    found = []
    for log, of in enumerate(of_logs):
        force, distance = [], []
        for other in range(len(of_logs)):
            if other == log:
                continue
            nearest, how_far = nearest_states(of.state, states[other][quiet[other]])
            force.append(np.where(how_far[:, None] < near, smooth[other][quiet[other]][nearest], np.nan))
            distance.append(how_far)
        common, spread = common_part(np.array(force), of.force)
        found.append(Repeats(common, spread, np.min(distance, axis=0)))
    return found


def nearest_states(states: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of the nearest other state of each state, and the distance to it, (states,) each."""
    squares = (states**2).sum(axis=1)[:, None] + (others**2).sum(axis=1) - 2 * states @ others.T
    nearest = squares.argmin(axis=1)
    least = np.maximum(squares[np.arange(len(states)), nearest], 0.0)
    return nearest, np.sqrt(least)


def common_part(forces: np.ndarray, like: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force that other logs agree on, and how far they are from it, in the shape of ``like`` (instants, nv).

    ``forces`` (logs, instants, nv) are NaN where a log was never near. One log alone agrees on nothing: it may be the
    one that was pushed.
    """
    number = np.isfinite(forces[:, :, :1]).sum(axis=0)
    median, two = median_of_some(forces), of_two(forces)
    common = np.where(number >= MEDIAN_LOGS, median, np.where(number == 2, two, 0.0))
    spread = median_of_some(np.abs(forces - common)) / NORMAL_MEDIAN
    return common, np.where(number >= MEDIAN_LOGS, spread, 0.0)


def median_of_some(values: np.ndarray) -> np.ndarray:
    """Median over the first axis of what is finite; 0 where nothing is."""
    number, ordered = np.isfinite(values).sum(axis=0), np.sort(values, axis=0)  # NaN last
    at = [np.take_along_axis(ordered, np.maximum(k, 0)[None], axis=0)[0] for k in ((number - 1) // 2, number // 2)]
    return np.where(number > 0, (at[0] + at[1]) / 2, 0.0)


def of_two(forces: np.ndarray) -> np.ndarray:
    """The smaller of two forces of one sign, 0 where signs differ, (instants, nv); ``forces`` as of ``common_part``."""
    smallest = np.nan_to_num(np.where(np.isfinite(forces), np.abs(forces), np.inf).min(axis=0), posinf=0.0)
    signs = np.nan_to_num(np.sign(forces)).sum(axis=0)
    return np.where(np.abs(signs) == 2, np.sign(signs) * smallest, 0.0)


def box_mean(values: np.ndarray, rows: int) -> np.ndarray:
    """Mean over so many rows about each row, in the shape of the values; fewer at the ends."""
    reach = rows // 2
    total = np.cumsum(np.concatenate([np.zeros_like(values[:1]), values]), axis=0)
    at = np.arange(len(values))
    begin, end = np.maximum(at - reach, 0), np.minimum(at + (rows - reach), len(values))
    number = (end - begin).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((total[end] - total[begin]) / number)


def episodes_at(
    of_logs: Sequence[Residual],
    forces: Sequence[np.ndarray],
    repeats: Sequence[Repeats],
    dof: int,
    least_size: float,
) -> list[Episode]:
    """Moments at one joint, or one axis of the base, whose mean force is larger than ``least_size``."""
    own = [force[:, dof] for force in forces]
    candidates, any_known = [], not all(of.quiet.all() for of in of_logs)
    for length_s in LENGTHS_S:
        means = [box_mean(force, rows_of(length_s, of)) for force, of in zip(own, of_logs, strict=True)]
        of_quiet = [mean[of.quiet] for mean, of in zip(means, of_logs, strict=True)]
        spread = quiet_spread(
            of_quiet if any(map(len, of_quiet)) else means, TAIL if any_known and length_s <= SHORT_S else MOST_QUIET
        )
        for log, mean in enumerate(means):
            spreads = np.hypot(spread, box_mean(repeats[log].spread[:, dof], rows_of(length_s, of_logs[log])))
            size = mean / spreads
            candidates += [
                (abs(size[k]) * np.sqrt(length_s), log, int(k), length_s, float(size[k]), float(spreads[k]))
                for k in np.flatnonzero(np.abs(size) > least_size)
            ]
    taken = [np.zeros(len(force), bool) for force in own]
    found = []
    for _, log, row, length_s, size, spread in sorted(candidates, reverse=True):
        reach = rows_of(length_s, of_logs[log]) // 2
        about = slice(max(0, row - reach), row + reach + 1)
        if taken[log][about].any():
            continue
        smooth = np.sign(size) * box_mean(own[log], rows_of(SMOOTH_S, of_logs[log]))
        if smooth[about].max() <= 0:
            continue
        rows = extent(smooth, about, taken[log])
        taken[log][rows] = taken[log][about] = True
        found.append(episode(of_logs[log], own[log], log, dof, rows, size, spread, length_s))
    return found


def rows_of(seconds: float, residual: Residual) -> int:
    """Number of instants in a time, one at least."""
    return max(1, round(seconds / residual.every_s))


def quiet_spread(means: Sequence[np.ndarray], share: float = MOST_QUIET) -> float:
    """Standard deviation of mean forces where nothing acts from outside, by the size that a share of them is below."""
    return max(float(np.quantile(np.abs(np.concatenate(list(means))), share)) / NORMAL_SIZE[share], 1e-9)


def extent(smooth: np.ndarray, about: slice, taken: np.ndarray) -> slice:
    """Rows of a moment: about the peak of its smoothed force within ``about``, as far as a share of that is kept."""
    top = about.start + int(np.argmax(smooth[about]))
    ends = (smooth <= EDGE * smooth[top]) | taken
    before, after = np.flatnonzero(ends[:top]), np.flatnonzero(ends[top + 1 :])
    begin = int(before[-1]) + 1 if len(before) else 0
    return slice(begin, top + 1 + int(after[0]) if len(after) else len(smooth))


def episode(
    residual: Residual,
    force: np.ndarray,
    log: int,
    dof: int,
    rows: slice,
    size: float,
    spread: float,
    length_s: float,
) -> Episode:
    """One moment with its numbers."""
    time, own = residual.time[rows], force[rows]
    impulse = float(own.sum() * residual.every_s)
    smooth = box_mean(force, rows_of(SMOOTH_S, residual))[rows]
    duration_s = len(own) * residual.every_s
    strong = np.maximum(np.sign(size) * smooth - CENTRE * np.max(np.sign(size) * smooth), 0.0)
    return Episode(
        log=log,
        dof=dof,
        begin_s=float(time[0] - residual.every_s / 2),
        end_s=float(time[-1] + residual.every_s / 2),
        time_s=float(np.average(time, weights=strong)),
        peak=float(np.sign(size) * np.max(np.sign(size) * smooth)),
        impulse=impulse,
        deviation=float(spread * np.sqrt(length_s * duration_s)),
        size=size,
    )
