"""Likelihood of sets of effects, by replays of whole logs and of short pieces, with what evidence says beforehand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.diagnosis.candidates import clip_numbers, effects_on_logs
from leapgap.diagnosis.evidence.base import Evidence
from leapgap.diagnosis.full_rollouts import EVERY_S
from leapgap.diagnosis.gap import HeldOutGap, scaled_error
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.short_rollouts import ROUGH, ShortRollouts

INDEPENDENT_S = 0.2  # Errors of whole replays at one instant say little more than those so long before
ALIKE = 3  # A robot that has drifted off has done so in all channels: of so many values at an instant one counts
PIECE_VALUES = 6  # A short piece counts as so many independent values
USUAL = 1.0  # A usual χ² of a piece over its number of values: below it pieces count alike
LOGS_AT_ONCE = 64  # Whole replays whose motions are in memory at once
DIFFERENCE = 0.1  # Step of finite differences, as a share of the scale of a number


@dataclass(frozen=True)
class LogErrors:
    """Errors of one log at some numbers, or their derivatives by the scaled numbers in a further axis."""

    whole: np.ndarray
    """Scaled errors of its whole replay at the compared instants, (values,); empty where these do not count."""
    pieces: np.ndarray  # Whitened errors of its short pieces, (pieces, values)


def independent(values: int) -> float:
    """Number of independent values of whole replays among so many compared ones."""
    return values * EVERY_S / INDEPENDENT_S


def difference(moved: Sequence[np.ndarray], start: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Finite differences by several numbers, (…, numbers), scaled by ``share`` (numbers,)."""
    found = [(one - start) * s for one, s in zip(moved, share, strict=True)]
    return np.stack(found, axis=-1) if found else np.zeros((*start.shape, 0))


@dataclass(frozen=True)
class Numbers:
    """The numbers of a set of effects: what is expected beforehand, and which are fitted."""

    hypotheses: tuple[Hypothesis, ...]
    centre: np.ndarray  # What evidence says, else nominal, (numbers,)
    spread: np.ndarray  # Standard deviation of what evidence says, else a moderate departure, (numbers,)
    fitted: np.ndarray  # Whether each number is fitted, bool, (numbers,); what evidence says is held

    @staticmethod
    def of(hypotheses: tuple[Hypothesis, ...], told: Mapping[str, Evidence]) -> "Numbers":
        """Numbers of some hypotheses; evidence by the parameter that it tells."""
        centre, spread, fitted = [], [], []
        for h in hypotheses:
            for p, moderate in zip(h.parameters, np.abs(h.moderate), strict=True):
                one = told.get(f"{h.name}.{p.name}")
                centre.append(p.nominal if one is None else one.value)
                spread.append(moderate if one is None else one.spread)
                fitted.append(one is None or not one.held)
        return Numbers(hypotheses, np.array(centre), np.array(spread), np.array(fitted, bool))

    @property
    def scale(self) -> np.ndarray:
        """Scale of the fitted numbers, (fitted,)."""
        return self.spread[self.fitted]

    def departs(self, numbers: np.ndarray) -> np.ndarray:
        """Fitted numbers as scaled departures from what is expected, (fitted,)."""
        return ((numbers - self.centre) / self.spread)[self.fitted]

    def moved(self, numbers: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Numbers after a scaled step of the fitted ones, within their ranges, (numbers,)."""
        found = numbers.copy()
        found[self.fitted] += by * self.scale
        return clip_numbers(self.hypotheses, found)

    def covariance(self, of_fitted: np.ndarray) -> np.ndarray:
        """Covariance of all numbers from that of the fitted ones, scaled; that of the others is evidence's."""
        found = np.diag(self.spread**2)
        found[np.ix_(self.fitted, self.fitted)] = of_fitted * self.scale[:, None] * self.scale
        return found

    def room(self, numbers: np.ndarray) -> np.ndarray:
        """Largest scaled steps of the fitted numbers down and up within their ranges, (2, fitted)."""
        return np.asarray(((self.limits - numbers) / self.spread)[:, self.fitted])

    @property
    def limits(self) -> np.ndarray:
        """Lower and upper limits of all numbers, (2, numbers)."""
        return np.array([np.concatenate([h.bounds[side] for h in self.hypotheses]) for side in (0, 1)])

    @property
    def differences(self) -> tuple[np.ndarray, np.ndarray]:
        """Sizes of finite differences of all numbers, and lower and upper limits (2, numbers)."""
        return DIFFERENCE * np.abs(np.concatenate([h.moderate for h in self.hypotheses])), self.limits


@dataclass(frozen=True)
class JointLikelihood:
    """The likelihood, by replays of whole logs and of short pieces."""

    heldout_gap: HeldOutGap
    short: ShortRollouts

    @property
    def logs(self) -> range:
        """Indices of the logs."""
        return range(len(self.heldout_gap.folds))

    def errors(
        self, hypotheses: tuple[Hypothesis, ...], tried: Sequence[np.ndarray], whole: bool, logs: Sequence[int]
    ) -> list[list[LogErrors]]:
        """Errors ``[tried][log]`` of several vectors of numbers; those of whole replays only where ``whole``."""
        sets = effects_on_logs(hypotheses, tried, self.heldout_gap.names)
        of_whole = self.whole_errors(sets, logs) if whole else [[np.zeros(0)] * len(logs)] * len(sets)
        of_pieces = self.short.residuals(sets, logs)
        return [
            [LogErrors(*of_log) for of_log in zip(*both, strict=True)] for both in zip(of_whole, of_pieces, strict=True)
        ]

    def whole_errors(self, sets: Sequence[Sequence[tuple]], logs: Sequence[int]) -> list[list[np.ndarray]]:
        """Scaled errors ``[set][log]`` (values,) of whole replays of some logs, with effects ``[set][any log]``."""
        judged, found = self.heldout_gap.judged, list[list[np.ndarray]]()
        at_once = max(1, LOGS_AT_ONCE // max(1, len(logs)))
        for first in range(0, len(sets), at_once):
            some = sets[first : first + at_once]
            trials = [of_all[log] for of_all in map(judged.trials, some) for log in logs]
            errors = zip(self.heldout_gap.replayer.motions(trials), [*logs] * len(some), strict=True)
            of_logs = iter([scaled_error(one, judged, log)[:: self.every[log]].ravel() for one, log in errors])
            found += [[next(of_logs) for _ in logs] for _ in some]
        return found

    @cached_property
    def every(self) -> list[int]:
        """Number of rows between the compared rows of each log."""
        return [log.info.rows(EVERY_S) for log in self.heldout_gap.judged.logs]

    @cached_property
    def rough(self) -> "JointLikelihood":
        """The likelihood by long steps of the simulation; rows that are uneven are simulated as they are."""
        if not all(log.is_even for log in self.heldout_gap.judged.logs):
            return self
        step_s = ROUGH * self.short.replayer.largest_step_s
        gap = replace(self.heldout_gap, replayer=self.heldout_gap.replayer.with_steps(step_s), cache={}, motions={})
        return JointLikelihood(gap, self.short.with_steps(step_s))

    def loss(self, errors: Sequence[LogErrors], departs: np.ndarray) -> float:
        """Minus the logarithm of the likelihood, up to a constant; ``departs`` from what is expected, scaled."""
        values = np.concatenate([of.whole for of in errors])
        whole = independent(len(values)) / ALIKE / 2 * np.log(np.mean(values**2)) if len(values) else 0.0
        chi2 = np.concatenate([np.mean(of.pieces**2, axis=1) for of in errors])
        return float(whole + PIECE_VALUES / 2 * np.log(USUAL + chi2).sum()) + 0.5 * float(departs @ departs)

    def normal(
        self, errors: Sequence[LogErrors], slopes: Sequence[LogErrors], departs: np.ndarray, fold: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Curvature and slope of ``loss`` by the scaled numbers, (numbers, numbers) and (numbers,), without a fold."""
        numbers = slopes[0].pieces.shape[2]
        values = np.concatenate([of.whole for of in errors])
        of_whole = independent(len(values)) / ALIKE / max(float(values @ values), 1e-12)
        curvature, slope = np.zeros((numbers, numbers)), np.zeros(numbers)
        for own, of, by in zip(self.heldout_gap.folds, errors, slopes, strict=True):
            if own == fold:
                continue
            weights = PIECE_VALUES / (USUAL + np.mean(of.pieces**2, axis=1)) / max(1, of.pieces.shape[1])
            flat = by.pieces.reshape(-1, numbers)
            weighted = (by.pieces * weights[:, None, None]).reshape(-1, numbers)
            by_whole = by.whole[: len(of.whole)]
            curvature += of_whole * by_whole.T @ by_whole + weighted.T @ flat
            slope += of_whole * by_whole.T @ of.whole + weighted.T @ of.pieces.ravel()
        return curvature + np.eye(len(slope)), slope + departs

    def slopes(
        self, about: Numbers, numbers: np.ndarray, errors: Sequence[LogErrors], whole: bool, logs: Sequence[int]
    ) -> list[LogErrors]:
        """Derivatives by the scaled numbers of some logs, whose ``errors`` at the numbers are known.

        By long steps of the simulation, whose error cancels in differences.
        """
        size, (lower, upper) = about.differences
        by = np.where(numbers + size <= upper, size, -np.minimum(size, numbers - lower))
        by = np.where(by == 0, size, by)
        moved = self.rough.errors(about.hypotheses, list((numbers + np.diag(by))[about.fitted]), whole, logs)
        if self.rough is not self:
            (errors,) = self.rough.errors(about.hypotheses, [numbers], whole, logs)
        share = (about.spread / by)[about.fitted]
        return [
            LogErrors(
                difference([of[k].whole for of in moved], start.whole, share),
                difference([of[k].pieces for of in moved], start.pieces, share),
            )
            for k, start in enumerate(errors)
        ]


def bounded_step(curvature: np.ndarray, slope: np.ndarray, damping: float, room: np.ndarray) -> np.ndarray:
    """Levenberg–Marquardt step in the scaled numbers within some room (2, numbers), by the normal equations.

    What leaves its range is held at the end of it and the others answer to that: a step that is only cut there may
    lead uphill.
    """
    return bounded_minimum(curvature + damping * np.diag(np.diag(curvature)), slope, *room)


def bounded_minimum(curvature: np.ndarray, slope: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Minimum of ½ xᵀ C x + sᵀ x within limits, (numbers,); what leaves its range farthest is held there, in turn."""
    found, free = np.clip(np.zeros(len(slope)), lower, upper), lower < upper
    while free.any():
        rest = slope[free] + curvature[np.ix_(free, ~free)] @ found[~free]
        found[free] = -np.linalg.solve(curvature[np.ix_(free, free)], rest)
        beyond = np.where(free, np.maximum(lower - found, found - upper), 0.0)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 0:
            break
        free[worst] = False
        found[worst] = np.clip(found[worst], lower[worst], upper[worst])
    return found
