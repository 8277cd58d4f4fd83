"""Are the columns what their names say, in all logs alike: signs, units, order of joints, set points?"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints
from leapgap.diagnosis.checks.pieces import Pieces, as_logged, departure, spread_starts
from leapgap.diagnosis.checks.readings import Reading, readings
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

PIECES, LENGTH_S, ROWS = 12, 0.05, 4  # Pieces of all logs together; they last so long and have so many rows at least
SEEN = 5.0  # A joint tells something where it departs from even motion by so many standard deviations of its noise
STILL = 1e-9  # A joint that departs from even motion by less, rad or m, counts as if it did by that
UNEXPLAINED = 0.9
"""A joint is in doubt where replays miss so much of its departure from even motion, in the median of the logs: with
columns of something else they miss all of it or more."""
FIRST_LOOK = 4  # Readings are tried on so many of the pieces first, and on all where these speak for one
MOST_READINGS = 4  # So many readings may hold together
AS_GOOD = 0.8  # Another reading is a rival where it makes the gap so many times as much smaller as the best


@dataclass(frozen=True)
class Judged:
    """The errors that replays make by a reading."""

    missed: np.ndarray  # Share of its departure from even motion that a replay misses, (joints,); root mean squares
    by_log: np.ndarray  # The same of each log, (logs, joints)


class Wiring(Check):
    """What is wrong in all logs alike is no cause: short pieces are replayed by other readings of the columns.

    The statistic is how many times smaller the gap of the joints is by the best reading, in short pieces. A cause may
    well move the gap of a joint by a factor; a reading counts from a larger one on, in every log.
    """

    name = "wiring"
    threshold = 2.5
    place: ClassVar[int] = 9
    velocities_in_time = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Try the readings one after the other, each with those found before."""
        if robot is None or not have_joints(logs, robot.joints):
            return None
        length = 1 + max(ROWS, round(LENGTH_S / float(np.median([log.info.sample_period_s for log in logs]))))
        pieces = Pieces.of(logs, robot, spread_starts(logs, length, PIECES), length)
        if not pieces.logs or not (tells := telling(pieces, robot)).any():
            return None
        first = judged(pieces, as_logged)
        best = first
        found: list[Reading] = []
        rivals: list[str] = []
        few = pieces.some(FIRST_LOOK)
        while len(found) < MOST_READINGS and (doubt := tells & (np.median(best.by_log, axis=0) > UNEXPLAINED)).any():
            doubtful = [robot.joints[k] for k in np.flatnonzero(doubt)]
            before = chain(found)
            by_few = judged(few, before)
            tried = [
                (reading, judged(pieces, chain([*found, reading])))
                for reading in readings(robot, [before(log) for log in pieces.logs], doubtful)
                if gain(by_few, judged(few, chain([*found, reading])), reading, robot, tells) > np.log(threshold) / 2
            ]
            gains = [gain(best, of, reading, robot, tells) for reading, of in tried]
            if not gains or max(gains) < np.log(threshold):
                break
            totals = [
                total(best, of, tells) if gains[k] >= np.log(threshold) else -np.inf for k, (_, of) in enumerate(tried)
            ]
            at = int(np.argmax(totals))
            rivals += [
                reading.says
                for k, (reading, _) in enumerate(tried)
                if k != at and totals[k] > totals[at] + np.log(AS_GOOD)
            ]
            found, best = [*found, tried[at][0]], tried[at][1]
        smaller = size(first, tells) / max(size(best, tells), np.finfo(float).tiny)
        per_log = dict(
            zip(dict.fromkeys(pieces.of_log), (float(size_of(own, tells)) for own in first.by_log), strict=True)
        )
        if not found:
            says = "no other sign, unit or order of the joints' columns fits the model better"
            return CheckResult(self.name, True, 1.0, threshold, says, per_log)
        says = f"read as {' and '.join(reading.says for reading in found)}, the gap is {smaller:.2g} times smaller"
        says += f" (or {'; '.join(rivals)})" if rivals else ""
        return CheckResult(self.name, False, float(smaller), threshold, says, per_log)


def chain(found: Sequence[Reading]) -> Callable[[Log], Log]:
    """Several readings one after the other."""

    def read(log: Log) -> Log:
        for reading in found:
            log = reading.read(log)
        return log

    return read


def telling(pieces: Pieces, robot: Robot) -> np.ndarray:
    """Whether each joint departs from even motion visibly, bool, (joints,)."""
    return np.sqrt((pieces.moved**2).mean(axis=(0, 1))) > SEEN * pieces.resolved


def judged(pieces: Pieces, read: Callable[[Log], Log]) -> Judged:
    """The errors of replays by a reading."""
    simulated, measured = pieces.motions(read)
    moved = np.stack([departure(read(log), pieces.robot) for log in pieces.logs])
    wrong = np.nan_to_num((simulated - measured) ** 2, nan=1e6, posinf=1e6).mean(axis=1)
    square = (moved**2).mean(axis=1)
    names = np.array(pieces.of_log)
    of_logs = [names == name for name in dict.fromkeys(pieces.of_log)]
    by_log = [missed_of(wrong[own], square[own]) for own in of_logs]
    return Judged(missed_of(wrong, square), np.array(by_log))


def missed_of(wrong: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Root mean square of errors over that of motions, (joints,), from mean squares (pieces, joints)."""
    return np.asarray(np.sqrt(wrong.sum(axis=0) / np.maximum(square.sum(axis=0), STILL**2)))


def logs_of(missed: np.ndarray) -> np.ndarray:
    """Logarithms of shares, of any shape, that may be zero."""
    return np.asarray(np.log(np.maximum(missed, np.finfo(float).tiny)))


def total(before: Judged, after: Judged, tells: np.ndarray) -> float:
    """Sum over joints of the logarithms of how many times less is missed."""
    return float((logs_of(before.missed) - logs_of(after.missed))[tells].sum())


def gain(before: Judged, after: Judged, reading: Reading, robot: Robot, tells: np.ndarray) -> float:
    """Logarithm of how many times less is missed of the joints that a reading concerns; that of the worst log, if less.

    Joints that it does not concern may not come off much worse.
    """
    own = np.array([joint in reading.joints for joint in robot.joints]) & tells
    if not own.any():
        return 0.0
    ratio = logs_of(before.missed) - logs_of(after.missed)
    of_logs = (logs_of(before.by_log) - logs_of(after.by_log))[:, own].mean(axis=1)
    others = float(np.minimum(ratio[tells & ~own], 0.0).sum())
    return float(min(ratio[own].mean(), 2 * np.median(of_logs), 4 * of_logs.min())) + others


def size(of: Judged, tells: np.ndarray) -> float:
    """Root mean square of what is missed of the joints that tell something."""
    return size_of(of.missed, tells)


def size_of(missed: np.ndarray, tells: np.ndarray) -> float:
    """Root mean square of what is missed, (joints,), of those that tell something."""
    return float(np.sqrt(np.mean(missed[tells] ** 2)))
