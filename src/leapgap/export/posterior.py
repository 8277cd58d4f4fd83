"""How surely the numbers of a correction are known together: a normal distribution, cut at their limits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from scipy.special import ndtri

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.report import Cause
from leapgap.effects.base import Effect
from leapgap.robot.model import Robot

SIGMAS = 1.96  # half the width of a 95 % interval, in standard deviations


@dataclass(frozen=True)
class Posterior:
    """The numbers of some effects with their covariance."""

    effects: tuple[Effect, ...]  # with the most likely numbers
    numbers: tuple[tuple[int, str], ...]  # of each number, the index of its effect and the name of its parameter
    covariance: np.ndarray  # (numbers, numbers)
    lower: np.ndarray  # limits of the numbers, (numbers,)
    upper: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """The most likely numbers, (numbers,)."""
        return np.array([self.effects[which].values[name] for which, name in self.numbers])

    @property
    def labels(self) -> tuple[str, ...]:
        """``joint_damping at elbow: damping`` of each number."""
        of = [(self.effects[which], name) for which, name in self.numbers]
        return tuple(f"{effect.name} at {effect.location}: {name}" for effect, name in of)

    def samples(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Numbers drawn together, (count, numbers); those beyond a limit are put at it.

        Along each principal axis there is one draw in each of ``count`` equally likely parts (a Latin hypercube), so
        that few draws have the right intervals.
        """
        if not self.numbers:
            return np.zeros((count, 0))
        values, vectors = np.linalg.eigh(self.covariance)
        spread = vectors * np.sqrt(np.maximum(values, 0.0))
        parts = np.stack([rng.permutation(count) for _ in self.numbers], axis=1)
        drawn = self.mean + ndtri((parts + 0.5) / count) @ spread.T
        return np.clip(drawn, self.lower, self.upper)

    def with_numbers(self, numbers: np.ndarray) -> tuple[Effect, ...]:
        """The effects with other numbers (numbers,)."""
        changed = list(self.effects)
        for (which, name), number in zip(self.numbers, numbers.tolist(), strict=True):
            changed[which] = replace(changed[which], **{name: number})
        return tuple(changed)


def posterior_of(
    robot: Robot, correction: Sequence[Effect], causes: Sequence[Cause], fit: Candidate | None = None
) -> Posterior:
    """The posterior of a correction: spreads by the 95 % intervals of its causes, correlations by the fit's covariance.

    An effect without a cause is taken as known. Without a fit, the numbers are independent.
    """
    known = {(cause.effect, cause.location): cause.parameters for cause in causes}
    numbers, spread, lower, upper = [], [], [], []
    for which, effect in enumerate(correction):
        estimates = known.get((effect.called(robot), effect.location), {})
        for parameter in effect.parameters(robot, effect.location):
            if parameter.name not in estimates or parameter.name not in effect.values:
                continue
            low, high = estimates[parameter.name].ci95
            numbers.append((which, parameter.name))
            spread.append((high - low) / (2 * SIGMAS))
            lower.append(min(parameter.lower, effect.values[parameter.name]))
            upper.append(max(parameter.upper, effect.values[parameter.name]))
    correlation = correlations([(correction[which], name) for which, name in numbers], robot, fit)
    covariance = correlation * np.outer(spread, spread)
    return Posterior(tuple(correction), tuple(numbers), covariance, np.array(lower), np.array(upper))


def correlations(numbers: Sequence[tuple[Effect, str]], robot: Robot, fit: Candidate | None) -> np.ndarray:
    """Correlations of numbers by the covariance of a fit, (numbers, numbers); none where the fit has not the number."""
    found = np.eye(len(numbers))
    if fit is None or not fit.hypotheses:
        return found
    covariance = np.nan_to_num(fit.covariance)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    own = [(h, p.name) for h in fit.hypotheses for p in h.parameters]
    row = {(h.name, h.location, name): i for i, (h, name) in enumerate(own) if h.per_log is None}
    at = [row.get((effect.called(robot), effect.location, name)) for effect, name in numbers]
    for (i, one), (k, other) in permutations(enumerate(at), 2):
        if one is not None and other is not None:
            found[i, k] = np.clip(covariance[one, other] / (spread[one] * spread[other]), -1.0, 1.0)
    return found
