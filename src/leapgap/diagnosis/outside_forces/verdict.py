"""What forces from outside change in a report: its verdict, its sentence, its causes and its gap."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.diagnosis.gap import SIGMAS, HeldOutFigures, HeldOutGap, Interval, closure, headline_gap, motion_squares
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.outside_forces.outside_force import EXTERNAL_PUSH, OutsideForce
from leapgap.diagnosis.outside_forces.search import OutsideForces
from leapgap.diagnosis.report import Cause, ParameterEstimate, ReportContent
from leapgap.diagnosis.summary import brief

IMPULSES = {"N": ("impulse", "N·s"), "N·m": ("angular_impulse", "N·m·s")}
"""Unit of a force → name of its impulse as a parameter, and that one's unit."""
TOLD = 3  # Largest number of forces in the sentence; the others are counted


def with_outside_forces(
    report: ReportContent, outside: OutsideForces, given: JudgedLogs, heldout: HeldOutGap, corrected: HeldOutFigures
) -> ReportContent:
    """A report on logs without forces from outside, as one on the logs as they were ``given``.

    They are the answer's last cause. What is left of the gap without them is told as before: where nothing is, they are
    named; where it has no known cause, they explain the gap partly.
    """
    if not outside.forces:
        return report
    if not outside.logs:
        sentence = f"{forces_in_words(outside.forces)}. {report.sentence}"
        return replace(report, outside_forces=outside.forces, sentence=sentence)
    before, closes = closure_without(outside, given, heldout, corrected.squares)
    push = cause_of(outside.forces, [states.log.name for states in given.whole], closes, report.gap_nominal)
    verdict = {"none": "named", "unknown": "partly"}.get(report.verdict, report.verdict)
    number = len(report.answer)
    return replace(
        report,
        verdict=verdict,
        sentence=sentence_with(report, outside.forces),
        gap_nominal=before,
        answer=(*report.answer, (EXTERNAL_PUSH,)),
        closure_of_answer=closes,
        causes=(*report.causes[:number], push, *report.causes[number:]),
        outside_forces=outside.forces,
    )


def sentence_with(report: ReportContent, forces: Sequence[OutsideForce]) -> str:
    """The report in one sentence or two: the forces, and what the logs without them say."""
    if report.verdict == "none":
        rest = f"without these moments the simulation agrees with the logs (gap {brief(report.gap_nominal)})."
    elif report.verdict == "unknown":
        rest = f"without these moments a gap of {brief(report.gap_nominal)} remains, which no known effect explains."
    else:
        rest = f"without these moments, {report.sentence}"
    return f"{forces_in_words(forces)}; {rest}"


def forces_in_words(forces: Sequence[OutsideForce]) -> str:
    """The largest forces in words, in their order, and the number of the others."""
    largest = sorted(forces, key=lambda one: -abs(one.size))[:TOLD]
    told = "; ".join(one.says for one in forces if one in largest)
    others = len(forces) - len(largest)
    return f"Something pushed the robot: {told}{f'; and {others} more' if others else ''}"


def closure_without(
    outside: OutsideForces, given: JudgedLogs, heldout: HeldOutGap, after: np.ndarray
) -> tuple[float, Interval]:
    """Gap of the logs as they were given, and the share of it that closes without forces from outside.

    ``after`` are the sums of squares of the answer on the logs without them, (parts,).
    """
    judged = heldout.judged
    given = replace(given, channels=judged.channels)
    names = [states.log.name for states in given.whole]
    of_log = np.array([names.index(outside.part_of[log.name]) for log in judged.logs])

    def by_log(values: np.ndarray) -> np.ndarray:
        return np.bincount(of_log, values, minlength=len(names))

    squares = motion_squares(heldout.replayer.motions(given.whole_trials()), given)
    number, quiet = given.value_counts, by_log(judged.value_counts)
    rng = np.random.default_rng(0)
    draws = [one for one in rng.integers(0, len(names), (len(heldout.draws), len(names))) if quiet[one].sum() > 0]
    share = closure(squares, by_log(after), by_log(heldout.floor), quiet, draws, number)
    return headline_gap(squares, given), share


def cause_of(forces: Sequence[OutsideForce], logs: Sequence[str], closes: Interval, gap: float) -> Cause:
    """All forces from outside as one cause; its parameters are the sums of their impulses, whatever their signs.

    ``gap`` is that of the nominal robot without them.
    """
    parameters, per_log = {}, {log: dict[str, float]() for log in logs}
    for unit in dict.fromkeys(one.unit for one in forces):
        name, of_impulse = IMPULSES[unit]
        own = [one for one in forces if one.unit == unit]
        total = sum(abs(one.impulse) for one in own)
        spread = float(np.sqrt(sum(((one.impulse_ci95[1] - one.impulse) / SIGMAS) ** 2 for one in own)))
        interval = (total - SIGMAS * spread, total + SIGMAS * spread)
        parameters[name] = ParameterEstimate(total, interval, 0.0, of_impulse, False)
        for log in logs:
            per_log[log][name] = float(sum(abs(one.impulse) for one in own if one.log == log))
    location = ", ".join(dict.fromkeys(one.at for one in forces))
    return Cause(EXTERNAL_PUSH, location, 1.0, parameters, per_log, closes, gap, ())
