"""Errors of logs in whole replays and in short pieces, and how they count together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.full_rollouts import EVERY_S

INDEPENDENT_S = 0.2  # Errors of whole replays at one instant say little more than those so long before
ALIKE = 3  # A robot that has drifted off has done so in all channels: of so many values at an instant one counts
PIECE_VALUES = 6  # A short piece counts as so many independent values
USUAL = 1.0  # A usual χ² of a piece over its number of values: below it pieces count alike


@dataclass(frozen=True)
class LogErrors:
    """Errors of one log at some numbers, or their derivatives by the scaled numbers in a further axis."""

    whole: np.ndarray
    """Scaled errors of its whole replay at the compared instants, (values,); empty where these do not count."""
    pieces: np.ndarray  # Whitened errors of its short pieces, (pieces, values)


def normal_equations(
    errors: Sequence[LogErrors], slopes: Sequence[LogErrors], folds: np.ndarray, fold: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Curvature (numbers, numbers) and slope (numbers,) of minus the logarithm of the likelihood of some errors.

    ``folds`` (logs,) says which fold each log is held out with; the logs of ``fold`` do not count.
    """
    numbers = slopes[0].pieces.shape[2]
    values = np.concatenate([of.whole for of in errors])
    of_whole = independent(len(values)) / ALIKE / max(float(values @ values), 1e-12)
    curvature, slope = np.zeros((numbers, numbers)), np.zeros(numbers)
    for own, of, by in zip(folds, errors, slopes, strict=True):
        if own == fold:
            continue
        weights = PIECE_VALUES / (USUAL + np.mean(of.pieces**2, axis=1)) / max(1, of.pieces.shape[1])
        flat = by.pieces.reshape(-1, numbers)
        weighted = (by.pieces * weights[:, None, None]).reshape(-1, numbers)
        by_whole = by.whole[: len(of.whole)]
        curvature += of_whole * by_whole.T @ by_whole + weighted.T @ flat
        slope += of_whole * by_whole.T @ of.whole + weighted.T @ of.pieces.ravel()
    return curvature, slope


def loss_of(errors: Sequence[LogErrors]) -> float:
    """Minus the logarithm of the likelihood of some errors, up to a constant."""
    values = np.concatenate([of.whole for of in errors])
    whole = independent(len(values)) / ALIKE / 2 * np.log(np.mean(values**2)) if len(values) else 0.0
    chi2 = np.concatenate([np.mean(of.pieces**2, axis=1) for of in errors])
    return float(whole + PIECE_VALUES / 2 * np.log(USUAL + chi2).sum())


def independent(values: int) -> float:
    """Number of independent values of whole replays among so many compared ones."""
    return values * EVERY_S / INDEPENDENT_S


def difference(moved: Sequence[np.ndarray], start: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Finite differences by several numbers, (…, numbers), scaled by ``share`` (numbers,)."""
    found = [(one - start) * s for one, s in zip(moved, share, strict=True)]
    return np.stack(found, axis=-1) if found else np.zeros((*start.shape, 0))
