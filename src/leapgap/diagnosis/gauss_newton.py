"""Gauss–Newton fits of sets of hypotheses: their state, steps of finite differences, Broyden's updates, covariances."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.hypotheses import Hypothesis

STEP = 0.1
"""Step of finite differences, as a share of the moderate departure."""


@dataclass
class GaussNewtonFit:
    """State of the Gauss–Newton iteration of one set of hypotheses."""

    hypotheses: tuple[Hypothesis, ...]
    numbers: np.ndarray
    """Numbers of the next evaluation, (numbers,)."""
    best: np.ndarray
    """Numbers with the smallest loss so far, (numbers,)."""
    loss: float = np.inf
    columns: np.ndarray | None = None
    done: bool = False


def covariance(normal: np.ndarray, scatter: np.ndarray, numbers: int) -> np.ndarray:
    """Covariance of the first numbers: inverse curvature, widened to the sandwich N⁻¹ S N⁻¹ if that is larger."""
    inverse = np.linalg.pinv(normal)
    plain, sandwich = inverse[:numbers, :numbers], (inverse @ scatter @ inverse)[:numbers, :numbers]
    wider = np.sqrt(np.maximum(1.0, np.diag(sandwich) / np.maximum(np.diag(plain), 1e-300)))
    return np.asarray(plain * wider[:, None] * wider)


def differences(hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> list[np.ndarray]:
    """A small step in each number within its range, (numbers,) each."""
    steps = STEP * np.concatenate([h.moderate for h in hypotheses])
    lower, upper = (np.concatenate([h.bounds[side] for h in hypotheses]) for side in (0, 1))
    inside = (numbers + steps <= upper) & (numbers + steps >= lower)
    return list(np.diag(np.where(inside, steps, -steps)))


def broyden(columns: np.ndarray, move: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Derivatives (pieces, values, numbers) after a step ``move`` that led to ``errors``, by Broyden's rule."""
    length = float(move @ move)
    slopes = columns[:, :, 1:]
    if length == 0:
        return slopes
    surprise = errors - columns[:, :, 0] - slopes @ move
    return np.asarray(slopes + surprise[:, :, None] * move / length)
