"""What may be said: named, ambiguous, unknown or none, and how sure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate, SearchResult
from leapgap.diagnosis.robust_least_squares import losses

Answer = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Conclusion:
    """What is answered, and how sure that is."""

    verdict: str
    answer: Answer
    """Each cause with the rivals that could stand in its place."""
    steps: tuple[Candidate, ...] = ()
    """Beliefs of the first one, two, … causes; the last is what is believed."""
    probabilities: tuple[float, ...] = ()
    """How often each cause is part of the best set when logs are drawn again."""


@dataclass(frozen=True)
class DecisionThresholds:
    """When a diagnosis is convinced."""

    rival_share: float = 0.05
    """A rival that is best in this share of the resamples cannot be told apart."""
    most_left: float = 1.3
    """χ² over its expectation, mean over pieces: up to here noise explains what an answer leaves of short replays.

    Where it leaves more, it must close ``enough_closure`` of the headline gap on held-out jumps, or
    ``least_closure`` of it and explain ``least_explained`` of the log likelihood that noise does not.
    """
    least_explained: float = 0.8
    enough_closure: float = 0.7
    least_closure: float = 0.35
    most_worsened: float = 0.02
    """A further cause that opens more of the headline gap on held-out jumps is not believed, whatever it gains in short
    replays."""
    none_below: float = 1.15
    """χ² over its expectation, median over pieces: up to here noise explains short replays of the nominal robot;"""
    none_gap: float = 2.7
    """noise floors: up to here noise and what no description of a robot has exactly explain its gap in whole jumps."""


def best_set_shares(found: SearchResult, draws: np.ndarray) -> np.ndarray:
    """How often each rival has the least held-out loss when logs are drawn again (draws, logs), (rivals,)."""
    logs = draws.shape[1]  # not every log need have a piece
    of_logs = np.stack([np.bincount(found.log_of_piece, fit.heldout, minlength=logs) for fit in found.rivals])
    return np.bincount(of_logs[:, draws].sum(axis=2).argmin(axis=0), minlength=len(of_logs)) / len(draws)


def answer_of(found: SearchResult, shares: np.ndarray, thresholds: DecisionThresholds) -> Answer:
    """Each believed effect with the rivals that could stand in its place; ``shares`` are those of the rivals."""
    names = list(found.selected.names)
    answer = []
    for i, name in enumerate(names):
        others = set(names[:i] + names[i + 1 :])
        standing_in: dict[str, float] = {}
        for fit, share in zip(found.rivals, shares, strict=True):
            left = set(fit.names) - others
            if others < set(fit.names) and len(left) == 1 and name not in fit.names:
                (rival,) = left
                standing_in[rival] = standing_in.get(rival, 0.0) + float(share)
        answer.append((name, *sorted(r for r, share in standing_in.items() if share >= thresholds.rival_share)))
    return tuple(answer)


def probability(name: str, found: SearchResult, shares: np.ndarray) -> float:
    """How often an effect is part of the best set."""
    return float(sum(share for fit, share in zip(found.rivals, shares, strict=True) if name in fit.names))


def explained_share(found: SearchResult, thresholds: DecisionThresholds) -> float:
    """Share of the nominal robot's loss beyond noise that goes away on held-out logs."""
    noise = losses(np.array(thresholds.none_below * found.values), found.values)
    before, after = (np.maximum(f.heldout - noise, 0.0).sum() for f in (found.nominal, found.selected))
    return float(1 - after / before) if before > 0 else 1.0


def drop_contradicted_causes(
    found: SearchResult, closes: Sequence[float], thresholds: DecisionThresholds
) -> SearchResult:
    """The search without further causes that whole jumps contradict; ``closes`` of its first one, two, … causes.

    Derivatives of short replays absorb what the first cause's model is off by in causes that do not act.
    """
    worse = (k for k in range(1, len(closes)) if closes[k] < closes[k - 1] - thresholds.most_worsened)
    return replace(found, selected=found.before(next(worse, len(closes))))


def verdict_of(
    found: SearchResult, answer: Answer, gap: float, closes: float | None, thresholds: DecisionThresholds
) -> str:
    """In one word.

    ``gap`` is the nominal robot's headline gap in noise floors, ``closes`` the share of it that the answer closes on
    held-out jumps, None where there is nothing to close.
    """
    if not found.selected.hypotheses:
        within = np.median(found.nominal.chi2) <= thresholds.none_below and gap <= thresholds.none_gap
        return "none" if within else "unknown"
    if not explains(found, closes, thresholds):
        return "unknown"
    return "named" if all(len(names) == 1 for names in answer) else "ambiguous"


def explains(found: SearchResult, closes: float | None, thresholds: DecisionThresholds) -> bool:
    """Whether what is believed explains what happened; ``closes`` as above."""
    if closes is not None and closes < -thresholds.most_worsened:
        return False
    if np.mean(found.selected.chi2) <= thresholds.most_left:
        return True
    if closes is None or closes < thresholds.least_closure:
        return False
    return closes >= thresholds.enough_closure or explained_share(found, thresholds) >= thresholds.least_explained


def decide(
    found: SearchResult, shares: np.ndarray, gap: float, closes: float | None, thresholds: DecisionThresholds
) -> Conclusion:
    """What a search allows to say; ``shares`` are those of the rivals, ``gap`` and ``closes`` as in ``verdict_of``."""
    answer = answer_of(found, shares, thresholds)
    verdict = verdict_of(found, answer, gap, closes, thresholds)
    if verdict not in ("named", "ambiguous"):
        return Conclusion(verdict, ())
    return Conclusion(verdict, answer, found.steps, tuple(probability(names[0], found, shares) for names in answer))
