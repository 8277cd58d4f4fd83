"""Logs cut: one long log into several, to judge a cause on parts that it was not fitted on; and of many, stretches.

A diagnosis of ten minutes learns no more from each second than one of one minute, but takes ten times as long.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.logs.clock import held_at
from leapgap.logs.files import check_values_fit
from leapgap.logs.log import Log
from leapgap.logs.metadata import ROUNDING_S, Segment
from leapgap.logs.schema import BASE_QUATERNION, COMMANDS

PARTS = 8  # number of parts that a single log is cut into
SHORTEST_S = 0.5  # a log is cut into fewer parts if they would be shorter than this
MOST_ROWS, MOST_S = 60_000, 60.0
"""Number of rows, and time, of all logs together up to which all are diagnosed: 40 jumps, or a minute at 1 kHz."""
STRETCH_S = 5.0  # length of the stretches of a log that is longer; a shorter log is one stretch
LEAST_STRETCHES = 2


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
    # Phases of a jump that follow from its schedule are stated, since the schedule counts from the first row
    segments = tuple(
        Segment(one.name, max(one.begin_s, start) - start, min(one.end_s, stop) - start)
        for one in log.info.segments
        if min(one.end_s, stop) - max(one.begin_s, start) > ROUNDING_S
    )
    return Log(name, columns, replace(log.info, stated_segments=segments))


def choose_stretches(logs: Sequence[Log]) -> tuple[list[Log], tuple[str, ...]]:
    """The logs, or stretches of them with about ``MOST_ROWS`` and ``MOST_S`` at most; a sentence on what is left out.

    Long logs are cut into stretches of ``STRETCH_S``; of these and of short logs, in their order, every n-th is taken.
    """
    total, whole_s = sum(len(log) for log in logs), sum(log.time[-1] - log.time[0] for log in logs)
    share = min(MOST_ROWS / total, MOST_S / whole_s)
    if share >= 1:
        return list(logs), ()
    every: list[tuple[Log, int, int]] = []  # logs, each with the first row of a stretch and that after its last
    for log in logs:
        length_s = float(log.time[-1] - log.time[0]) * len(log) / (len(log) - 1)  # with the period of the last row
        parts = max(1, int(length_s / STRETCH_S + 1e-6))
        every += [(log, i * len(log) // parts, (i + 1) * len(log) // parts) for i in range(parts)]
    number = min(len(every), max(LEAST_STRETCHES, int(share * len(every))))
    chosen = [every[i * len(every) // number] for i in range(number)]
    are_whole = all(end - begin == len(log) for log, begin, end in every)
    kind = "logs" if are_whole else f"stretches of {STRETCH_S:g} s and more"
    left_out = (
        f"{len(chosen)} of {len(every)} {kind}, spread evenly over {len(logs)} logs, were diagnosed "
        f"({sum(end - begin for _, begin, end in chosen)} of {total} samples): more would take longer and change little"
    )
    found = [
        log if end - begin == len(log) else rows_between(log, begin, end, f"{log.name}_at_{log.time[begin]:.0f}_s")
        for log, begin, end in chosen
    ]
    return found, (left_out,)


HELD = (*COMMANDS, "contact")  # quantities that keep their value between two rows


def on_even_clock(log: Log, period_s: float) -> Log:
    """The log in rows one period apart; its source says so."""
    periods = (log.time[-1] - log.time[0]) / period_s
    check_values_fit(f"{log.name} in rows of {period_s:g} s", periods * len(log.columns))
    instants = log.time[0] + period_s * np.arange(int(np.floor(periods + 1e-6)) + 1)
    columns: dict[str, np.ndarray] = {}
    for name, values in log.columns.items():
        at = held_at if name.partition("/")[0] in HELD else np.interp
        columns[name] = at(instants, log.time, values)
    columns["time"] = instants
    if BASE_QUATERNION[0] in log:
        turn = log.stack(BASE_QUATERNION)
        between = np.stack([np.interp(instants, log.time, one) for one in turn.T], axis=1)
        columns |= zip(BASE_QUATERNION, (between / np.linalg.norm(between, axis=1, keepdims=True)).T, strict=True)
    source = f"{log.info.source}; resampled to {period_s:g} s"
    return replace(log, columns=columns, info=replace(log.info, sample_period_s=period_s, source=source))
