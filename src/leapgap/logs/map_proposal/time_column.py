"""The clock of a table, and what cuts it at gaps."""

from collections.abc import Sequence

import numpy as np

from leapgap.logs.clock import PERIOD_TOLERANCE
from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.names import NANOSECONDS, SECONDS, time_columns, words
from leapgap.logs.map_proposal.proposal import GUESSED, MISSING, SURE, Evidence, Proposal
from leapgap.logs.map_proposal.unit_readings import UnitReading

STEPS = (1e-4, 0.5)
"""Periods of loops of robots, s: what a unit of time must give."""
TIME_UNITS = ("s", "ms", "us", "ns")
LONG_GAP = 20
"""A step of the clock that is so many times the median one is a gap."""
MOST_STATES = 10
"""A column with more values than that is no flag."""


def find_time(columns: Sequence[str], evidence: Evidence, proposal: Proposal) -> None:
    """The clock: named so, increasing, and with the steps of a loop in some unit; else a column of steps.

    Seconds and nanoseconds in two columns, as stamps of ROS have them, are one clock.
    """
    if pair := seconds_and_nanoseconds(columns):
        whole, rest = (evidence.table.instants(column) for column in pair)
        instants = whole + 1e-9 * rest
        if units := units_of_time(instants, "s", evidence.stated.get("period_s")):
            proposal.put("columns", "time", {pair[0]: 1, pair[1]: 1e-9})
            evidence.instants, evidence.time_units = instants, units[:1]
            return
    for column in time_columns(columns):
        instants = evidence.table.instants(column)
        units = units_of_time(instants, column, evidence.stated.get("period_s"))
        if units:
            proposal.put("columns", "time", column)
            evidence.instants, evidence.time_units = instants, units
            return
    for column in columns:
        steps = evidence.table.numbers(column)
        if "dt" in words(column) and len(steps) and (steps > 0).all():
            find_steps(column, steps, evidence, proposal)
            return
    for name, array in evidence.table.arrays.items():
        if array.size == 1 and array.dtype.kind in "biuf" and "dt" in words(name) and array.item() > 0:
            find_steps(name, np.full(evidence.table.rows, float(array.item())), evidence, proposal)
            return
    proposal.say(MISSING, "a column with time stamps: map columns.time, or state period_s if the rows are even")


def seconds_and_nanoseconds(columns: Sequence[str]) -> tuple[str, str] | None:
    """Two columns that hold whole seconds and the rest in nanoseconds, by their names; None without such."""
    by_words = {tuple(words(column)): column for column in columns}
    for said, column in by_words.items():
        rests = [by_words[*said[:-1], one] for one in NANOSECONDS if (*said[:-1], one) in by_words]
        if said and said[-1] in SECONDS and rests:
            return column, rests[0]
    return None


def units_of_time(instants: np.ndarray, column: str, period_s: float | None) -> list[str]:
    """The units in which the steps of a clock may be those of a robot's loop, the one in its name first.

    None where the column is no clock. A period that the file states leaves one.
    """
    steps = np.diff(instants)
    if len(steps) < 2 or not np.isfinite(steps).all() or np.mean(steps > 0) < 0.99:
        return []
    step = float(np.median(steps))
    found = [unit for unit in TIME_UNITS if STEPS[0] <= step * UNITS["s"][unit] <= STEPS[1]]
    if period_s is not None:
        mean = float(np.mean(steps))
        agree = [one for one in found if abs(mean * UNITS["s"][one] / period_s - 1) < PERIOD_TOLERANCE]
        found = agree or found
    return sorted(found, key=lambda unit: unit not in words(column))


def is_counter(instants: np.ndarray) -> bool:
    """Whether a clock counts up by one: it may count rows, of any length."""
    return bool((np.diff(instants) == 1).all())


def find_steps(column: str, steps: np.ndarray, evidence: Evidence, proposal: Proposal) -> None:
    """A column with the length of each step: a period where it is one number, else what the time is the sum of."""
    unit = next((one for one in TIME_UNITS if STEPS[0] <= np.median(steps) * UNITS["s"][one] <= STEPS[1]), None)
    if unit is None:
        proposal.say(MISSING, f"a time: {column} has steps of {np.median(steps):.3g}; state period_s")
        return
    evidence.instants, evidence.time_units = np.concatenate([[0.0], np.cumsum(steps[:-1])]), [unit]
    if np.ptp(steps) == 0:
        proposal.options["period_s"] = float(f"{steps[0] * UNITS['s'][unit]:.12g}")
    else:
        proposal.options["steps"] = column
    proposal.say(GUESSED, f"the spacing of the samples is {column}")


def judge_time(columns: Sequence[str], reading: UnitReading | None, evidence: Evidence, proposal: Proposal) -> None:
    """The unit of the clock, with those of the positions and velocities that go with it."""
    if evidence.instants is None:
        return
    unit = reading.time if reading and reading.time else evidence.time_units[0]
    column = proposal.options.get("columns", {}).get("time")
    evidence.time = evidence.instants * UNITS["s"][unit]
    step, back = np.diff(evidence.time), int((np.diff(evidence.instants) <= 0).sum())
    if unit != "s" and "period_s" not in proposal.options:
        proposal.put("units", "time", unit)
    if column is not None:
        column = column if isinstance(column, str) else " and ".join(column)
        longest = f"median {1e3 * np.median(step):.4g}, longest {1e3 * step.max():.4g}"
        said = f"time is {column} in {unit}: steps of {1e3 * step.mean():.4g} ms on average ({longest})"
        rivals = [one for one in evidence.time_units if one != unit]
        rate_fits = reading is not None and reading.velocity in ("rad/s", "deg/s")
        if is_counter(evidence.instants):
            evidence.time_known = GUESSED
            if not rate_fits:
                proposal.drop("time")
                proposal.say(
                    MISSING,
                    f"the time: {column} counts up by 1, {unit} or rows; state units.time: {unit} with columns.time: "
                    f"{column}, or period_s",
                )
                return
            proposal.say(GUESSED, f"{said}; if it counts rows, state period_s instead")
        elif evidence.time_known == SURE or not rivals:
            evidence.time_known = SURE
            proposal.say(SURE, said)
        else:
            proposal.say(GUESSED, f"{said}; {', '.join(rivals)} would be a loop of a robot as well")
    find_gaps(columns, evidence, proposal)
    if back:
        proposal.options["repeated_times"] = "drop"
        proposal.say(GUESSED, f"{back} time stamps repeat or run back; their rows are dropped")


def find_gaps(columns: Sequence[str], evidence: Evidence, proposal: Proposal) -> None:
    """Long gaps in the time, and a flag that changes where they are, which then cuts the file."""
    assert evidence.time is not None
    step = np.diff(evidence.time)
    gaps = np.flatnonzero(step > LONG_GAP * np.median(step))
    if not len(gaps):
        return
    for column in columns:
        values = evidence.table.numbers(column)
        if not np.isfinite(values).all() or len(np.unique(values)) > MOST_STATES:
            continue
        changes = np.flatnonzero(np.diff(values) != 0)
        if len(changes) and all(np.abs(changes - gap).min() <= 2 for gap in gaps):
            proposal.options["cut_by"] = column
            proposal.say(
                GUESSED, f"{len(gaps)} gaps of up to {step.max():.3g} s where {column} changes: it cuts the file"
            )
            return
    proposal.say(MISSING, f"what cuts the file at {len(gaps)} gaps of up to {step.max():.3g} s: cut_by, or pieces")
