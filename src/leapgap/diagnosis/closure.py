"""How far: what believed effects close of the headline gap on jumps they were not fitted on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.attribution import Belief
from leapgap.diagnosis.gap import Judged, counts, squares
from leapgap.effects.base import Effect
from leapgap.simulation.replay import Replayer


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % interval over jumps drawn again."""

    value: float
    low: float
    high: float


def resamples(jumps: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Bootstrap over jumps: indices (draws, jumps)."""
    return rng.integers(0, jumps, size=(draws, jumps))


def closure(
    nominal: np.ndarray, corrected: np.ndarray, floor: np.ndarray, judged: Judged, draws: np.ndarray
) -> Interval:
    """Share of the headline gap above its noise floor that goes away; arguments are sums of squares a jump."""
    number = counts(judged)

    def of(chosen: np.ndarray) -> float:
        values = number[chosen].sum()
        before, after, least = (np.sqrt(s[chosen].sum() / values) for s in (nominal, corrected, floor))
        return float((before - after) / max(before - least, 1e-12))

    sample = [of(chosen) for chosen in draws]
    return Interval(of(np.arange(len(number))), float(np.percentile(sample, 2.5)), float(np.percentile(sample, 97.5)))


def effects_on(fit: Belief, log: str, fold: int | None) -> tuple[Effect, ...]:
    """Effects of a fit on one log, as fitted without a fold (None: on all logs)."""
    numbers = fit.numbers if fold is None else fit.fold_numbers[fold]
    return tuple(h.on(log, own) for h, own in zip(fit.hypotheses, fit.split(numbers), strict=True))


def heldout_squares(judged: Judged, replayer: Replayer, fits: Sequence[Belief], folds: Sequence[int]) -> np.ndarray:
    """Headline sums of squares of fits on each jump, at numbers fitted without its fold, (fits, jumps)."""
    candidates = [
        [effects_on(fit, jump.name, fold) for jump, fold in zip(judged.jumps, folds, strict=True)] for fit in fits
    ]
    return squares(judged, replayer, candidates) if candidates else np.zeros((0, len(judged.jumps)))
