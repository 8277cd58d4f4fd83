"""The clock of a log: its time stamps against a stated period, stamps that do not increase, joining."""

import numpy as np

from leapgap.errors import InputError

PERIOD_TOLERANCE = 0.02  # a stated period that differs by more from the mean step of the time stamps is refused


def mean_period(time: np.ndarray) -> float:
    """Mean step of the time stamps, s, to 1 ns: what ``sample_period_s`` states; 0 where there is one row."""
    return round(float(time[-1] - time[0]) / (len(time) - 1), 9) if len(time) > 1 else 0.0


def check_period(where: object, time: np.ndarray, stated_s: float) -> None:
    """``InputError`` where the mean step of the time stamps is not the period that somebody stated."""
    mean = mean_period(time)
    if mean > 0 and abs(stated_s / mean - 1) > PERIOD_TOLERANCE:
        expected = f"the stated period of {stated_s:g} s, within {PERIOD_TOLERANCE:.0%}"
        do = "correct the unit of the time or the period, or leave the period out: the time stamps are the clock"
        raise InputError(f"{where}, time", f"steps of {mean:g} s on average", expected, do)


def increasing_rows(time: np.ndarray) -> np.ndarray:
    """Whether each row is later than all rows before it, bool, (rows,)."""
    latest = np.fmax.accumulate(time)  # no number is later than none
    return np.concatenate([[True], time[1:] > latest[:-1]])


def held_at(instants: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The last value at or before each instant, as a robot keeps a command; the first value before the first row."""
    return values[np.clip(np.searchsorted(time, instants + 1e-9, "right") - 1, 0, len(time) - 1)]
