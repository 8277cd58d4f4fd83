"""What an answer may not claim: causes whose numbers are hardly known, and all of a gap where another cause acts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.decision import Conclusion, Judgement, named_or_ambiguous, steps_of
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.joint_fit import JointFit


def with_doubts(judgement: Judgement, fit: JointFit, thresholds: DecisionThresholds) -> Judgement:
    """The judgement without what its answer may not claim."""
    return partly_where_another_acts(without_uncertain(judgement, fit, thresholds), fit, thresholds)


def without_uncertain(judgement: Judgement, fit: JointFit, thresholds: DecisionThresholds) -> Judgement:
    """The judgement without causes whose numbers are hardly known; the best known one stays.

    Beside a large cause, a small one can fit what its simulation, the tolerances of the model or a cause without a name
    leave. What truly acts is known several times better. Where the rest closes clearly less, something acts that is not
    known: the verdict is ``partly``.
    """
    conclusion, selected = judgement.conclusion, judgement.selected
    if not fit.in_parts or len(conclusion.answer) < 2:
        return judgement
    sizes = spreads_from_nominal(selected)
    kept = [k for k, size in enumerate(sizes) if size >= min(thresholds.least_known, max(sizes))]
    if len(kept) == len(sizes):
        return judgement
    names = " and ".join(h.label for k, h in enumerate(selected.hypotheses) if k not in kept)
    fit.notes.append(f"left out, since the logs do not determine its number: {names}")
    at = fit.by_steps_of(selected) or fit
    found = replace(judgement, conclusion=of_causes(conclusion, at, kept))
    closed, closes = (at.judging.closure_value(own) for own in at.judging.squares([selected, found.selected]))
    fit.progress(f"without {names}, whose number is not determined: explains {closes:.2f}, {closed:.2f} before")
    if closed - closes < fit.plan.least_part or closes >= thresholds.enough_jointly:
        return found
    return replace(found, conclusion=replace(found.conclusion, verdict="partly"))


def spreads_from_nominal(candidate: Candidate) -> list[float]:
    """By how many standard deviations of its fit each hypothesis differs from nominal, by its best known number."""
    spread = np.maximum(candidate.spread(), np.finfo(float).tiny)
    return [float(own.max()) for own in candidate.split(np.abs(candidate.departs) / spread)]


def of_causes(conclusion: Conclusion, fit: JointFit, kept: Sequence[int]) -> Conclusion:
    """A conclusion with some of its causes, fitted anew by the steps of the simulation that explain the logs."""
    selected = conclusion.steps[-1]
    hypotheses, numbers = tuple(selected.hypotheses[k] for k in kept), selected.numbers[selected.indices(kept)]
    if fit.judging is fit.heldout_gap:
        again = fit.fit(hypotheses, numbers, fit.plan.steps)
    else:
        again = fit.by_short_steps(hypotheses, numbers)
    answer = tuple(conclusion.answer[k] for k in kept)
    sure = tuple(conclusion.probabilities[k] for k in kept)
    verdict = named_or_ambiguous(answer) if conclusion.verdict == "ambiguous" else conclusion.verdict
    return Conclusion(verdict, answer, steps_of(again), sure)


def partly_where_another_acts(judgement: Judgement, fit: JointFit, thresholds: DecisionThresholds) -> Judgement:
    """The judgement, told as ``partly`` where much is left and another cause acts.

    One does where a number ends at its range, for no value that a robot may have fits then; where short pieces, in
    which errors have no time to grow, stay far from the robot's; and where one of several named causes is less known
    than causes that act are: two or three that stand for one without a name are so.
    """
    conclusion, gap = judgement.conclusion, fit.judging
    if conclusion.verdict not in ("named", "ambiguous") or not conclusion.steps or not gap.has_gap:
        return judgement
    (squares,) = gap.squares([judgement.selected])
    if gap.closure_value(squares) >= thresholds.enough_jointly:
        return judgement
    if judgement.selected.at_bound:
        note = "a fitted number is at the end of its range: another cause may act in its place"
    elif fit.in_parts and (left := fit.share_and_rest(judgement.selected)[1]) > thresholds.most_left_named:
        noise = f"{np.sqrt(left):.0f} times as far from the logs as noise explains"
        note = f"short segments stay {noise}: another cause acts as well, or a number is off"
    elif fit.in_parts and (names := hardly_known(judgement, thresholds)):
        note = f"much of the gap is unexplained and {names} is poorly determined: another cause may act"
    else:
        return judgement
    fit.notes.append(note)
    return replace(judgement, conclusion=replace(conclusion, verdict="partly"))


def hardly_known(judgement: Judgement, thresholds: DecisionThresholds) -> str:
    """Those of several named causes whose numbers are less known than ``least_known_named`` asks, in words.

    Empty where all are known, where one cause is named, and where rivals are told, which is why numbers are not known.
    """
    conclusion, selected = judgement.conclusion, judgement.selected
    if conclusion.verdict != "named" or len(conclusion.answer) < 2:
        return ""
    sizes = spreads_from_nominal(selected)
    few = (h.label for h, size in zip(selected.hypotheses, sizes, strict=True) if size < thresholds.least_known_named)
    return " and ".join(few)
