"""How far: what believed effects close of the headline gap on jumps they were not fitted on."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.gap import Judged, counts, pooled, squares, squares_of
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer, Rollout

LEAST_ABOVE = 0.05
"""Of the noise floor: a share of less is a share of noise."""


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % interval over jumps drawn again."""

    value: float
    low: float
    high: float

    @property
    def at_most_all(self) -> "Interval":
        """The same of a share, with nothing above 1 and the value within: what is told to a person.

        A corrected gap below the noise floor is there by chance, and no more than all of a gap can go away.
        """
        value = min(self.value, 1.0)
        return Interval(value, min(self.low, value), max(min(self.high, 1.0), value))


def above_noise(gap: float, floor: float) -> bool:
    """Whether a headline gap has something to close."""
    return gap - floor > LEAST_ABOVE * floor


def resamples(jumps: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Bootstrap over jumps: indices (draws, jumps)."""
    return rng.integers(0, jumps, size=(draws, jumps))


def closure(
    nominal: np.ndarray, corrected: np.ndarray, floor: np.ndarray, judged: Judged, draws: np.ndarray
) -> Interval:
    """Share of the headline gap above its noise floor that goes away; arguments are sums of squares a jump.

    A gap that has nothing to close closes 0.
    """
    number = counts(judged)

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


def on_whole_log(effects: Sequence[Effect], rows: int, all_rows: int) -> tuple[Effect, ...]:
    """Effects found on the first rows of a log, on all of it."""
    return tuple(effect.extend_to(rows, all_rows) for effect in effects)


def heldout_squares(
    judged: Judged, replayer: Replayer, beliefs: Sequence[Candidate], folds: Sequence[int]
) -> np.ndarray:
    """Headline sums of squares on each jump, at numbers fitted without its fold, (beliefs, jumps)."""
    candidates = [
        [effects_on(belief, jump.name, fold) for jump, fold in zip(judged.jumps, folds, strict=True)]
        for belief in beliefs
    ]
    return squares(judged, replayer, candidates) if candidates else np.zeros((0, len(judged.jumps)))


@dataclass(frozen=True)
class HeldOutGap:
    """What every belief about some logs is measured with: whole jumps that it was not fitted on."""

    judged: Judged
    replayer: Replayer
    folds: np.ndarray
    """Which fold each jump is held out with, (jumps,)."""
    nominal: np.ndarray
    """Sums of squares of the nominal robot, (jumps,),"""
    floor: np.ndarray
    """and of noise alone, (jumps,)."""
    draws: np.ndarray
    """Jumps drawn again, (draws, jumps)."""

    def heldout(self, beliefs: Sequence[Candidate]) -> np.ndarray:
        """Sums of squares on jumps not fitted on, (beliefs, jumps)."""
        return heldout_squares(self.judged, self.replayer, beliefs, self.folds.tolist())

    def closure(self, corrected: np.ndarray) -> Interval:
        """Of sums of squares (jumps,)."""
        return closure(self.nominal, corrected, self.floor, self.judged, self.draws)

    def closes(self, corrected: np.ndarray) -> float:
        """The same without an interval."""
        return closure(self.nominal, corrected, self.floor, self.judged, self.draws[:1]).value

    @property
    def shows(self) -> bool:
        """Whether whole jumps have a gap to close; where not, only short replays can tell."""
        return above_noise(self.gap(self.nominal), self.gap(self.floor))

    def gap(self, corrected: np.ndarray) -> float:
        """Headline gap of sums of squares (jumps,)."""
        return pooled(corrected, self.judged)

    def gap_by_log(self, corrected: np.ndarray) -> dict[str, dict[str, float]]:
        """Headline gap of each log, nominal and corrected."""
        both = np.sqrt(np.stack([self.nominal, corrected]) / counts(self.judged))
        names = [jump.name for jump in self.judged.jumps]
        return {n: {"nominal": float(a), "corrected": float(b)} for n, a, b in zip(names, *both, strict=True)}

    def with_steps(self, largest_step_s: float) -> "HeldOutGap":
        """In replays of other steps."""
        replayer = self.replayer.with_steps(largest_step_s)
        nominal = squares(self.judged, replayer, [[()] * len(self.judged.jumps)])[0]
        return replace(self, replayer=replayer, nominal=nominal)


@dataclass
class HeldOutReduction:
    """Sums of squares (jumps,) of beliefs on jumps they were not fitted on; each belief is replayed once."""

    yardstick: HeldOutGap
    jumps: Sequence[Log]
    """The logs with all their rows, beyond those that are judged."""
    nominal: Sequence[Motion]
    """Their replays by the nominal robot."""
    known: dict[int, tuple[Candidate, np.ndarray]] = field(default_factory=dict)
    """By identity: beliefs hold arrays."""
    motions: dict[int, Sequence[Motion]] = field(default_factory=dict)
    """Replays of all rows, of the beliefs that were asked for them."""

    def replays(self, beliefs: Sequence[Candidate]) -> list[Sequence[Motion]]:
        """Replays of all rows by several beliefs, each log with the numbers that were fitted without it."""
        new = list({id(b): b for b in beliefs if id(b) not in self.motions and b.hypotheses}.values())
        folds = self.yardstick.folds.tolist()
        trials = [
            Rollout(jump, on_whole_log(effects_on(belief, jump.name, fold), rows, len(jump)))
            for belief in new
            for jump, fold, rows in zip(self.jumps, folds, self.yardstick.judged.rows, strict=True)
        ]
        found = iter(self.yardstick.replayer.motions(trials))
        for belief in new:
            motions = [next(found) for _ in self.jumps]
            self.motions[id(belief)] = motions
            judged = self.yardstick.judged
            self.known[id(belief)] = belief, squares_of(motions, judged, self.yardstick.replayer.robot)
        return [self.motions[id(belief)] if belief.hypotheses else self.nominal for belief in beliefs]

    def of(self, beliefs: Sequence[Candidate]) -> list[np.ndarray]:
        """Those of several beliefs, replayed as one batch where they are not known yet."""
        new = list({id(b): b for b in beliefs if id(b) not in self.known and b.hypotheses}.values())
        for belief, found in zip(new, self.yardstick.heldout(new), strict=True):
            self.known[id(belief)] = belief, found
        return [self.known[id(belief)][1] if belief.hypotheses else self.yardstick.nominal for belief in beliefs]
