"""A log on an even clock: measurements on straight lines between its rows, commands held as the robot held them."""

from dataclasses import replace

import numpy as np

from leapgap.logs.clock import even_clock, held_at, interpolated_at
from leapgap.logs.files import check_values_fit
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_QUATERNION, COMMANDS

HELD = (*COMMANDS, "contact")
"""Quantities that keep their value between two rows."""


def on_even_clock(log: Log, period_s: float) -> Log:
    """The log in rows one period apart; its source says so."""
    check_values_fit(
        f"{log.name} in rows of {period_s:g} s", (log.time[-1] - log.time[0]) / period_s * len(log.columns)
    )
    instants = even_clock(log.time, period_s)
    columns: dict[str, np.ndarray] = {}
    for name, values in log.columns.items():
        at = held_at if name.partition("/")[0] in HELD else interpolated_at
        columns[name] = at(instants, log.time, values)
    columns["time"] = instants
    if BASE_QUATERNION[0] in log:
        turn = log.stack(BASE_QUATERNION)
        between = np.stack([interpolated_at(instants, log.time, one) for one in turn.T], axis=1)
        columns |= zip(BASE_QUATERNION, (between / np.linalg.norm(between, axis=1, keepdims=True)).T, strict=True)
    source = f"{log.info.source}; resampled to {period_s:g} s"
    return replace(log, columns=columns, info=replace(log.info, sample_period_s=period_s, source=source))
