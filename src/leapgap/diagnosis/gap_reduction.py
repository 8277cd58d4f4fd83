"""Gap reduction: share of the headline gap that fitted effects close on held-out logs."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.gap import JudgedLogs, candidate_squares, headline_gap, motion_squares, value_counts
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer, Rollout

LEAST_ABOVE = 0.05
"""Smallest gap above the noise floor, as a share of the floor, of which a reduction can be stated."""


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval over resampled logs."""

    value: float
    low: float
    high: float

    @property
    def capped_at_one(self) -> "Interval":
        """The interval of a share, clipped to at most 1, with the value inside: the form for texts.

        A corrected gap may be below the noise floor by chance, which gives a share above 1.
        """
        value = min(self.value, 1.0)
        return Interval(value, min(self.low, value), max(min(self.high, 1.0), value))


def above_noise(gap: float, floor: float) -> bool:
    """Whether a headline gap is above its noise floor."""
    return gap - floor > LEAST_ABOVE * floor


def resamples(logs: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Bootstrap resamples of logs: indices (draws, logs)."""
    return rng.integers(0, logs, size=(draws, logs))


def closure(
    nominal: np.ndarray, corrected: np.ndarray, floor: np.ndarray, judged: JudgedLogs, draws: np.ndarray
) -> Interval:
    """Share of the headline gap above its noise floor that is closed; arguments are sums of squares (logs,).

    It is 0 where the gap is not above the noise floor.
    """
    number = value_counts(judged)

    def of(chosen: np.ndarray) -> float:
        values = number[chosen].sum()
        before, after, least = (np.sqrt(s[chosen].sum() / values) for s in (nominal, corrected, floor))
        return float((before - after) / (before - least)) if above_noise(before, least) else 0.0

    sample = [of(chosen) for chosen in draws]
    return Interval(of(np.arange(len(number))), float(np.percentile(sample, 2.5)), float(np.percentile(sample, 97.5)))


def effects_on(fit: Candidate, log: str, fold: int | None) -> tuple[Effect, ...]:
    """Effects of a candidate on one log, with the numbers fitted without a fold (None: on all logs)."""
    numbers = fit.numbers if fold is None else fit.fold_numbers[fold]
    return tuple(h.on(log, own) for h, own in zip(fit.hypotheses, fit.split(numbers), strict=True))


def extend_to_whole_log(effects: Sequence[Effect], rows: int, all_rows: int) -> tuple[Effect, ...]:
    """Effects fitted on the first ``rows`` rows of a log, extended to all its rows."""
    return tuple(effect.extend_to(rows, all_rows) for effect in effects)


def heldout_squares(
    judged: JudgedLogs, replayer: Replayer, candidates: Sequence[Candidate], folds: Sequence[int]
) -> np.ndarray:
    """Sums of squares of candidates on each log, with the numbers fitted without its fold, (candidates, logs)."""
    effect_sets = [
        [effects_on(candidate, log.name, fold) for log, fold in zip(judged.logs, folds, strict=True)]
        for candidate in candidates
    ]
    return candidate_squares(judged, replayer, effect_sets) if effect_sets else np.zeros((0, len(judged.logs)))


@dataclass(frozen=True)
class HeldOutGap:
    """The headline gap of candidates on held-out logs, in full rollouts."""

    judged: JudgedLogs
    replayer: Replayer
    folds: np.ndarray
    """Index of the fold of each log, (logs,)."""
    nominal: np.ndarray
    """Sums of squares of the nominal robot, (logs,)."""
    floor: np.ndarray
    """Sums of squares of noise alone, (logs,)."""
    draws: np.ndarray
    """Bootstrap resamples of logs, (draws, logs)."""

    def heldout_squares(self, candidates: Sequence[Candidate]) -> np.ndarray:
        """Sums of squares on held-out logs, (candidates, logs)."""
        return heldout_squares(self.judged, self.replayer, candidates, self.folds.tolist())

    def closure(self, corrected: np.ndarray) -> Interval:
        """Share of the gap that is closed where sums of squares (logs,) remain, with its interval."""
        return closure(self.nominal, corrected, self.floor, self.judged, self.draws)

    def closure_value(self, corrected: np.ndarray) -> float:
        """Share of the gap that is closed, without an interval."""
        return closure(self.nominal, corrected, self.floor, self.judged, self.draws[:1]).value

    @property
    def has_gap(self) -> bool:
        """Whether full rollouts have a gap above noise."""
        return above_noise(self.gap(self.nominal), self.gap(self.floor))

    def gap(self, corrected: np.ndarray) -> float:
        """Headline gap from sums of squares (logs,)."""
        return headline_gap(corrected, self.judged)

    def gap_by_log(self, corrected: np.ndarray) -> dict[str, dict[str, float]]:
        """Headline gap of each log, nominal and corrected."""
        both = np.sqrt(np.stack([self.nominal, corrected]) / value_counts(self.judged))
        names = [log.name for log in self.judged.logs]
        return {n: {"nominal": float(a), "corrected": float(b)} for n, a, b in zip(names, *both, strict=True)}

    def with_steps(self, largest_step_s: float) -> "HeldOutGap":
        """The same with another largest step of the simulation."""
        replayer = self.replayer.with_steps(largest_step_s)
        nominal = candidate_squares(self.judged, replayer, [[()] * len(self.judged.logs)])[0]
        return replace(self, replayer=replayer, nominal=nominal)


@dataclass
class HeldOutReplays:
    """Cache of held-out replays and sums of squares (logs,) of candidates; each candidate is replayed once."""

    heldout_gap: HeldOutGap
    logs: Sequence[Log]
    """The logs with all their rows, beyond those that are judged."""
    nominal: Sequence[Motion]
    """Their replays by the nominal robot."""
    squares_by_id: dict[int, tuple[Candidate, np.ndarray]] = field(default_factory=dict)
    """By identity of the candidate, whose arrays cannot be hashed."""
    motions: dict[int, Sequence[Motion]] = field(default_factory=dict)
    """Replays of all rows, by identity of the candidate."""

    def replays(self, candidates: Sequence[Candidate]) -> list[Sequence[Motion]]:
        """Replays of all rows by several candidates, each log with the numbers fitted without its fold."""
        new = list({id(c): c for c in candidates if id(c) not in self.motions and c.hypotheses}.values())
        folds = self.heldout_gap.folds.tolist()
        trials = [
            Rollout(log, extend_to_whole_log(effects_on(candidate, log.name, fold), rows, len(log)))
            for candidate in new
            for log, fold, rows in zip(self.logs, folds, self.heldout_gap.judged.rows, strict=True)
        ]
        found = iter(self.heldout_gap.replayer.motions(trials))
        for candidate in new:
            motions = [next(found) for _ in self.logs]
            self.motions[id(candidate)] = motions
            judged = self.heldout_gap.judged
            self.squares_by_id[id(candidate)] = (
                candidate,
                motion_squares(motions, judged, self.heldout_gap.replayer.robot),
            )
        return [self.motions[id(candidate)] if candidate.hypotheses else self.nominal for candidate in candidates]

    def squares(self, candidates: Sequence[Candidate]) -> list[np.ndarray]:
        """Sums of squares (logs,) of several candidates; those not in the cache are replayed as one batch."""
        new = list({id(c): c for c in candidates if id(c) not in self.squares_by_id and c.hypotheses}.values())
        for candidate, found in zip(new, self.heldout_gap.heldout_squares(new), strict=True):
            self.squares_by_id[id(candidate)] = candidate, found
        return [
            self.squares_by_id[id(candidate)][1] if candidate.hypotheses else self.heldout_gap.nominal
            for candidate in candidates
        ]
