"""Decision of a diagnosis: the verdict named, ambiguous, partly, unknown or none, with probabilities of causes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate, SearchResult
from leapgap.diagnosis.closure import Interval
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.joint_search import JointSearch
from leapgap.diagnosis.robust_least_squares import losses

Answer = tuple[tuple[str, ...], ...]
"""Each cause, followed by the rivals that cannot be told apart from it."""


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


def best_set_shares(result: SearchResult, draws: np.ndarray) -> np.ndarray:
    """Share of resamples (draws, logs) in which each rival has the smallest held-out loss, (rivals,)."""
    logs = draws.shape[1]  # not every log need have a piece
    of_logs = np.stack([np.bincount(result.log_of_piece, fit.heldout, minlength=logs) for fit in result.rivals])
    return np.bincount(of_logs[:, draws].sum(axis=2).argmin(axis=0), minlength=len(of_logs)) / len(draws)


def shares_of_sets(result: SearchResult, gap: HeldOutGap, thresholds: DecisionThresholds) -> np.ndarray:
    """How often each rival is best in the resamples, (rivals,).

    By short pieces; where whole logs of a held robot surely prefer another rival, both have half a say.
    """
    if not result.rivals:
        return np.zeros(0)
    by_pieces = best_set_shares(result, gap.draws)
    if not gap.is_of_held_robot:
        return by_pieces
    (own,), others = gap.squares([result.selected]), gap.squares(result.rivals)
    least = gap.closure_value(own) + thresholds.most_worsened
    better = [
        gap.share_better(squares, own) >= thresholds.least_sure and gap.closure_value(squares) > least
        for squares in others
    ]
    if not any(better):
        return by_pieces
    possible = np.array(better) | np.array([fit is result.selected for fit in result.rivals])
    left = np.where(possible[:, None], others, np.inf)[:, gap.draws].sum(axis=2)
    return (by_pieces + np.bincount(left.argmin(axis=0), minlength=len(left)) / len(gap.draws)) / 2


def answer_of(result: SearchResult, shares: np.ndarray, thresholds: DecisionThresholds) -> Answer:
    """The selected effect with the rivals that cannot be told apart from it.

    ``shares`` (rivals,) is how often each rival is best, by ``best_set_shares``.
    """
    name, others = result.selected.names, dict.fromkeys(fit.names[0] for fit in result.rivals)
    rivals = (r for r in others if r not in name and probability(r, result, shares) >= thresholds.rival_share)
    return ((*name, *sorted(rivals)),) if name else ()


def probability(name: str, result: SearchResult, shares: np.ndarray) -> float:
    """Share of the resamples in which an effect is best."""
    return float(sum(share for fit, share in zip(result.rivals, shares, strict=True) if name in fit.names))


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
    shares: np.ndarray
    """Share of the resamples in which each rival is best, (rivals,)."""
    conclusion: Conclusion
    notes: tuple[str, ...] = ()
    """What a report must say of it."""

    @property
    def selected(self) -> Candidate:
        """The answer's fit; the nominal robot where there is no answer."""
        return self.conclusion.steps[-1] if self.conclusion.steps else self.result.nominal

    @property
    def others(self) -> list[tuple[Candidate, float]]:
        """Fits of the further hypotheses, each with the share of the resamples in which its effect is best.

        That is 0 if the answer has the effect.
        """
        names, known = self.selected.names, {(h.name, h.location) for h in self.selected.hypotheses}
        return [
            (fit, 0.0 if fit.names[0] in names else probability(fit.names[0], self.result, self.shares))
            for fit in self.result.singles
            if (fit.names[0], fit.hypotheses[0].location) not in known
        ]


def judge(result: SearchResult, heldout_gap: HeldOutGap, thresholds: DecisionThresholds) -> Judgement:
    """Judge a search by replays of whole logs on held-out logs."""
    heldout_gap.replays(result.steps)
    heldout_gap.squares(result.singles)
    shares = shares_of_sets(result, heldout_gap, thresholds)
    gap = heldout_gap.gap(heldout_gap.before) / heldout_gap.gap(heldout_gap.floor)
    # The nominal step's own error may hide what a small effect closes.
    closes = heldout_gap.best_closure(result.selected, thresholds.enough_closure)
    conclusion = decide(result, shares, gap, closes, thresholds)
    conclusion = without_what_widens(conclusion, heldout_gap, thresholds)
    if conclusion.verdict == "unknown" and result.selected.hypotheses and heldout_gap.has_gap:
        (figures,) = heldout_gap.figures([result.selected])
        conclusion = decide_partly(result, shares, figures.closure, thresholds)
    return Judgement(result, shares, conclusion)


def judge_jointly(
    judgement: Judgement, fit: JointFit, hypotheses: Sequence[Hypothesis], thresholds: DecisionThresholds
) -> Judgement:
    """The judgement, or that of all effects fitted together where it leaves much and they explain it better.

    The causes of a joint fit that leave much themselves are told as such (``partly``). Where the clock is the only
    effect that is looked for, and the logs tell it, there is nothing to fit.
    """
    if judgement.conclusion.verdict == "none" or not hypotheses:
        return judgement
    gap = fit.heldout_gap
    (before,) = gap.squares([judgement.selected])
    if gap.closure_value(before) >= thresholds.enough_closure:
        return judgement
    steps, probabilities = JointSearch(fit).search(hypotheses)
    after = steps[-1].heldout
    closes, sure = gap.closure_value(after), gap.share_better(after, before)
    if closes - gap.closure_value(before) < fit.plan.least_closure or sure < fit.plan.least_sure:
        return judgement
    verdict = "named" if closes >= thresholds.enough_closure else "partly"
    answer = tuple((step.names[-1],) for step in steps)
    return replace(judgement, conclusion=Conclusion(verdict, answer, steps, probabilities))


def partly_where_another_acts(judgement: Judgement, gap: HeldOutGap, thresholds: DecisionThresholds) -> Judgement:
    """The judgement, told as ``partly`` where much is left and a number ends at its range.

    Another cause acts then, for no value that a robot may have fits.
    """
    conclusion = judgement.conclusion
    if conclusion.verdict not in ("named", "ambiguous") or not conclusion.steps or not gap.has_gap:
        return judgement
    (squares,) = gap.squares([judgement.selected])
    if gap.closure_value(squares) >= thresholds.enough_jointly or not judgement.selected.at_bound:
        return judgement
    notes = ("a fitted number is at the end of its range: another cause may act in its place",)
    return replace(judgement, conclusion=replace(conclusion, verdict="partly"), notes=notes)
