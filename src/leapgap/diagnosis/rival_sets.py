"""Sets of causes that rival the selected one: how often each is best, and which causes cannot be told apart by that."""

import numpy as np

from leapgap.diagnosis.candidates import SearchResult
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.gap import HeldOutGap

Answer = tuple[tuple[str, ...], ...]
"""Each cause, followed by the rivals that cannot be told apart from it."""


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
    """Each selected effect with the rivals that cannot be told apart from it.

    ``shares`` (rivals,) is how often each rival is best, by ``best_set_shares``.
    """
    names = list(result.selected.names)
    answer = []
    for i, name in enumerate(names):
        others = set(names[:i] + names[i + 1 :])
        standing_in: dict[str, float] = {}
        for fit, share in zip(result.rivals, shares, strict=True):
            left = set(fit.names) - others
            if others < set(fit.names) and len(left) == 1 and name not in fit.names:
                (rival,) = left
                standing_in[rival] = standing_in.get(rival, 0.0) + float(share)
        answer.append((name, *sorted(r for r, share in standing_in.items() if share >= thresholds.rival_share)))
    return tuple(answer)


def probability(name: str, result: SearchResult, shares: np.ndarray) -> float:
    """Share of the resamples in which an effect is part of the best set."""
    return float(sum(share for fit, share in zip(result.rivals, shares, strict=True) if name in fit.names))
