"""The clock of a table, and what cuts it at gaps."""

import numpy as np

from leapgap.logs.importers.units import UNITS
from leapgap.logs.map_proposal.names import time_columns
from leapgap.logs.map_proposal.physics import unit_of_time
from leapgap.logs.map_proposal.proposal import GUESSED, MISSING, SURE, Evidence, Proposal

LONG_GAP = 20
"""A step of the clock that is so many times the median one is a gap."""
MOST_STATES = 10
"""A column with more values than that is no flag."""


def find_time(columns: list[str], evidence: Evidence, proposal: Proposal) -> None:
    """The clock: named so, increasing, and with the steps of a loop in one of its units."""
    for column in time_columns(columns):
        instants = evidence.table.instants(column)
        unit = unit_of_time(instants)
        if unit is None:
            continue
        proposal.put("columns", "time", column)
        if unit != "s":
            proposal.put("units", "time", unit)
        evidence.time = instants * UNITS["s"][unit]
        step, back = np.diff(evidence.time), int((np.diff(instants) <= 0).sum())
        longest = f"median {1e3 * np.median(step):.4g}, longest {1e3 * step.max():.4g}"
        proposal.say(SURE, f"time is {column} in {unit}: steps of {1e3 * step.mean():.4g} ms on average ({longest})")
        find_gaps(columns, evidence, proposal)
        if back:
            proposal.options["repeated_times"] = "drop"
            proposal.say(GUESSED, f"{back} time stamps repeat or run back; their rows are dropped")
        return
    proposal.say(MISSING, "a column with time stamps: map columns.time, or state period_s if the rows are even")


def find_gaps(columns: list[str], evidence: Evidence, proposal: Proposal) -> None:
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
