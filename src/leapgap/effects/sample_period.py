"""Sample period error."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.effects.base import Effect, parameter


@dataclass(frozen=True)
class SamplePeriod(Effect):
    """Ratio of the true to the logged period of a row; each command is held for the true period.

    The ratio depends on the load of the computer, so it may differ from log to log and within a log.
    """

    name = "sample_period"
    differs_per_log = True

    scale: float = parameter(1.0, "1", 0.5, 1.9, 1.07)
    profile: tuple[float, ...] = ()
    """True length of a row over ``scale``, at rows evenly spaced from the log's first to its last; empty: 1."""

    def with_profile(self, profile: tuple[float, ...]) -> "SamplePeriod":
        """The effect with this profile of row lengths."""
        return replace(self, profile=profile)

    def extend_to(self, rows: int, all_rows: int) -> "SamplePeriod":
        """The effect with one value a row; after the rows that the profile was fitted on, the last value holds."""
        if not self.profile:
            return self
        at = np.linspace(0, rows - 1, len(self.profile))
        return replace(self, profile=tuple(np.interp(np.arange(all_rows), at, self.profile).tolist()))

    def change_period(self, period_s: float) -> float:
        """Scale the period of a row; the number of simulation steps of a row stays."""
        return period_s * self.scale

    def change_rows(self, lengths: np.ndarray) -> np.ndarray:
        """Scale the length of each row by the profile."""
        if not self.profile:
            return lengths
        at = np.linspace(0, len(lengths) - 1, len(self.profile))
        return np.asarray(lengths * np.interp(np.arange(len(lengths)), at, self.profile))
