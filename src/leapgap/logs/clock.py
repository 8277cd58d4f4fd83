"""The clock of a log: how long each row lasted, by its times."""

import numpy as np

from leapgap.logs.log import Log

EVEN = 1e-3
"""Largest departure of a row's length from the sample period, as a share of it, that counts as none."""


def is_even(log: Log) -> bool:
    """Whether every row lasts one sample period."""
    steps = np.diff(log.time)
    return bool(np.abs(steps - log.info.sample_period_s).max() <= EVEN * log.info.sample_period_s)


def row_lengths(log: Log) -> np.ndarray:
    """How long each row lasted by the log's own time, in sample periods, (rows,); the last one as a mean row."""
    if is_even(log):
        return np.ones(len(log))
    return np.append(np.diff(log.time) / log.info.sample_period_s, 1.0)
