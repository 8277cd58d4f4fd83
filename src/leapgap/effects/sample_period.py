"""A control loop that runs slower or faster than its log claims."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.effects.base import Effect, parameter


@dataclass(frozen=True)
class SamplePeriod(Effect):
    """True over claimed period of a row: commands are held longer, and everything happens at another pace.

    Depends on the load of the computer, hence differs from log to log, and maybe within one.
    """

    name = "sample_period"
    differs_per_log = True

    scale: float = parameter(1.0, "1", 0.8, 1.3, 1.07)
    profile: tuple[float, ...] = ()
    """True length of a row over ``scale``, at rows evenly spaced from the log's first to its last; empty: 1."""

    def with_profile(self, profile: tuple[float, ...]) -> "SamplePeriod":
        """With this profile."""
        return replace(self, profile=profile)

    def extend_to(self, rows: int, all_rows: int) -> "SamplePeriod":
        """With a value a row, the last one held after the rows that the profile was found on."""
        if not self.profile:
            return self
        at = np.linspace(0, rows - 1, len(self.profile))
        return replace(self, profile=tuple(np.interp(np.arange(all_rows), at, self.profile).tolist()))

    def change_period(self, period_s: float) -> float:
        """Stretch the time that passes a row; the number of steps a row stays."""
        return period_s * self.scale

    def change_rows(self, lengths: np.ndarray) -> np.ndarray:
        """Give each row its share."""
        if not self.profile:
            return lengths
        at = np.linspace(0, len(lengths) - 1, len(self.profile))
        return np.asarray(lengths * np.interp(np.arange(len(lengths)), at, self.profile))
