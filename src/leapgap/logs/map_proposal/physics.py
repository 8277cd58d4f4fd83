"""What numbers say of columns: slopes of positions, factors between columns, and PD torques against measured ones."""

from dataclasses import dataclass

import numpy as np

MOST_ROWS = 20_000
"""Rows that are looked at: patterns show in a part of a long log."""


ROWS = 10
"""Rows over which rates are means: ticks of encoders are then small, and both sides are smoothed alike."""


def mean_rates(time: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Mean rates of positions, (rows, n), from each row to that some rows later, (rows − 10, n)."""
    return (position[ROWS:] - position[:-ROWS]) / (time[ROWS:] - time[:-ROWS])[:, None]


def mean_values(time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Means of velocities, (rows, n), over the same rows: what their mean rates are of a position with that rate."""
    area = np.zeros(velocity.shape)
    area[1:] = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)[:, None], axis=0)
    return mean_rates(time, area)


def factors(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """What each column of the second table is multiplied by to be that of the first, by least squares, (n,)."""
    return (first * second).sum(axis=0) / np.maximum((second**2).sum(axis=0), 1e-300)


@dataclass(frozen=True)
class Gains:
    """A joint PD fitted to a measured torque: τ = a τ_sent + kp (q_set − q) + kd (q̇_set − q̇)."""

    kp: float
    kd: float
    explained: float
    """Share of the torque's variance that it explains."""


def fit_gains(torque: np.ndarray, error: np.ndarray, rate_error: np.ndarray, sent: np.ndarray | None) -> Gains:
    """Least squares over the rows of one joint."""
    parts = [error, rate_error, np.ones_like(error), *([] if sent is None else [sent])]
    design = np.stack(parts, axis=1)
    solution, *_ = np.linalg.lstsq(design, torque, rcond=None)
    left = torque - design @ solution
    return Gains(float(solution[0]), float(solution[1]), 1 - float(left.var() / max(torque.var(), 1e-300)))
