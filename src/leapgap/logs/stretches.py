"""Stretches of many or long logs: a diagnosis takes what it can use, spread evenly, and says so.

A diagnosis of ten minutes learns no more from each second than one of one minute, but takes ten times as long.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log

MOST_ROWS, MOST_S = 60_000, 120.0
"""Number of rows, and time, of all logs together up to which all are diagnosed: 40 jumps, or a minute at 1 kHz."""
STRETCH_S = 5.0
"""Length of the stretches of a log that is longer; a shorter log is one stretch."""
LEAST_STRETCHES = 2


@dataclass(frozen=True)
class Stretch:
    """Some rows of a log that follow each other."""

    log: Log
    begin: int
    end: int

    @property
    def rows(self) -> int:
        """Number of its rows."""
        return self.end - self.begin

    @property
    def is_whole(self) -> bool:
        """Whether it is the whole log."""
        return self.rows == len(self.log)

    def cut(self) -> Log:
        """A log of its own, whose time begins at 0."""
        if self.is_whole:
            return self.log
        return rows_between(self.log, self.begin, self.end, f"{self.log.name}_at_{self.log.time[self.begin]:.0f}_s")


def stretches_of(log: Log) -> list[Stretch]:
    """A log as stretches of equal length, none shorter than ``STRETCH_S``."""
    length_s = float(log.time[-1] - log.time[0]) * len(log) / (len(log) - 1)  # with the period of the last row
    number = max(1, int(length_s / STRETCH_S + 1e-6))
    edges = [i * len(log) // number for i in range(number + 1)]
    return [Stretch(log, begin, end) for begin, end in itertools.pairwise(edges)]


def choose_stretches(logs: Sequence[Log], most_rows: int | None = None) -> tuple[list[Log], tuple[str, ...]]:
    """The logs, or stretches of them with no more than about ``most_rows`` rows, and a sentence on what is left out.

    By default ``MOST_ROWS``, and no more than about ``MOST_S``. Long logs are cut into stretches of ``STRETCH_S``; of
    these and of short logs, in their order, every n-th is taken.
    """
    most_rows = MOST_ROWS if most_rows is None else most_rows
    total, whole_s = sum(len(log) for log in logs), sum(log.time[-1] - log.time[0] for log in logs)
    share = min(most_rows / total, MOST_S / whole_s)
    if share >= 1:
        return list(logs), ()
    every = [stretch for log in logs for stretch in stretches_of(log)]
    number = min(len(every), max(LEAST_STRETCHES, int(share * len(every))))
    chosen = [every[i * len(every) // number] for i in range(number)]
    return [stretch.cut() for stretch in chosen], (left_out(chosen, every, len(logs), total),)


def left_out(chosen: Sequence[Stretch], every: Sequence[Stretch], logs: int, total: int) -> str:
    """The sentence on what a diagnosis leaves out."""
    kind = "logs" if all(stretch.is_whole for stretch in every) else f"stretches of {STRETCH_S:g} s and more"
    rows = sum(stretch.rows for stretch in chosen)
    return (
        f"{len(chosen)} of {len(every)} {kind}, spread evenly over {logs} logs, were diagnosed "
        f"({rows} of {total} samples): more would take longer and change little"
    )
