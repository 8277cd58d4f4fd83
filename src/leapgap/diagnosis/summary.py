"""Summary of a diagnosis: causes with their numbers, one sentence, the next experiment, and missing columns."""

from collections.abc import Sequence

import numpy as np

from leapgap import effects
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.channels import is_logged, state_channels
from leapgap.diagnosis.engine.verdict import Conclusion, Judgement
from leapgap.diagnosis.gap import SIGMAS, HeldOutFigures, Interval
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.report import Cause, ParameterEstimate

MOST_SAID = 4  # The sentence names so many causes at most; all stand in the table below it
NOTICEABLE = 0.05  # Smallest share of the gap that is stated as a percentage
FAR = 4.0  # Times what noise makes of whole logs from which a gap without a cause is told apart from noise


def causes_of(
    judgement: Judgement, figures: Sequence[HeldOutFigures], logs: Sequence[str], model_error: float
) -> list[Cause]:
    """Selected effects, then their confusable alternatives, then all single effects, by probability.

    ``figures`` are those of the conclusion's steps, then of the judgement's others. ``model_error`` as in ``Settings``.
    """
    conclusion, others = judgement.conclusion, judgement.others
    causes = [
        cause_of(judgement.selected, k, sure, names[1:], own, logs, model_error)
        for k, (names, sure, own) in enumerate(
            zip(conclusion.answer, conclusion.probabilities, figures[: len(conclusion.steps)], strict=True)
        )
    ]
    alone = [
        cause_of(fit, -1, sure, (), own, logs, model_error)
        for (fit, sure), own in zip(others, figures[len(conclusion.steps) :], strict=True)
    ]
    return causes + sorted(alone, key=lambda cause: -cause.probability)


def cause_of(
    fit: Candidate,
    which: int,
    sure: float,
    rivals: tuple[str, ...],
    figures: HeldOutFigures,
    logs: Sequence[str],
    model_error: float,
) -> Cause:
    """One hypothesis of a fit as a cause of the report; ``figures`` are those of the fit."""
    hypothesis, numbers = fit.hypotheses[which], fit.split()[which]
    half = SIGMAS * fit.split(fit.spread(model_error))[which]

    parameters = {}
    for p in hypothesis.effect_parameters:
        ends = sorted(hypothesis.typical_value(p.name, numbers + side * half, logs) for side in (-1, 1))
        value, at_bound = hypothesis.typical_value(p.name, numbers, logs), hypothesis.at_bound(numbers)
        parameters[p.name] = ParameterEstimate(value, (ends[0], ends[1]), p.nominal, p.unit, at_bound)
    per_log = {} if hypothesis.per_log is None else {log: hypothesis.values(log, numbers) for log in logs}
    return Cause(hypothesis.name, hypothesis.location, sure, parameters, per_log, figures.closure, figures.gap, rivals)


def sentence(
    conclusion: Conclusion,
    selected: Candidate,
    nominal: float,
    floor: float,
    corrected: HeldOutFigures,
    logs: Sequence[str],
) -> str:
    """The report in one sentence, with numbers; ``floor`` is the gap that noise alone makes of whole logs."""
    verdict, answer, closes = conclusion.verdict, conclusion.answer, corrected.closure
    if verdict == "none" and nominal > FAR * floor:
        return (
            f"These {len(logs)} logs show no fault of the robot: in short replays the simulation agrees with them "
            "within sensor noise, model tolerances and the errors of contacts and time steps. Over whole logs these "
            f"add up to a gap of {brief(nominal)}; noise alone makes {brief(floor)}."
        )
    if verdict == "none":
        return (
            f"The simulation agrees with the {len(logs)} logs within sensor noise and model tolerances "
            f"(gap {brief(nominal)})."
        )
    if not answer:
        return (
            f"No known effect explains the gap of {brief(nominal)} on held-out logs; the report shows where the error "
            "arises."
        )
    parts = [
        f"{effects.describe(h.kind)} ({describe_estimate(h, numbers, logs)})"
        + (f", which cannot be separated from {' and '.join(few_names(names[1:]))}," if names[1:] else "")
        for h, numbers, names in zip(selected.hypotheses, selected.split(), answer, strict=True)
    ]
    if len(parts) > MOST_SAID:
        parts = [*parts[: MOST_SAID - 1], f"{len(parts) - MOST_SAID + 1} further causes"]
    if closes.value < NOTICEABLE:
        return (
            f"{listed(parts)} show{'' if len(parts) > 1 else 's'} in replays of short segments, but too weakly to "
            f"reduce the gap of whole logs, which remains {brief(nominal)}."
        )
    left = "is unexplained" if verdict == "partly" else "remains"
    rest = f"; {100 * (1 - closes.value):.0f} % of the gap {left}" if closes.value < 0.9 else ""
    return (
        f"{listed(parts)} explain{'' if len(parts) > 1 else 's'} {share_in_words(closes)} on held-out logs: "
        f"it falls from {brief(nominal)} to {brief(corrected.gap)}{rest}."
    )


def listed(parts: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``; a part may end with a comma."""
    first = ", ".join([*(part.removesuffix(",") for part in parts[:-2]), *parts[-2:-1]])
    return " and ".join([first, parts[-1]] if len(parts) > 1 else parts)


def brief(gap: float) -> str:
    """A gap with as many digits as it needs: ``0.94``, ``0.0042``."""
    return f"{gap:.2f}" if gap >= 0.1 else f"{gap:.2g}"


def share_in_words(closes: Interval) -> str:
    """A share of the gap with its interval: per cent, or ``all`` where the value rounds to 100."""
    share = closes.capped_at_one
    value, low, high = (f"{100 * part:.0f}" for part in (share.value, share.low, share.high))
    if value != "100":
        return f"{value} % (95 %: {low} to {high}) of the gap"
    return "all of the gap" if low == "100" else f"all of the gap (95 %: {low} % or more)"


def describe_estimate(hypothesis: Hypothesis, numbers: np.ndarray, logs: Sequence[str]) -> str:
    """``joint_damping at RR: damping 0.4 N·m·s/rad``; the median and range where values differ by log."""
    of_logs = [hypothesis.values(log, numbers) for log in logs]
    units, sizes = {p.name: f" {p.unit}" for p in hypothesis.effect_parameters if p.unit != "1"}, []
    for name in of_logs[0]:
        values = [of[name] for of in of_logs]
        by_log = f", {min(values):.3g} to {max(values):.3g} by log" if hypothesis.per_log else ""
        sizes.append(f"{name} {np.median(values):.3g}{units.get(name, '')}{by_log}")
    return f"{hypothesis.label}: {', '.join(sizes)}"


def not_judged(judged: JudgedLogs) -> list[str]:
    """What could not be judged, in words: columns that some log lacks, and rows that are left out."""
    robot, logs = judged.robot, [states.log for states in judged.whole]
    wanted = [channel.name for channel in state_channels(robot) if channel.name.startswith("base_")]
    wanted += [f"{quantity}/{joint}" for quantity in ("joint_pos", "joint_vel", "tau") for joint in robot.joints[:1]]
    wanted += ["imu_acc_z", "supply_voltage"]
    lacking = [name for name in wanted if not all(is_logged(log, name) for log in logs)]
    meaning = {
        "tau": "the torque the motors delivered",
        "base_angvel_x": "roll rate (taken as zero at the start)",
        "base_angvel_z": "yaw rate (taken as zero at the start)",
        "imu_acc_z": "the IMU's accelerations",
        "supply_voltage": "sag of the supply",
    }
    named = [meaning.get(name.split("/")[0], name.split("/")[0]) for name in lacking]
    fitted = {quantity for states in judged.whole for quantity in states.fitted}
    started = [f"{quantity} (at the start of replays from a fit through the positions)" for quantity in sorted(fitted)]
    estimated = {quantity for states in judged.whole for quantity in states.estimated}
    if estimated:
        moves = " and velocity" if "base_linvel" in estimated else ""
        started.append(f"base position{moves} (at the start of replays, from planted feet and attitude)")
        fitted |= estimated
    plain = [name for name in named if not any(name.startswith(quantity) for quantity in fitted)]
    return [*dict.fromkeys([*plain, *started]), *judged.sensors.notes, *rows_left_out(judged)]


def rows_left_out(judged: JudgedLogs) -> list[str]:
    """One line on the rows after those that are judged; nothing where all are."""
    times = [states.log.time for states in judged.whole]
    ends = [time[-1] - time[rows - 1] for time, rows in zip(times, judged.rows, strict=True)]
    if max(ends) <= 0:
        return []
    span = " to ".join(sorted({f"{one:.2f}" for one in (min(ends), max(ends))}, key=float))
    return [f"the last {span} s of the logs, after touch-down or a change of gains"]


def few_names(names: Sequence[str]) -> Sequence[str]:
    """The likeliest of some rivals, and how many more there are."""
    return names if len(names) <= MOST_SAID else (*names[: MOST_SAID - 1], f"{len(names) - MOST_SAID + 1} others")
