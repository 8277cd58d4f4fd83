"""Velocities that a controller computed from its positions by a low-pass filter: which ones are, and what they were.

A filter makes a velocity late. A replay that starts from it starts too slow where a joint speeds up, which looks like
damping. Where the rule is known to the last digit it can be undone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

LEAST_OBEYED = 0.8
"""Share of the pairs of samples from which a rule counts as that which made them."""
DIGITS = 0.02
"""A pair obeys where it asks for a share kept that differs by less."""
LEAST_PAIRS = 20
"""Fewer pairs of samples tell no rule."""


@dataclass(frozen=True)
class FilterRule:
    """A velocity that is ``kept`` times the one before and the rest the last difference of positions over a step."""

    kept: float
    share: float
    """Of the pairs of samples one step apart, those that obey this to their last digits."""


def filter_of(position: np.ndarray, velocity: np.ndarray, instants: np.ndarray, step: float) -> FilterRule | None:
    """The rule by which velocities (samples, channels) were computed from positions; None where there are few pairs.

    ``instants`` (samples,), s. Pairs of samples one step apart are looked at, the half of them in which the velocity
    changes most.
    """
    next_step = np.round(np.diff(instants) / step) == 1
    moved = np.diff(position, axis=0)[next_step] / step
    before, after = velocity[:-1][next_step], velocity[1:][next_step]
    change = np.abs(moved - before)
    tells = change > np.median(change, axis=0) if len(change) else change > 0
    if tells.sum() < LEAST_PAIRS:
        return None
    kept = (moved - after)[tells] / (moved - before)[tells]
    usual = float(np.median(kept))
    return FilterRule(usual, float((np.abs(kept - usual) < DIGITS).mean()))


def obeyed_filters(filters: Mapping[str, FilterRule | None]) -> dict[str, FilterRule]:
    """The rules, by message, that surely made their velocities; none where no message obeys its own.

    A message with more noise counts where its pairs ask, in the median, for what the others obey.
    """
    told = {name: one for name, one in filters.items() if one is not None and -DIGITS < one.kept < 1 - DIGITS}
    sure = [one.kept for one in told.values() if one.share > LEAST_OBEYED]
    return {
        name: replace(one, kept=max(one.kept, 0.0))
        for name, one in told.items()
        if any(abs(one.kept - kept) < DIGITS for kept in sure)
    }


def without_filter(
    position: np.ndarray, velocity: np.ndarray, instants: np.ndarray, step: float, kept: float
) -> np.ndarray:
    """Velocities (samples,) before a filter, as the last difference of positions over a step of each sample.

    ``position`` and ``velocity`` (samples,), ``instants`` (samples,) s. Over the steps since the sample before, the
    velocity is taken to change evenly; how far the position moved and what the filter shows then tell it at the sample.
    For one step and for two this is exact. Where the two disagree, instants are wrong: the filter's own lag is undone.
    """
    if kept <= 0 or len(velocity) < 2:
        return velocity.copy()
    steps = np.maximum(np.round(np.diff(instants) / step), 1.0)
    before, after = velocity[:-1], velocity[1:]
    lag = kept / (1 - kept)
    # Velocity v − c (n − j) at step j of n: its sum is the distance, its filtered sum what the log shows.
    powers = kept ** np.arange(int(steps.max()) + 1)
    weighted = np.cumsum(np.arange(len(powers)) * powers) * (1 - kept)
    shown, shown_by_slope = 1 - kept**steps, weighted[steps.astype(int) - 1]
    moved_by_slope = steps * (steps - 1) / 2
    distance, seen = np.diff(position) / step, after - kept**steps * before
    determinant = moved_by_slope * shown - steps * shown_by_slope
    one = steps == 1
    by_both = (moved_by_slope * seen - shown_by_slope * distance) / np.where(one, 1.0, determinant)
    by_lag = after + lag * (after - before) / steps
    doubtful = one | (np.abs(by_both - by_lag) > np.abs(after - before) + np.abs(by_lag - after))
    return np.concatenate([velocity[:1], np.where(doubtful, by_lag, by_both)])
