"""What numbers say of columns: rates against velocities, positions against limits, PD torques against measured ones."""

import math
from dataclasses import dataclass

import numpy as np

from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.importers.units import UNITS

STEPS = (1e-4, 0.2)
"""Periods of loops of robots, s: what a unit of time must give."""
TIME_UNITS = ("s", "ms", "us", "ns")
SAME, NEAR = 0.15, 1.0
"""Two factors this near to each other, relatively, are the same; or at least nearer than two units are."""
CLEAR, PLAIN = 0.8, 0.95
"""Correlation from which on two columns belong together, and share of rows in the limits from which on a unit fits."""
USED = 0.1
"""Share of its limits that some joint must use before they decide a unit: tiny motions lie in any limits."""
MARGIN_RAD = 0.1
"""Positions may lie beyond the limits by this much: play, soft stops."""
MOST_ROWS = 20_000
"""Rows that are looked at: patterns show in a part of a long log."""


@dataclass(frozen=True)
class Rates:
    """How velocities relate to the rates of positions, one value a position column."""

    of: np.ndarray
    """Index of the velocity column that follows the rate of each position best."""
    factor: np.ndarray
    """What that velocity is multiplied by to be the rate, unit of positions per s."""
    correlation: np.ndarray
    """Of the two; NaN where the position hardly moves."""


def unit_of_time(time: np.ndarray) -> str | None:
    """The unit in which the steps of a clock are those of a robot's loop; None where the column is no clock."""
    steps = np.diff(time)
    if len(steps) < 2 or not np.isfinite(steps).all() or np.mean(steps > 0) < 0.99:
        return None
    step = float(np.median(steps))
    return next((unit for unit in TIME_UNITS if STEPS[0] <= step * UNITS["s"][unit] <= STEPS[1]), None)


def rates(time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> Rates:
    """Match velocities (rows, m) with the slopes of positions (rows, n), each velocity at most once."""
    from scipy.optimize import linear_sum_assignment

    slope = slopes(time, position)
    correlation = correlations(slope, velocity)
    rows, columns = linear_sum_assignment(-np.abs(np.nan_to_num(correlation)))
    of = np.full(position.shape[1], -1)
    of[rows] = columns
    chosen = velocity[:, of]
    power = np.maximum((chosen**2).sum(axis=0), 1e-300)
    return Rates(of, (slope * chosen).sum(axis=0) / power, correlation[np.arange(len(of)), of])


def slopes(time: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Rates of positions, by parabolas through some ten rows."""
    return velocity_fit(time, position, 10 * float(np.median(np.diff(time)))).velocity


def correlations(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Correlation of each column of one table with each of another, (n, m); NaN for columns that do not change."""

    def unit(values: np.ndarray) -> np.ndarray:
        centred = values - values.mean(axis=0)
        size = np.sqrt((centred**2).sum(axis=0))
        return centred / np.where(size > 1e-9 * max(1.0, float(np.abs(values).max(initial=0))), size, np.nan)

    return unit(first).T @ unit(second)


def order_of(reference: np.ndarray, other: np.ndarray) -> np.ndarray | None:
    """Which column of ``other`` goes with each of ``reference``, by correlation; None where that is not clear.

    The order as it stands is kept unless another one is clearly better.
    """
    if reference.shape[1] != other.shape[1]:
        return None
    from scipy.optimize import linear_sum_assignment

    found = np.nan_to_num(correlations(reference, other))
    rows, columns = linear_sum_assignment(-found)
    best, as_is = found[rows, columns], np.diag(found)
    return columns if best.mean() > as_is.mean() + 0.1 and best.min() > CLEAR else None


def unit_of_positions(position: np.ndarray, limits: np.ndarray) -> tuple[str, np.ndarray, bool]:
    """Unit of positions (rows, n), sign of each, and whether the joints' limits (n, 2), rad, decide it.

    Limits that are not finite decide nothing; a range of more than a turn and a half can be no angle in rad.
    """
    best: tuple[float, str, np.ndarray] = (-1.0, "rad", np.ones(position.shape[1]))
    limited = np.isfinite(limits).all(axis=1)
    for unit in ("rad", "deg", "rev"):
        si = position * UNITS["rad"][unit]
        plain, flipped = inside(si, limits), inside(-si, limits)
        signs = np.where(limited & (plain < PLAIN) & (flipped >= PLAIN), -1.0, 1.0)
        share = np.where(signs < 0, flipped, plain)
        believable = share[limited].mean() if limited.any() else float(np.abs(si).max() < 3 * math.pi)
        if believable > best[0] + 0.02:
            best = (believable, unit, signs)
    if not limited.any() or best[0] < PLAIN:
        return best[1], best[2], False
    span = np.ptp(position[:, limited], axis=0) * UNITS["rad"][best[1]] / np.ptp(limits[limited], axis=1)
    return best[1], best[2], bool(span.max() > USED)


def inside(position: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Share of rows in which each position lies within its limits."""
    return ((position > limits[:, 0] - MARGIN_RAD) & (position < limits[:, 1] + MARGIN_RAD)).mean(axis=0)


def named_factor(factor: float, dimension: str, within: float = SAME) -> tuple[str, float] | None:
    """The unit, and the sign, that a factor to ours stands for; None where no unit is within that share of it."""
    apart = {unit: abs(math.log(max(abs(factor), 1e-300) / size)) for unit, size in UNITS[dimension].items()}
    nearest = min(apart, key=apart.__getitem__)
    return (nearest, math.copysign(1.0, factor)) if apart[nearest] < math.log1p(within) else None


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
