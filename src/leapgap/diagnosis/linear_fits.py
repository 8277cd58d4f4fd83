"""Fits of many numbers by a linear model of the errors: of all logs, and of each fold without its own logs.

Errors of short pieces and of whole logs, and their derivatives, are those of ``joint_likelihood``. What they say is
kept as inner products, so that fits with other weights, without a fold or without a number cost no simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.joint_likelihood import PIECE_VALUES, LogErrors, Numbers, bounded_minimum, independent

ITERATIONS = 10  # Largest number of reweighted least-squares steps of a fit
SETTLED = 1e-4  # A fit has converged when no number moves by more than this share of its moderate departure
USUAL_SPREAD = 1.0
"""Least standard deviation beforehand by which the interval of a number is told: however much a fit distrusts
departures, so much was possible."""
FREE_SPREAD = 3.0  # Standard deviation beforehand of a number that may depart far, in moderate departures


@dataclass(frozen=True)
class Weighting:
    """How much pieces, whole logs and the nominal robot count against each other in a fit."""

    spread: float  # Standard deviation beforehand of a number that may not depart far, in moderate departures
    whole: bool  # Whether whole logs count, about as much as pieces; else pieces alone count, with all their values


@dataclass(frozen=True)
class LinearModel:
    """Errors of all logs as linear functions of the fitted numbers, in scaled departures from what is expected."""

    folds: np.ndarray  # Fold of each log, (logs,)
    fold_of_piece: np.ndarray  # Fold of the log of each piece, (pieces,)
    pieces: np.ndarray
    """Inner products of the errors at no departure and their derivatives, (pieces, 1 + numbers, 1 + numbers)."""
    whole: np.ndarray  # The same of the whole logs, (logs, 1 + numbers, 1 + numbers)
    piece_values: int
    whole_values: int
    bounds: np.ndarray  # Lower and upper limits of the scaled departures, (2, numbers)
    free: np.ndarray  # Whether each number may depart far, bool, (numbers,)

    @staticmethod
    def of(
        about: Numbers,
        numbers: np.ndarray,
        errors: Sequence[LogErrors],
        slopes: Sequence[LogErrors],
        folds: np.ndarray,
        free: np.ndarray,
    ) -> "LinearModel":
        """From errors at some numbers and their derivatives by the scaled ones; ``free`` (numbers of all effects,)."""
        departs = about.departs(numbers)
        own = [columns_of(of.pieces, by.pieces, departs) for of, by in zip(errors, slopes, strict=True)]
        whole = [columns_of(of.whole, by.whole, departs) for of, by in zip(errors, slopes, strict=True)]
        pieces = np.concatenate(own)
        return LinearModel(
            folds,
            np.repeat(folds, [len(of_log) for of_log in own]),
            pieces.transpose(0, 2, 1) @ pieces,
            np.stack([of_log.T @ of_log for of_log in whole]),
            pieces.shape[1],
            sum(map(len, whole)),
            np.sort([about.departs(limits) for limits in about.differences[1]], axis=0),
            free[about.fitted],
        )

    def spreads(self, weighting: Weighting) -> np.ndarray:
        """Standard deviation of each scaled departure beforehand, (numbers,)."""
        return np.where(self.free, max(FREE_SPREAD, weighting.spread), weighting.spread)

    def equations(
        self, weighting: Weighting, departs: np.ndarray, fold: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Curvature (numbers, numbers) and slope at no departure (numbers,) of the errors of all logs but a fold's.

        Pieces far from what noise explains at ``departs`` count less.
        """
        at = np.concatenate([[1.0], departs])
        chi2 = np.maximum(((at @ self.pieces) * at).sum(axis=1), 0.0)
        values = PIECE_VALUES if weighting.whole else 2 * self.piece_values
        emphasis = values / (self.piece_values + chi2) * (self.fold_of_piece != fold)
        products = np.tensordot(emphasis, self.pieces, axes=1)
        if weighting.whole:
            kept = self.folds != fold
            of_whole = self.whole[kept].sum(axis=0)
            number = independent(self.whole_values) * float(kept.mean())
            products = products + number / max(float(at @ of_whole @ at), 1e-12) * of_whole
        return products[1:, 1:], products[1:, 0]

    def fit(self, weighting: Weighting, expected: np.ndarray, fold: int | None = None) -> np.ndarray:
        """Most likely scaled departures without a fold, within their limits, (numbers,), from those ``expected``."""
        departs = expected
        trust = np.diag(1 / self.spreads(weighting) ** 2)
        for _ in range(ITERATIONS):
            before = departs
            curvature, slope = self.equations(weighting, departs, fold)
            departs = bounded_minimum(curvature + trust, slope - trust @ expected, *self.bounds)
            if np.abs(departs - before).max(initial=0.0) < SETTLED:
                break
        return departs

    def covariance(self, weighting: Weighting, departs: np.ndarray) -> np.ndarray:
        """Covariance of the scaled departures at a fit, by the curvature there, (numbers, numbers)."""
        curvature, _ = self.equations(weighting, departs)
        return np.asarray(np.linalg.inv(curvature + np.diag(1 / self.spreads(weighting) ** 2)))


@dataclass(frozen=True)
class LinearFits:
    """Fits of one set of effects by one linear model, as candidates."""

    about: Numbers
    model: LinearModel
    expected: np.ndarray
    """Scaled departures beforehand of the fit to all logs, then of that without each fold, (1 + folds, numbers)."""

    def candidate(self, weighting: Weighting) -> Candidate:
        """The fit to all logs, with the numbers of each fold from the other folds alone."""
        model, (own, *without) = self.model, self.expected
        departs = model.fit(weighting, own)
        folds = [model.fit(weighting, expected, fold) for fold, expected in enumerate(without)]
        numbers, *of_folds = (self.about.moved(self.about.centre.copy(), one) for one in (departs, *folds))
        usual = replace(weighting, spread=max(weighting.spread, USUAL_SPREAD))
        covariance = self.about.covariance(model.covariance(usual, departs))
        return Candidate(self.about.hypotheses, numbers, covariance, np.array(of_folds))

    def spread_left(self, weighting: Weighting, numbers: np.ndarray) -> np.ndarray:
        """Share of the standard deviation beforehand that the logs leave of each number, (numbers,); 0 where held."""
        about, model = self.about, self.model
        found = np.zeros(len(numbers))
        covariance = model.covariance(weighting, about.departs(numbers))
        found[about.fitted] = np.sqrt(np.diag(covariance)) / model.spreads(weighting)
        return found


def columns_of(errors: np.ndarray, slopes: np.ndarray, departs: np.ndarray) -> np.ndarray:
    """Errors at no departure by the linear model, then their derivatives, (…, 1 + numbers)."""
    return np.concatenate([(errors - slopes @ departs)[..., None], slopes], axis=-1)
