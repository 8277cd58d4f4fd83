"""Set points that stand for several rows of a log: for how many, and what they are on straight lines between."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.log import Log

FEWEST = 8
"""Changes of set points from which on they are said to stand for some rows."""
REGULAR = 0.8
"""Share of the changes that must come after the usual number of rows, or one more or fewer."""
SENT = ("cmd_pos/", "cmd_vel/", "cmd_tau/")
"""Columns that a controller may interpolate."""


@dataclass(frozen=True)
class Hold:
    """How long the set points of a log stand."""

    rows: int
    changes: np.ndarray
    """Rows in which any of them changes, and the first."""


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

    ``late``: to each from the one before, as a controller does that does not know the next one.
    """
    hold = hold_of(log)
    if hold is None:
        return log
    knots = log.time[hold.changes]

    def line(values: np.ndarray) -> np.ndarray:
        own = values[hold.changes]
        return np.interp(log.time, knots, np.concatenate([own[:1], own[:-1]]) if late else own)

    sent = [name for name in log.columns if name.startswith(SENT) and stands(log[name], hold.changes)]
    return replace(log, columns={**log.columns, **{name: line(log[name]) for name in sent}})


def stands(values: np.ndarray, changes: Sequence[int] | np.ndarray) -> bool:
    """Whether a column moves, and changes in these rows alone."""
    changed = np.flatnonzero(np.diff(values)) + 1
    return len(changed) > 0 and bool(np.isin(changed, changes).all())
