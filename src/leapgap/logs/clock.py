"""The clock of a log: its time stamps against a stated period, stamps that do not increase, an even clock, joining."""

import numpy as np

from leapgap.errors import InputError

PERIOD_TOLERANCE = 0.02
"""A stated period that differs by more from the mean step of the time stamps is refused."""


def mean_period(time: np.ndarray) -> float:
    """Mean step of the time stamps, s, to 1 ns: what ``sample_period_s`` states; 0 where there is one row."""
    return round(float(time[-1] - time[0]) / (len(time) - 1), 9) if len(time) > 1 else 0.0


def check_period(where: object, time: np.ndarray, stated_s: float) -> None:
    """``InputError`` where the mean step of the time stamps is not the period that somebody stated."""
    mean = mean_period(time)
    if mean > 0 and abs(stated_s / mean - 1) > PERIOD_TOLERANCE:
        raise InputError(
            f"{where}, time",
            f"steps of {mean:g} s on average",
            f"the stated period of {stated_s:g} s, within {PERIOD_TOLERANCE:.0%}",
            "correct the unit of the time or the period, or leave the period out: the time stamps are the clock",
        )


def increasing_rows(time: np.ndarray) -> np.ndarray:
    """Whether each row is later than all rows before it, bool, (rows,)."""
    latest = np.maximum.accumulate(time)
    return np.concatenate([[True], time[1:] > latest[:-1]])


def even_clock(time: np.ndarray, period_s: float) -> np.ndarray:
    """Instants one period apart, from the first row to at most the last."""
    return time[0] + period_s * np.arange(int(np.floor((time[-1] - time[0]) / period_s + 1e-6)) + 1)


def held_at(instants: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The last value at or before each instant, as a robot keeps a command; the first value before the first row."""
    return values[np.clip(np.searchsorted(time, instants + 1e-9, "right") - 1, 0, len(time) - 1)]


def interpolated_at(instants: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Measured values (rows,) between the rows beside each instant, on a straight line."""
    return np.interp(instants, time, values)


EVEN = 1e-3
"""Largest departure of a row's length from the sample period, as a share of it, that counts as none."""


def is_even(time: np.ndarray, period_s: float) -> bool:
    """Whether every row lasts one sample period."""
    return bool(np.abs(np.diff(time) - period_s).max() <= EVEN * period_s)


TICKS_S = (0.001, 0.0005, 0.00025)
"""Steps of other people's simulations that rows of uneven length may be whole multiples of, s, longest first."""


def whole_tick(time: np.ndarray) -> float | None:
    """The longest of some usual steps of which every row of uneven length lasts a whole number, s; None: of none."""
    lengths = np.diff(time)
    whole = (tick for tick in TICKS_S if (np.abs(lengths / tick - np.round(lengths / tick)) < 1e-6).all())
    return next(whole, None)


def row_lengths(time: np.ndarray, period_s: float) -> np.ndarray:
    """How long each row lasted by the log's own time, in sample periods, (rows,); the last one as a mean row."""
    if is_even(time, period_s):
        return np.ones(len(time))
    return np.append(np.diff(time) / period_s, 1.0)
