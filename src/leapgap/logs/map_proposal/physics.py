"""What numbers say of columns: slopes of positions, factors between columns, and PD torques against measured ones."""

from dataclasses import dataclass

import numpy as np

MOST_ROWS = 20_000
"""Rows that are looked at: patterns show in a part of a long log."""


MOST_MEANT, SPAN_S = 10, 0.1
"""Rows, and at most so many s, over which rates are means: ticks of encoders are then small, and motions are not."""


def rows_meant(step_s: float) -> int:
    """Number of rows over which rates are means, by the step of the clock."""
    return int(np.clip(round(SPAN_S / step_s), 1, MOST_MEANT))


def mean_rates(time: np.ndarray, position: np.ndarray, rows: int) -> np.ndarray:
    """Mean rates of positions, (m, n), from each row to that some ``rows`` later, (m − rows, n)."""
    return (position[rows:] - position[:-rows]) / (time[rows:] - time[:-rows])[:, None]


def mean_values(time: np.ndarray, velocity: np.ndarray, rows: int) -> np.ndarray:
    """Means of velocities, (m, n), over the same rows: what their mean rates are of a position with that rate."""
    area = np.zeros(velocity.shape)
    area[1:] = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time)[:, None], axis=0)
    return mean_rates(time, area, rows)


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
