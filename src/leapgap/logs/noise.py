"""Sensor noise of a logged channel, estimated from differences of its values."""

from math import comb

import numpy as np

NORMAL_MEDIAN = 0.6745
"""Median absolute value of a standard normal number."""
SMOOTH_PERIOD_S = 0.002
"""Up to this sample period the second differences of a robot's motion are tiny against those of noise."""
HIGHER_ORDERS = (2, 4, 6)
"""Orders of differences at longer periods: those of a smooth motion shrink with the order, those of noise do not."""


def noise_of(steps: np.ndarray, period_s: float, lengths: np.ndarray | None = None) -> np.ndarray:
    """Standard deviation of white noise in channels of which the first differences (rows, channels) are given.

    Differences of order n of white noise have variance C(2n, n) σ²; the median absolute value is insensitive to
    impacts. The motion itself only adds to them, so at long periods the smallest estimate of several orders is taken.
    ``lengths`` (rows,) of the steps are given where they are uneven and short; then a value is compared with the
    straight line between its neighbours.
    """
    if lengths is not None and period_s <= SMOOTH_PERIOD_S and len(steps) > 1:
        after = (lengths[1:] / (lengths[1:] + lengths[:-1]))[:, None]
        off = (after * steps[:-1] - (1 - after) * steps[1:]) / np.sqrt(1 + after**2 + (1 - after) ** 2)
        return np.asarray(np.median(np.abs(off), axis=0) / NORMAL_MEDIAN)
    orders = (2,) if period_s <= SMOOTH_PERIOD_S else HIGHER_ORDERS
    found = [
        np.median(np.abs(np.diff(steps, n=order - 1, axis=0)), axis=0) / NORMAL_MEDIAN / np.sqrt(comb(2 * order, order))
        for order in orders
        if len(steps) >= 2 * order
    ]
    return np.min(found, axis=0) if found else np.zeros(steps.shape[1:])
