"""Set points that stand for several rows of a log: for how many, and what they are on straight lines between."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.log import Log

FEWEST = 8  # changes of set points from which on they are said to stand for some rows
REGULAR = 0.8  # share of the changes that must come after the usual number of rows, or one more or fewer
SAME_MOTION = 0.2  # set points of positions and velocities are of one motion where they differ by a smaller share of it
SENT = ("cmd_pos/", "cmd_vel/", "cmd_tau/")  # columns that a controller may interpolate


@dataclass(frozen=True)
class Hold:
    """How long the set points of a log stand."""

    rows: int
    changes: np.ndarray  # rows in which any of them changes, and the first


def hold_of(log: Log) -> Hold | None:
    """For how many rows the set points stand; None where they change from row to row, rarely, or at odd times."""
    joints = [joint for joint in log.joints if log[f"cmd_kp/{joint}"].any()]
    if not joints:
        return None
    changed = (np.diff(log.per_joint("cmd_pos", tuple(joints)), axis=0) != 0).any(axis=1)
    changes = np.concatenate([[0], np.flatnonzero(changed) + 1])
    if len(changes) <= FEWEST:
        return None
    gaps = np.diff(changes[1:])
    usual = int(np.median(gaps))
    regular = np.mean(np.abs(gaps - usual) <= 1)
    return Hold(usual, changes) if usual >= 2 and regular >= REGULAR else None


def on_lines(log: Log, late: bool = False) -> Log:
    """The log with set points on straight lines from each to the next, where they stand for several rows.

    Positions whose velocities are sent too are on cubics with both, as a trajectory has them. ``late``: to each from
    the one before, as a controller does that does not know the next one.
    """
    hold = hold_of(log)
    if hold is None:
        return log
    from scipy.interpolate import CubicHermiteSpline  # half a second, for such logs alone

    knots = log.time[hold.changes]

    def own(values: np.ndarray) -> np.ndarray:
        at_knots = values[hold.changes]
        return np.concatenate([at_knots[:1], at_knots[:-1]]) if late else at_knots

    sent = [name for name in log.columns if name.startswith(SENT) and stands(log[name], hold.changes)]
    columns = {name: np.interp(log.time, knots, own(log[name])) for name in sent}
    for joint in log.joints:
        position, velocity = f"cmd_pos/{joint}", f"cmd_vel/{joint}"
        if {position, velocity} <= columns.keys() and goes_with(
            knots, *(log[of][hold.changes] for of in (position, velocity))
        ):
            cubic = CubicHermiteSpline(knots, own(log[position]), own(log[velocity]))
            within = np.clip(log.time, knots[0], knots[-1])  # the last ones stay
            columns |= {position: cubic(within), velocity: cubic(within, 1)}
    return replace(log, columns={**log.columns, **columns})


def goes_with(time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> bool:
    """Whether positions, (points,), move as their velocities say."""
    moved = np.diff(position)
    off = moved - np.diff(time) * (velocity[1:] + velocity[:-1]) / 2
    return bool((off**2).sum() < SAME_MOTION**2 * (moved**2).sum())


def stands(values: np.ndarray, changes: Sequence[int] | np.ndarray) -> bool:
    """Whether a column moves, and changes in these rows alone."""
    changed = np.flatnonzero(np.diff(values)) + 1
    return len(changed) > 0 and bool(np.isin(changed, changes).all())
