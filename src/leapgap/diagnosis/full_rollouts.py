"""Fits of sets of effects to full rollouts.

Replays that restart from the log every 0.1 s are insensitive to slow influences: mass, inertia, centre of mass. Here
numbers are fitted to replays over all judged rows of a log, in the channels and scales of the headline gap
(Levenberg–Marquardt, finite differences), and judged on held-out logs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leapgap.diagnosis.candidates import Candidate, clip_numbers, effects_on_logs, inward
from leapgap.diagnosis.gap import HeldOutGap, scaled_errors
from leapgap.diagnosis.hypotheses import Hypothesis

DIFFERENCE = 0.25
"""Step of finite differences, as a share of the moderate departure; wide, because contacts make full rollouts rough."""
EVERY_S = 0.02  # Interval between the instants at which errors are compared, s
DAMPINGS = (0.03, 0.3, 2.0)
"""Levenberg–Marquardt dampings that are tried at each step, as shares of the curvature; folds use the middle one."""
STEPS = 6  # Largest number of Gauss–Newton steps
SETTLED = 0.005  # A fit has converged when its loss falls by a smaller share than this


@dataclass(frozen=True)
class FullRolloutFit(Candidate):
    """A candidate fitted to full rollouts."""

    loss: float  # Sum of squares, fitted on all logs
    heldout: np.ndarray  # Sum of squares of each log, fitted without its fold, (logs,)


@dataclass(frozen=True)
class Errors:
    """Scaled errors of all logs, concatenated."""

    sampled: np.ndarray  # Errors at the rows that are compared, (values,)
    squares: float  # Sum of squares at all rows

    @staticmethod
    def of(logs: Sequence[np.ndarray], every: Sequence[int]) -> "Errors":
        """From errors (rows, channels) of each log, compared at every ``every``-th row of it."""
        some = np.concatenate([of_log[::rows].ravel() for of_log, rows in zip(logs, every, strict=True)])
        return Errors(some, float(sum((of_log**2).sum() for of_log in logs)))


@dataclass(frozen=True)
class Slopes:
    """Errors at some numbers and their derivatives by departures of moderate size."""

    errors: Errors
    by_number: np.ndarray  # (values, numbers)

    def step(self, damping: float, kept: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Levenberg–Marquardt step that lowers the squares of the kept values, in moderate departures, (numbers,)."""
        slopes = self.by_number[kept]
        curvature = slopes.T @ slopes
        damped = curvature + np.diag(damping * np.diag(curvature) + 1e-9)
        return np.asarray(-np.linalg.solve(damped, slopes.T @ self.errors.sampled[kept]))

    def broyden_update(self, by: np.ndarray, errors: Errors) -> "Slopes":
        """Slopes after a step ``by`` (numbers,) that led to ``errors``, updated by Broyden's rule."""
        surprise = errors.sampled - self.errors.sampled - self.by_number @ by
        return Slopes(errors, self.by_number + surprise[:, None] * by / max(float(by @ by), 1e-12))


@dataclass
class FullRollouts:
    """Fits sets of effects to full rollouts."""

    heldout_gap: HeldOutGap

    def fit(self, hypotheses: tuple[Hypothesis, ...], numbers: np.ndarray) -> FullRolloutFit:
        """Fit to all logs by least squares; the numbers of each fold are one step from there with the other logs."""
        scale = np.concatenate([h.moderate for h in hypotheses])
        slopes = self.slopes(hypotheses, numbers)
        for _ in range(STEPS):
            tried = [clip_numbers(hypotheses, numbers + scale * slopes.step(damping)) for damping in DAMPINGS]
            found = [self.sample(of) for of in self.errors(hypotheses, tried)]
            best = int(np.argmin([errors.squares for errors in found]))
            if found[best].squares >= slopes.errors.squares:
                break
            settled = found[best].squares > (1 - SETTLED) * slopes.errors.squares
            slopes = slopes.broyden_update((tried[best] - numbers) / scale, found[best])
            numbers = tried[best]
            if settled:
                break
        slopes = self.slopes(hypotheses, numbers)
        folds = self.heldout_gap.folds
        fold_of_value = folds[self.log_of_value]
        of_folds = [
            clip_numbers(hypotheses, numbers + scale * slopes.step(DAMPINGS[1], fold_of_value != fold))
            for fold in range(int(folds.max()) + 1)
        ]
        candidates = effects_on_logs(hypotheses, of_folds, self.heldout_gap.names)
        heldout = self.heldout_gap.squares_with(candidates)[folds, np.arange(len(folds))]
        spread = self.covariance(slopes, scale)
        return FullRolloutFit(hypotheses, numbers, spread, np.array(of_folds), slopes.errors.squares, heldout)

    def covariance(self, slopes: Slopes, scale: np.ndarray) -> np.ndarray:
        """Covariance of the numbers by the scatter of the gradient over logs; errors within a log are correlated."""
        curvature = np.linalg.pinv(slopes.by_number.T @ slopes.by_number)
        logs = int(self.log_of_value.max()) + 1
        pull = slopes.by_number * slopes.errors.sampled[:, None]
        of_logs = np.array([pull[self.log_of_value == log].sum(axis=0) for log in range(logs)])
        scatter = of_logs.T @ of_logs * logs / max(logs - 1, 1)
        return np.asarray(curvature @ scatter @ curvature * scale[:, None] * scale)

    def slopes(self, hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> Slopes:
        """Errors at numbers, and finite differences about them within their ranges."""
        scale = np.concatenate([h.moderate for h in hypotheses])
        by = DIFFERENCE * scale
        sides = inward(hypotheses, numbers, by)
        tried = [numbers, *(numbers + np.diag(sides * by))]
        start, *moved = map(self.sample, self.errors(hypotheses, tried))
        slopes = [(of.sampled - start.sampled) / (side * DIFFERENCE) for of, side in zip(moved, sides, strict=True)]
        return Slopes(start, np.stack(slopes, axis=1))

    def errors(self, hypotheses: Sequence[Hypothesis], tried: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
        """Scaled errors ``[number][log]`` (rows, channels)."""
        gap = self.heldout_gap
        return scaled_errors(gap.judged, gap.replayer, effects_on_logs(hypotheses, tried, gap.names))

    def sample(self, errors: Sequence[np.ndarray]) -> Errors:
        """Scaled errors (rows, channels) of all logs, at the rows that are compared."""
        return Errors.of(errors, self.every)

    @cached_property
    def every(self) -> list[int]:
        """Number of rows between the compared rows of each log."""
        return [log.info.rows(EVERY_S) for log in self.heldout_gap.judged.logs]

    @cached_property
    def log_of_value(self) -> np.ndarray:
        """Index of the log of each compared value, (values,)."""
        judged = self.heldout_gap.judged
        instants = [len(range(0, rows, every)) for rows, every in zip(judged.rows, self.every, strict=True)]
        sizes = np.array(instants) * len(judged.channels)
        return np.repeat(np.arange(len(sizes)), sizes)
