"""How far: what believed effects close of the headline gap on logs they were not fitted on."""

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
"""Of the noise floor: a share of less is a share of noise."""


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % interval over resampled logs."""

    value: float
    low: float
    high: float

    @property
    def capped_at_one(self) -> "Interval":
        """The same of a share, with nothing above 1 and the value within: what is told to a person.

        A corrected gap below the noise floor is there by chance, and no more than all of a gap can go away.
        """
        value = min(self.value, 1.0)
        return Interval(value, min(self.low, value), max(min(self.high, 1.0), value))


def above_noise(gap: float, floor: float) -> bool:
    """Whether a headline gap has something to close."""
    return gap - floor > LEAST_ABOVE * floor


def resamples(logs: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Bootstrap over logs: indices (draws, logs)."""
    return rng.integers(0, logs, size=(draws, logs))


def closure(
    nominal: np.ndarray, corrected: np.ndarray, floor: np.ndarray, judged: JudgedLogs, draws: np.ndarray
) -> Interval:
    """Share of the headline gap above its noise floor that goes away; arguments are sums of squares a log.

    A gap that has nothing to close closes 0.
    """
    number = value_counts(judged)

    def of(chosen: np.ndarray) -> float:
        values = number[chosen].sum()
        before, after, least = (np.sqrt(s[chosen].sum() / values) for s in (nominal, corrected, floor))
        return float((before - after) / (before - least)) if above_noise(before, least) else 0.0

    sample = [of(chosen) for chosen in draws]
    return Interval(of(np.arange(len(number))), float(np.percentile(sample, 2.5)), float(np.percentile(sample, 97.5)))


def effects_on(fit: Candidate, log: str, fold: int | None) -> tuple[Effect, ...]:
    """Effects of a fit on one log, as fitted without a fold (None: on all logs)."""
    numbers = fit.numbers if fold is None else fit.fold_numbers[fold]
    return tuple(h.on(log, own) for h, own in zip(fit.hypotheses, fit.split(numbers), strict=True))


def extend_to_whole_log(effects: Sequence[Effect], rows: int, all_rows: int) -> tuple[Effect, ...]:
    """Effects found on the first rows of a log, on all of it."""
    return tuple(effect.extend_to(rows, all_rows) for effect in effects)


def heldout_squares(
    judged: JudgedLogs, replayer: Replayer, beliefs: Sequence[Candidate], folds: Sequence[int]
) -> np.ndarray:
    """Headline sums of squares on each log, at numbers fitted without its fold, (beliefs, logs)."""
    candidates = [
        [effects_on(belief, log.name, fold) for log, fold in zip(judged.logs, folds, strict=True)] for belief in beliefs
    ]
    return candidate_squares(judged, replayer, candidates) if candidates else np.zeros((0, len(judged.logs)))


@dataclass(frozen=True)
class HeldOutGap:
    """What every belief about some logs is measured with: full rollouts that it was not fitted on."""

    judged: JudgedLogs
    replayer: Replayer
    folds: np.ndarray
    """Which fold each log is held out with, (logs,)."""
    nominal: np.ndarray
    """Sums of squares of the nominal robot, (logs,),"""
    floor: np.ndarray
    """and of noise alone, (logs,)."""
    draws: np.ndarray
    """Jumps drawn again, (draws, logs)."""

    def heldout_squares(self, beliefs: Sequence[Candidate]) -> np.ndarray:
        """Sums of squares on logs not fitted on, (beliefs, logs)."""
        return heldout_squares(self.judged, self.replayer, beliefs, self.folds.tolist())

    def closure(self, corrected: np.ndarray) -> Interval:
        """Of sums of squares (logs,)."""
        return closure(self.nominal, corrected, self.floor, self.judged, self.draws)

    def closure_value(self, corrected: np.ndarray) -> float:
        """The same without an interval."""
        return closure(self.nominal, corrected, self.floor, self.judged, self.draws[:1]).value

    @property
    def has_gap(self) -> bool:
        """Whether full rollouts have a gap to close; where not, only short replays can tell."""
        return above_noise(self.gap(self.nominal), self.gap(self.floor))

    def gap(self, corrected: np.ndarray) -> float:
        """Headline gap of sums of squares (logs,)."""
        return headline_gap(corrected, self.judged)

    def gap_by_log(self, corrected: np.ndarray) -> dict[str, dict[str, float]]:
        """Headline gap of each log, nominal and corrected."""
        both = np.sqrt(np.stack([self.nominal, corrected]) / value_counts(self.judged))
        names = [log.name for log in self.judged.logs]
        return {n: {"nominal": float(a), "corrected": float(b)} for n, a, b in zip(names, *both, strict=True)}

    def with_steps(self, largest_step_s: float) -> "HeldOutGap":
        """In replays of other steps."""
        replayer = self.replayer.with_steps(largest_step_s)
        nominal = candidate_squares(self.judged, replayer, [[()] * len(self.judged.logs)])[0]
        return replace(self, replayer=replayer, nominal=nominal)


@dataclass
class HeldOutFits:
    """Sums of squares (logs,) of beliefs on logs they were not fitted on; each belief is replayed once."""

    heldout_gap: HeldOutGap
    logs: Sequence[Log]
    """The logs with all their rows, beyond those that are judged."""
    nominal: Sequence[Motion]
    """Their replays by the nominal robot."""
    squares_by_id: dict[int, tuple[Candidate, np.ndarray]] = field(default_factory=dict)
    """By identity: beliefs hold arrays."""
    motions: dict[int, Sequence[Motion]] = field(default_factory=dict)
    """Replays of all rows, of the beliefs that were asked for them."""

    def replays(self, beliefs: Sequence[Candidate]) -> list[Sequence[Motion]]:
        """Replays of all rows by several beliefs, each log with the numbers that were fitted without it."""
        new = list({id(b): b for b in beliefs if id(b) not in self.motions and b.hypotheses}.values())
        folds = self.heldout_gap.folds.tolist()
        trials = [
            Rollout(log, extend_to_whole_log(effects_on(belief, log.name, fold), rows, len(log)))
            for belief in new
            for log, fold, rows in zip(self.logs, folds, self.heldout_gap.judged.rows, strict=True)
        ]
        found = iter(self.heldout_gap.replayer.motions(trials))
        for belief in new:
            motions = [next(found) for _ in self.logs]
            self.motions[id(belief)] = motions
            judged = self.heldout_gap.judged
            self.squares_by_id[id(belief)] = belief, motion_squares(motions, judged, self.heldout_gap.replayer.robot)
        return [self.motions[id(belief)] if belief.hypotheses else self.nominal for belief in beliefs]

    def squares(self, beliefs: Sequence[Candidate]) -> list[np.ndarray]:
        """Those of several beliefs, replayed as one batch where they are not known yet."""
        new = list({id(b): b for b in beliefs if id(b) not in self.squares_by_id and b.hypotheses}.values())
        for belief, found in zip(new, self.heldout_gap.heldout_squares(new), strict=True):
            self.squares_by_id[id(belief)] = belief, found
        return [
            self.squares_by_id[id(belief)][1] if belief.hypotheses else self.heldout_gap.nominal for belief in beliefs
        ]
