"""Robust least squares over pieces of logs, with nuisance parameters.

Errors of a piece are r₀ + Σ aₖ cₖ, a sum of columns. The loss of a piece with m values and χ² = |r|² is that of
Student's distribution, m log((m + χ²) / 2m): χ² / 2 near what noise explains, and logarithmic for large χ², so that one
missed contact does not decide the fit. Only products of columns enter, one matrix a piece.
"""

from dataclasses import dataclass

import numpy as np

ITERATIONS = 12


@dataclass(frozen=True)
class Products:
    """Inner products of the columns of every piece."""

    gram: np.ndarray  # (pieces, columns, columns); column 0 holds the errors to be explained
    values: int  # Number of compared values of a piece

    @staticmethod
    def of(columns: np.ndarray) -> "Products":
        """Products of columns (pieces, values, columns)."""
        return Products(columns.transpose(0, 2, 1) @ columns, columns.shape[1])

    def chi2(self, weights: np.ndarray) -> np.ndarray:
        """χ² of each piece for column weights with 1 first, (pieces,)."""
        return np.maximum(((weights @ self.gram) * weights).sum(axis=1), 0.0)

    def fit(self, prior: np.ndarray, furthest: float = np.inf) -> np.ndarray:
        """Weights of the columns with 1 first, that explain all pieces best, by reweighted least squares.

        ``prior`` (columns − 1,) is 1/σ² of each weight about 0; 0 is free. Weights that are not free stay within
        ``furthest`` σ.
        """
        with np.errstate(divide="ignore"):
            most = np.where(prior > 0, furthest / np.sqrt(prior), np.inf)
        weights = np.concatenate([[1.0], np.zeros(len(prior))])
        for _ in range(ITERATIONS):
            emphasis = 2 * self.values / (self.values + self.chi2(weights))
            total = np.tensordot(emphasis, self.gram, axes=1)
            normal = total[1:, 1:] + np.diag(prior)
            normal += 1e-9 * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(normal))
            before, weights = weights, np.concatenate([[1.0], solve_within(normal, -total[1:, 0], most)])
            if np.abs(weights - before).max() < 1e-4 * np.abs(weights).max():
                break
        return weights

    def penalised_loss(self, weights: np.ndarray, prior: np.ndarray) -> float:
        """Loss of all pieces plus that of the weights under their prior."""
        return float(losses(self.chi2(weights), self.values).sum() + 0.5 * (prior * weights[1:] ** 2).sum())


def losses(chi2: np.ndarray, values: int) -> np.ndarray:
    """Student's loss of pieces with as many degrees of freedom as values."""
    return np.asarray(values * np.log((values + chi2) / (2 * values)))


def solve_within(normal: np.ndarray, slope: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Solution of ``normal`` x = ``slope`` where numbers beyond ±``most`` are held there, and the others make up."""
    found, held = np.linalg.solve(normal, slope), np.zeros(len(slope), dtype=bool)
    while (beyond := ~held & (np.abs(found) > most)).any():
        found[beyond] = np.copysign(most, found)[beyond]
        held |= beyond
        rest = slope - normal[:, held] @ found[held]
        found[~held] = np.linalg.solve(normal[np.ix_(~held, ~held)], rest[~held])
    return found
