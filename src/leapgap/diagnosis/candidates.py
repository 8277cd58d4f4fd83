"""Sets of hypotheses with fitted numbers: candidates of the search for causes, and those that it leaves open."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.effects.base import Effect

LEAST_SPREADS = 2.0  # A number differs from nominal when it is more than this many standard deviations away


@dataclass(frozen=True)
class Candidate:
    """A set of hypotheses that act together, with their fitted numbers."""

    hypotheses: tuple[Hypothesis, ...]
    numbers: np.ndarray  # Fitted on all logs; one vector for all hypotheses, (numbers,)
    covariance: np.ndarray  # Covariance of the numbers, (numbers, numbers)
    fold_numbers: np.ndarray  # Fitted without each fold, (folds, numbers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, one a hypothesis."""
        return tuple(h.name for h in self.hypotheses)

    @property
    def at_bound(self) -> bool:
        """Whether some number is at the end of its range."""
        return any(h.at_bound(n) for h, n in zip(self.hypotheses, self.split(), strict=True))

    @property
    def sensible(self) -> bool:
        """Whether every hypothesis differs from nominal and no number is at the end of its range."""
        departs = np.abs(self.departs) > LEAST_SPREADS * self.spread()
        return all(own.any() for own in self.split(departs)) and not self.at_bound

    @property
    def departs(self) -> np.ndarray:
        """Departures of the fitted numbers from those at which the effects are absent, (numbers,)."""
        return np.asarray(self.numbers - np.concatenate([np.zeros(0), *(h.nominal for h in self.hypotheses)]))

    def spread(self, model_error: float = 0.0) -> np.ndarray:
        """Standard deviations of the numbers, (numbers,).

        A share ``model_error`` of each departure from nominal counts as error of the simulation, as in ``Settings``; of
        a factor or a limit no more than that share of itself.
        """
        fitted = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        of_itself = np.array([p.logarithmic for h in self.hypotheses for p in h.parameters], dtype=bool)
        size = np.where(of_itself, np.minimum(np.abs(self.departs), np.abs(self.numbers)), np.abs(self.departs))
        return np.hypot(fitted, model_error * size)

    @property
    def ends(self) -> np.ndarray:
        """Index of the first number of each hypothesis, then the number of all, (hypotheses + 1,)."""
        return np.cumsum([0, *(len(h.parameters) for h in self.hypotheses)])

    def indices(self, some: Sequence[int]) -> list[int]:
        """Indices of the numbers of some hypotheses, which are told by their own indices."""
        ends = self.ends
        return [i for k in some for i in range(ends[k], ends[k + 1])]

    def split(self, numbers: np.ndarray | None = None) -> list[np.ndarray]:
        """Numbers (by default the fitted ones) of each hypothesis."""
        return split_numbers(self.hypotheses, self.numbers if numbers is None else numbers)

    def effects_on(self, log: str, fold: int | None) -> tuple[Effect, ...]:
        """Its effects on one log, with the numbers fitted without a fold (None: on all logs)."""
        numbers = self.numbers if fold is None else self.fold_numbers[fold]
        return tuple(h.on(log, own) for h, own in zip(self.hypotheses, self.split(numbers), strict=True))

    def typical_effects(self, logs: Sequence[str], fold: int | None = None) -> tuple[Effect, ...]:
        """Its effects at the median of some logs' values; ``fold`` as in ``effects_on``."""
        found = []
        for same in zip(*(self.effects_on(log, fold) for log in logs), strict=True):
            middle = {name: float(np.median([one.values[name] for one in same])) for name in same[0].values}
            found.append(replace(same[0].with_profile(()), **middle))
        return tuple(found)


def nominal_candidate(folds: int) -> Candidate:
    """The robot without any effect, for so many folds."""
    return Candidate((), np.zeros(0), np.zeros((0, 0)), np.zeros((folds, 0)))


def in_words(fit: Candidate) -> str:
    """``payload 1.7 + foot_friction at front 0.44``."""
    parts = []
    for h, numbers in zip(fit.hypotheses, fit.split(), strict=True):
        parts.append(f"{h.label} {' '.join(f'{n:.4g}' for n in numbers)}")
    return " + ".join(parts)


def split_numbers(hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> list[np.ndarray]:
    """Split a vector of numbers into those of each hypothesis."""
    return np.split(numbers, np.cumsum([len(h.parameters) for h in hypotheses])[:-1]) if hypotheses else []


def clip_numbers(hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> np.ndarray:
    """Clip the numbers of hypotheses to their ranges."""
    parts = [h.clip(n) for h, n in zip(hypotheses, split_numbers(hypotheses, numbers), strict=True)]
    return np.concatenate(parts) if parts else numbers


def inward(hypotheses: Sequence[Hypothesis], numbers: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Sign of each step ``by`` (numbers,) that stays in the range of its number: 1, or −1 for the opposite one."""
    lower, upper = (np.concatenate([h.bounds[side] for h in hypotheses]) for side in (0, 1))
    return np.where((numbers + by <= upper) & (numbers + by >= lower), 1.0, -1.0)


def effects_on_logs(
    hypotheses: Sequence[Hypothesis], tried: Sequence[np.ndarray], logs: Sequence[str]
) -> list[list[tuple[Effect, ...]]]:
    """Effects ``[number][log]`` for several vectors of numbers of the same hypotheses."""
    return [
        [
            tuple(h.on(log, own) for h, own in zip(hypotheses, split_numbers(hypotheses, numbers), strict=True))
            for log in logs
        ]
        for numbers in tried
    ]


PLACES = 2  # Number of rivals in the place of one cause that experiments are to tell apart


@dataclass(frozen=True)
class Rival:
    """A set of causes that could be true."""

    name: str  # Name of the effect that may be the one
    fit: Candidate


@dataclass(frozen=True)
class Undecided:
    """What an answer leaves open."""

    names: tuple[str, ...] = ()  # The first cause of the answer that has rivals, with these; empty where none has
    fits: tuple[Rival, ...] = ()  # The answer, and fits with the other names in its place; empty without an answer
    share: float = 0.0  # Probability of the likeliest rival
