"""Decision of a diagnosis: the verdict named, ambiguous, partly, unknown or none, with probabilities of causes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate, SearchResult, in_words
from leapgap.diagnosis.closure import Interval
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.full_rollouts import FullRolloutCause, FullRolloutFit, FullRollouts, FullRolloutSettings
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_fit import JointFit, part
from leapgap.diagnosis.joint_search import search_jointly
from leapgap.diagnosis.rival_sets import (
    Answer,
    answer_of,
    probability,
    shares_of_possible_sets,
    shares_of_sets,
)
from leapgap.diagnosis.robust_least_squares import losses


@dataclass(frozen=True)
class Conclusion:
    """Verdict and answer of a diagnosis."""

    verdict: str
    answer: Answer
    """Each cause, followed by the rivals that cannot be told apart from it."""
    steps: tuple[Candidate, ...] = ()
    """Fits of the first one, two, … causes; the last is the answer's."""
    probabilities: tuple[float, ...] = ()
    """Share of the bootstrap resamples of logs in which each cause is part of the best set."""


def without_what_widens(conclusion: Conclusion, gap: HeldOutGap, thresholds: DecisionThresholds) -> Conclusion:
    """The conclusion, or ``unknown`` where its answer surely widens the gap of a held robot's whole logs."""
    if gap.is_of_held_robot and conclusion.steps and surely_widens(conclusion.steps[-1], gap, thresholds):
        return Conclusion("unknown", ())
    return conclusion


def surely_widens(candidate: Candidate, gap: HeldOutGap, thresholds: DecisionThresholds) -> bool:
    """Whether a candidate widens the nominal robot's gap on held-out logs, beyond doubt."""
    if not candidate.hypotheses or not gap.has_gap:
        return False
    (squares,) = gap.squares([candidate])
    return gap.closure(squares).high < -thresholds.most_worsened


def explained_share(result: SearchResult, thresholds: DecisionThresholds) -> float:
    """Share of the nominal robot's loss beyond noise that the selected set removes on held-out logs."""
    noise = losses(np.array(thresholds.none_below * result.values), result.values)
    before, after = (np.maximum(f.heldout - noise, 0.0).sum() for f in (result.nominal, result.selected))
    return float(1 - after / before) if before > 0 else 1.0


def drop_contradicted_causes(
    result: SearchResult, closes: Sequence[float], thresholds: DecisionThresholds, held: Sequence[float] | None = None
) -> SearchResult:
    """The search result without further causes that full rollouts contradict.

    ``closes`` are the shares of the headline gap that the first one, two, … causes close, and ``held`` is what they
    leave of it on a held robot. In short replays an error in the model of the first cause can look like another one.
    """

    def contradicted(k: int) -> bool:
        worse = closes[k] < closes[k - 1] - thresholds.most_worsened
        return worse or (held is not None and held[k] > (1 - thresholds.least_shrunk) * held[k - 1])

    return replace(result, selected=result.before(next(filter(contradicted, range(1, len(closes))), len(closes))))


def verdict_of(
    result: SearchResult, answer: Answer, gap: float, closes: float | None, thresholds: DecisionThresholds
) -> str:
    """The verdict: ``named``, ``ambiguous``, ``unknown`` or ``none``.

    ``gap`` is the nominal robot's headline gap in noise floors, ``closes`` the share of it that the answer closes on
    held-out logs, None where there is nothing to close.
    """
    within = np.median(result.nominal.chi2) <= thresholds.none_below and gap <= thresholds.none_gap
    if not result.selected.hypotheses:
        return "none" if within else "unknown"
    gain = float((result.nominal.heldout - result.selected.heldout).sum())
    if within and gain < thresholds.none_gain and not (closes is not None and closes >= thresholds.partly_closure):
        return "none"
    # A gap that noise explains is closed by nothing: only short replays tell what is wrong then.
    if not explains(result, None if gap <= thresholds.none_gap else closes, thresholds):
        return "unknown"
    # Short pieces see nothing of what acts for a moment in each log, such as feet that stick as they lift off.
    if closes is not None and gap > thresholds.most_whole_gap and closes < thresholds.partly_closure:
        return "unknown"
    return named_or_ambiguous(answer)


def named_or_ambiguous(answer: Answer) -> str:
    """The verdict of an answer that explains the logs."""
    return "named" if all(len(names) == 1 for names in answer) else "ambiguous"


def explains(result: SearchResult, closes: float | None, thresholds: DecisionThresholds) -> bool:
    """Whether the selected set explains the logs; ``closes`` as in ``verdict_of``."""
    if closes is not None and closes < -thresholds.most_worsened:
        return False
    if np.mean(result.selected.chi2) <= thresholds.most_left:
        return True
    if closes is None or closes < thresholds.least_closure:
        return False
    return closes >= thresholds.enough_closure or explained_share(result, thresholds) >= thresholds.least_explained


def decide(
    result: SearchResult, shares: np.ndarray, gap: float, closes: float | None, thresholds: DecisionThresholds
) -> Conclusion:
    """Conclusion from a search; ``shares`` as in ``answer_of``, ``gap`` and ``closes`` as in ``verdict_of``."""
    answer = answer_of(result, shares, thresholds)
    verdict = verdict_of(result, answer, gap, closes, thresholds)
    if verdict not in ("named", "ambiguous"):
        return Conclusion(verdict, ())
    return conclude_as(verdict, answer, result, shares)


def conclude_as(verdict: str, answer: Answer, result: SearchResult, shares: np.ndarray) -> Conclusion:
    """Conclusion with the selected causes; arguments as in ``decide``."""
    return Conclusion(verdict, answer, result.steps, tuple(probability(names[0], result, shares) for names in answer))


def decide_partly(
    result: SearchResult, shares: np.ndarray, closes: Interval, thresholds: DecisionThresholds
) -> Conclusion:
    """Conclusion where the selected causes do not explain the logs: ``partly`` or ``unknown``.

    ``closes`` is the share of the headline gap that they close on held-out logs.
    """
    if closes.value < thresholds.partly_closure or closes.low <= 0:
        return Conclusion("unknown", ())
    return conclude_as("partly", answer_of(result, shares, thresholds), result, shares)


@dataclass(frozen=True)
class Judgement:
    """A search for causes with its conclusion."""

    result: SearchResult
    """The search without causes that replays of whole logs contradict."""
    shares: np.ndarray
    """Share of the resamples in which each rival is best, (rivals,)."""
    conclusion: Conclusion

    @property
    def selected(self) -> Candidate:
        """The answer's fit; the nominal robot where there is no answer."""
        return self.conclusion.steps[-1] if self.conclusion.steps else self.result.nominal

    @property
    def others(self) -> list[tuple[Candidate, float]]:
        """One fit for each further hypothesis that was judged, with the probability of its newest effect.

        That is the share of the resamples in which the effect is part of the best set; 0 if the answer has it.
        """
        known = {(h.name, h.location) for h in self.selected.hypotheses}
        found: list[tuple[Candidate, float]] = []
        for fit in self.result.alternatives:
            newest = fit.hypotheses[-1]
            if (newest.name, newest.location) not in known:
                known.add((newest.name, newest.location))
                share = probability(newest.name, self.result, self.shares)
                found.append((fit, 0.0 if newest.name in self.selected.names else share))
        return found


def judge(
    result: SearchResult,
    heldout_gap: HeldOutGap,
    hypotheses: Sequence[Hypothesis],
    thresholds: DecisionThresholds,
    full: FullRolloutSettings,
    progress: Callable[[str], None],
) -> Judgement:
    """Judge a search by replays of whole logs on held-out logs.

    Where a confirmed cause does not explain enough, the search goes on in these replays.
    """
    heldout_gap.replays(result.steps)
    steps = heldout_gap.squares(result.steps)
    left = [heldout_gap.gap(squares) for squares in steps] if heldout_gap.is_of_held_robot else None
    closed = [heldout_gap.closure_value(squares) for squares in steps]
    result = drop_contradicted_causes(result, closed, thresholds, left)
    heldout_gap.squares([*result.steps, *result.alternatives])
    shares = shares_of_sets(result, heldout_gap, thresholds)
    gap = heldout_gap.gap(heldout_gap.before) / heldout_gap.gap(heldout_gap.floor)
    # The nominal step's own error may hide what a small effect closes.
    closes = heldout_gap.best_closure(result.selected, thresholds.enough_closure)
    conclusion = decide(result, shares, gap, closes, thresholds)
    conclusion = without_what_widens(conclusion, heldout_gap, thresholds)
    if conclusion.verdict == "unknown" and is_first_cause_confirmed(result):
        causes = FullRollouts(heldout_gap, full, progress).search(result.before(1), hypotheses, thresholds.rival_share)
        conclusion = conclude_from(causes)
    elif conclusion.verdict == "unknown" and result.selected.hypotheses and heldout_gap.has_gap:
        (figures,) = heldout_gap.figures([result.selected])
        conclusion = decide_partly(result, shares, figures.closure, thresholds)
    return Judgement(result, shares, conclusion)


def judge_jointly(
    judgement: Judgement, fit: JointFit, hypotheses: Sequence[Hypothesis], thresholds: DecisionThresholds
) -> Judgement:
    """The judgement, or that of all effects fitted together where it leaves much and they explain it better.

    The causes of a joint fit that leave much themselves are told as such (``partly``). Where logs tell short steps of
    the simulation from the usual ones, the numbers are those by short steps. Where the clock is the only effect that is
    looked for, and the logs tell it, there is nothing to fit.
    """
    if judgement.conclusion.verdict == "none" or not hypotheses:
        return judgement
    at = fit.by_steps_of(judgement.result.selected) or fit
    judgement = with_numbers_by_short_steps(judgement, at, thresholds)
    (before,) = at.judging.squares([judgement.selected])
    explained = is_explained(before, at, thresholds)
    if not explained or judgement.result.gain_of_further >= fit.plan.clear_gain:
        one_more = with_small_cause(judgement, fit, thresholds)
        if one_more is not None:
            return one_more
    if explained:
        return with_numbers_of_whole_logs(judgement, at)
    causes, fit = search_jointly(at, hypotheses, judgement.result.further, thresholds.none_gap)
    found = better_jointly(judgement, causes, fit, thresholds)
    if found is judgement:
        found = with_numbers_of_whole_logs(judgement, fit)
    return with_numbers_by_short_steps(found, fit, thresholds)


def with_small_cause(judgement: Judgement, fit: JointFit, thresholds: DecisionThresholds) -> Judgement | None:
    """The judgement with the further cause that gained too little in short pieces, where both explain whole logs.

    None where they do not. A slow cause shows little in a tenth of a second beside a fast one, and much in whole logs.
    """
    result = replace(judgement.result, selected=judgement.result.further)
    at = fit.by_steps_of(result.selected) if fit.in_parts else None
    if at is None or result.selected is judgement.result.selected:
        return None
    shares = shares_of_possible_sets(result, at.judging, fit.plan.least_part)
    answer = answer_of(result, shares, thresholds)
    conclusion = conclude_as(named_or_ambiguous(answer), answer, result, shares)
    found = with_numbers_by_short_steps(Judgement(result, shares, conclusion), at, thresholds)
    gap, (before, after) = at.judging, at.judging.squares([judgement.selected, found.selected])
    helps = gap.closure_value(after) - gap.closure_value(before) >= fit.plan.most_lost
    sure = gap.share_better(after, before) >= fit.plan.least_sure
    whole = gap.closure_value(after) >= thresholds.enough_jointly and is_noise(after, at, thresholds)
    if not (helps and sure and whole and at.explains_pieces(found.selected)):
        return None
    fit.progress(f"with a small cause, {in_words(found.selected)}: explains {gap.closure_value(after):.2f}")
    return found


def better_jointly(
    judgement: Judgement, causes: Sequence[FullRolloutCause], fit: JointFit, thresholds: DecisionThresholds
) -> Judgement:
    """The judgement, or that of the causes of a fit of all effects where they explain more, or as much with fewer."""
    gap = fit.judging
    (before,) = gap.squares([judgement.selected])
    after = causes[-1].fit.heldout
    closes, sure = gap.closure_value(after), gap.share_better(after, before)
    gain = closes - gap.closure_value(before)
    simpler = fit.in_parts and len(causes) < len(judgement.conclusion.answer) and gain > -fit.plan.most_lost
    better = gain >= fit.plan.least_closure or (is_likelier(causes[-1].fit, judgement.selected, fit) and gain > 0)
    if (not better or sure < fit.plan.least_sure) and not simpler:
        return judgement
    if fit.in_parts and (closes < thresholds.partly_closure or gap.closure(after).low <= 0):
        return judgement
    conclusion = conclude_from(causes)
    verdict = conclusion.verdict if fit.in_parts else "named"
    explained = closes_enough(causes[-1].fit, fit, thresholds)
    return replace(judgement, conclusion=replace(conclusion, verdict=verdict if explained else "partly"))


def is_likelier(found: FullRolloutFit, before: Candidate, fit: JointFit) -> bool:
    """Whether causes found together explain the logs of a held robot clearly likelier than those found one by one."""
    if not fit.in_parts or not fit.judging.is_of_held_robot:
        return False
    return fit.loss_at(before) - found.loss >= fit.plan.least_likelier


def is_explained(squares: np.ndarray, fit: JointFit, thresholds: DecisionThresholds) -> bool:
    """Whether an answer that leaves some squares on held-out logs, (logs,), is not looked beyond."""
    gap = fit.judging
    if not fit.in_parts:
        return gap.closure_value(squares) >= thresholds.enough_closure
    if not thresholds.enough_jointly:
        return True
    return is_noise(squares, fit, thresholds) and gap.closure_value(squares) > -thresholds.most_worsened


def is_noise(squares: np.ndarray, fit: JointFit, thresholds: DecisionThresholds) -> bool:
    """Whether noise and tolerances explain squares on held-out logs, (logs,)."""
    return fit.judging.gap(squares) <= thresholds.none_gap * fit.judging.gap(fit.judging.floor)


def closes_enough(found: FullRolloutFit, fit: JointFit, thresholds: DecisionThresholds) -> bool:
    """Whether the causes of a fit are the whole explanation: of whole logs, or nearly, and of short pieces."""
    closes = fit.judging.closure_value(found.heldout)
    if not fit.in_parts or closes >= thresholds.enough_jointly:
        return closes >= thresholds.enough_closure
    if closes < thresholds.enough_closure or not is_noise(found.heldout, fit, thresholds):
        return False
    return fit.explains_pieces(found)


def with_numbers_by_short_steps(judgement: Judgement, fit: JointFit, thresholds: DecisionThresholds) -> Judgement:
    """The judgement with the numbers that short steps of the simulation give, where these explain the logs as well.

    A usual step itself delays and softens: numbers fitted by it are off by what it does. Whole logs and tolerances have
    a say in such numbers and in their intervals, so these are taken only where they explain whole logs nearly wholly.
    """
    conclusion, gap = judgement.conclusion, fit.judging
    if gap is fit.heldout_gap or not conclusion.steps:
        return judgement
    whole = fit.by_short_steps(judgement.selected.hypotheses, judgement.selected.numbers)
    (before,) = gap.squares([judgement.selected])
    sure = gap.share_better(whole.heldout, before)
    surely_worse = sure < 1 - fit.plan.least_sure
    if gap.closure_value(whole.heldout) < thresholds.enough_jointly or surely_worse:
        return judgement
    verdict = conclusion.verdict
    if verdict == "partly":
        verdict = named_or_ambiguous(conclusion.answer)
    return replace(judgement, conclusion=replace(conclusion, verdict=verdict, steps=steps_of(whole)))


def with_numbers_of_whole_logs(judgement: Judgement, fit: JointFit) -> Judgement:
    """The judgement of a held robot with the numbers that whole logs and pieces tell together, where surely better.

    Pieces begin at noisy rows, and numbers that they alone tell are off by what that does. The causes stay: with better
    numbers, several that stand for a single other one would pass for an explanation.
    """
    conclusion, gap = judgement.conclusion, fit.judging
    known = gap is fit.heldout_gap and gap.is_of_held_robot and fit.in_parts
    if not known or not conclusion.steps:
        return judgement
    whole = fit.by_whole_logs(judgement.selected)
    (before,) = gap.squares([judgement.selected])
    if gap.share_better(whole.heldout, before) < fit.plan.least_sure:
        return judgement
    return replace(judgement, conclusion=replace(conclusion, steps=steps_of(whole)))


def steps_of(fit: FullRolloutFit) -> tuple[FullRolloutFit, ...]:
    """Fits of the first one, two, … causes of a fit, and itself last."""
    return (*(part(fit, range(k)) for k in range(1, len(fit.hypotheses))), fit)


def conclude_from(causes: Sequence[FullRolloutCause]) -> Conclusion:
    """Conclusion from causes found in full rollouts."""
    answer = tuple(cause.names for cause in causes)
    fits, probabilities = tuple(cause.fit for cause in causes), tuple(cause.probability for cause in causes)
    return Conclusion(named_or_ambiguous(answer), answer, fits, probabilities)


def is_first_cause_confirmed(result: SearchResult) -> bool:
    """Whether the first cause is one that a consistency check of the logs confirms."""
    return bool(result.selected.hypotheses) and result.selected.hypotheses[0].per_log is not None
