"""Sensor noise of a logged channel, estimated from differences of its values."""

from itertools import permutations
from math import comb

import numpy as np

NORMAL_MEDIAN = 0.6745  # median absolute value of a standard normal number
SMOOTH_PERIOD_S = 0.002  # up to this period the second differences of a robot's motion are tiny against those of noise
HIGHER_ORDERS = (2, 4, 6)  # of differences at longer periods: smooth motions shrink with the order, noise does not
QUIETEST_GAP, ROUNDING = 0.02, 1e-6
"""Share of the gaps between the values of a column that are narrower than its resolution; those that are narrower than
``ROUNDING`` times its spread are the rounding of numbers, and none."""
ON_GRID = 0.05  # values are whole counts that lie off a grid by a smaller share of it, on average; others by a quarter

NEIGHBOURS = np.array([-2, -1, 1, 2])  # rows through which a cubic tells what a value should be
JITTER_ROWS, FAST_QUARTER = 8, 0.75  # rows over which a rate is a mean, and the quantile from which on rows are fast


def resolution_of(values: np.ndarray) -> np.ndarray:
    """Distance between neighbouring values of columns (rows, channels): an encoder's count, or the last digit.

    Infinite for a column of one value, and next to nothing where values are continuous.
    """
    gaps = [np.diff(np.unique(column)) for column in values.T]
    gaps = [own[own > ROUNDING * own.sum()] for own in gaps]
    return np.array([np.quantile(own, QUIETEST_GAP) if len(own) else np.inf for own in gaps])


def ticks_of(values: np.ndarray) -> np.ndarray:
    """Width of the grid on which all values of a column lie, (channels,); 0 where they are continuous or one value."""
    found = np.zeros(values.shape[1])
    for k, (column, tick) in enumerate(zip(values.T, resolution_of(values), strict=True)):
        if np.isfinite(tick):
            gaps = np.diff(np.unique(column))
            tick = gaps.sum() / np.round(gaps / tick).sum()
            counts = (column - column[0]) / tick
            found[k] = tick if np.mean(np.abs(counts - np.round(counts))) < ON_GRID else 0.0
    return found


def noise_of(steps: np.ndarray, period_s: float, lengths: np.ndarray | None = None) -> np.ndarray:
    """Standard deviation of the noise in channels of which the first differences (rows, channels) are given.

    It is that of white noise, or that of rounding to whole counts of a grid, whichever is larger. Differences of order
    n of white noise have variance C(2n, n) σ²; the median absolute value is insensitive to impacts. The motion itself
    only adds to them, so at long periods the smallest estimate of several orders is taken. ``lengths`` (rows,) of the
    steps are given where they are uneven and short; then a value is compared with the straight line between its
    neighbours.
    """
    if lengths is not None and period_s <= SMOOTH_PERIOD_S and len(steps) > 1:
        after = (lengths[1:] / (lengths[1:] + lengths[:-1]))[:, None]
        off = (after * steps[:-1] - (1 - after) * steps[1:]) / np.sqrt(1 + after**2 + (1 - after) ** 2)
        white = [np.median(np.abs(off), axis=0) / NORMAL_MEDIAN]
    else:
        orders = (2,) if period_s <= SMOOTH_PERIOD_S else HIGHER_ORDERS
        differences = [(np.diff(steps, n=order - 1, axis=0), order) for order in orders if len(steps) >= 2 * order]
        white = [
            np.median(np.abs(own), axis=0) / NORMAL_MEDIAN / np.sqrt(comb(2 * order, order))
            for own, order in differences
        ]
    rounding = ticks_of(steps.cumsum(axis=0)) / np.sqrt(12)
    return np.asarray(np.maximum(np.min(white, axis=0), rounding)) if white else rounding


def noise_in_rows(time: np.ndarray, values: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Standard deviation in each row of values (rows, channels) whose samples are not taken when their rows say.

    Samples that are off in time are off by more where a value changes faster. A value is compared with the cubic
    through its four neighbours; what is beyond its ``noise`` (channels,) in the faster quarter of the rows, over the
    rate there, is one time for each column.
    """
    if len(time) < 2 * JITTER_ROWS:
        return np.broadcast_to(noise, values.shape)
    at = np.arange(2, len(time) - 2)
    about = at[:, None] + NEIGHBOURS
    off = time[about] - time[at, None]
    weights = np.ones(off.shape)
    for k, j in permutations(range(len(NEIGHBOURS)), 2):
        weights[:, k] *= off[:, j] / (off[:, j] - off[:, k])
    departure = values[at] - np.einsum("rk,rkc->rc", weights, values[about])
    departure = np.abs(departure) / np.sqrt(1 + (weights**2).sum(axis=1))[:, None] / NORMAL_MEDIAN
    first, last = np.clip(at - JITTER_ROWS // 2, 0, None), np.clip(at + JITTER_ROWS // 2, None, len(time) - 1)
    rate = np.abs(values[last] - values[first]) / (time[last] - time[first])[:, None]
    late = np.zeros(values.shape[1])
    for c, own in enumerate(rate.T):
        fast = own >= np.quantile(own, FAST_QUARTER)
        speed = np.median(own[fast])
        if speed > 0:
            late[c] = np.sqrt(max(0.0, np.median(departure[fast, c]) ** 2 - noise[c] ** 2)) / speed
    rate = np.concatenate([rate[:1], rate[:1], rate, rate[-1:], rate[-1:]])
    return np.asarray(np.hypot(noise, late * rate))
