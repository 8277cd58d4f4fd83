"""One long log cut into several, so that a cause can be judged on parts that it was not fitted on."""

from collections.abc import Sequence
from dataclasses import replace

from leapgap.logs.log import Log
from leapgap.logs.segments import ROUNDING_S, Segment

PARTS = 8
"""Number of parts that a single log is cut into."""
SHORTEST_S = 0.5
"""A log is cut into fewer parts if they would be shorter than this."""


def at_least_two(logs: Sequence[Log]) -> list[Log]:
    """The logs; a single one is cut into parts, if it is long enough for two."""
    if len(logs) != 1:
        return list(logs)
    (log,) = logs
    parts = min(PARTS, int(float(log.time[-1]) / SHORTEST_S))
    return cut(log, parts) if parts >= 2 else [log]


def cut(log: Log, parts: int) -> list[Log]:
    """Equal parts of a log, each with a time that begins at 0; named by the log and a number."""
    rows = len(log) // parts
    ends = [*((k + 1) * rows for k in range(parts - 1)), len(log)]
    return [rows_between(log, k * rows, end, f"{log.name}_{k + 1}") for k, end in enumerate(ends)]


def rows_between(log: Log, begin: int, end: int, name: str) -> Log:
    """Some rows of a log, by another name and with a time that begins at 0; ``end`` is the row after the last.

    Its arrays are copies, so that those of a long log can go.
    """
    columns = {column: values[begin:end].copy() for column, values in log.columns.items()}
    start, stop = float(log.time[begin]), float(log.time[end - 1])
    columns["time"] -= start
    return Log(name, columns, replace(log.info, stated_segments=segments_between(log, start, stop)))


def segments_between(log: Log, start_s: float, stop_s: float) -> tuple[Segment, ...]:
    """What of a log's segments lies between two times, by the time since the first of them.

    Phases of a jump that follow from its schedule are stated, since the schedule counts from the first row.
    """
    return tuple(
        Segment(one.name, max(one.begin_s, start_s) - start_s, min(one.end_s, stop_s) - start_s)
        for one in log.info.segments
        if min(one.end_s, stop_s) - max(one.begin_s, start_s) > ROUNDING_S
    )
