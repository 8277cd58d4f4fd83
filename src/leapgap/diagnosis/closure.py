"""Share of a headline gap above its noise floor that is closed, with its interval over resampled logs."""

from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.judged_logs import JudgedLogs

LEAST_ABOVE = 0.05  # Smallest gap above the noise floor, as a share of the floor, of which a reduction can be stated

SIGMAS = 1.96  # Half width of a 95 % interval in standard deviations


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval over resampled logs."""

    value: float
    low: float
    high: float

    @property
    def capped_at_one(self) -> "Interval":
        """The interval of a share, clipped to at most 1, with the value inside: the form for texts.

        A corrected gap may be below the noise floor by chance, which gives a share above 1.
        """
        value = min(self.value, 1.0)
        return Interval(value, min(self.low, value), max(min(self.high, 1.0), value))


def above_noise(gap: float, floor: float) -> bool:
    """Whether a headline gap is above its noise floor."""
    return gap - floor > LEAST_ABOVE * floor


def resamples(logs: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Bootstrap resamples of logs: indices (draws, logs)."""
    return rng.integers(0, logs, size=(draws, logs))


def closure(
    nominal: np.ndarray, corrected: np.ndarray, floor: np.ndarray, judged: JudgedLogs, draws: np.ndarray
) -> Interval:
    """Share of the headline gap above its noise floor that is closed; arguments are sums of squares (logs,).

    It is 0 where the gap is not above the noise floor.
    """
    number = judged.value_counts

    def of(chosen: np.ndarray) -> float:
        values = number[chosen].sum()
        before, after, least = (np.sqrt(s[chosen].sum() / values) for s in (nominal, corrected, floor))
        return float((before - after) / (before - least)) if above_noise(before, least) else 0.0

    sample = [of(chosen) for chosen in draws]
    return Interval(of(np.arange(len(number))), float(np.percentile(sample, 2.5)), float(np.percentile(sample, 97.5)))
