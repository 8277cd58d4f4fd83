"""A control loop that runs slower or faster than its log claims."""

from dataclasses import dataclass

from leapgap.effects.base import Effect, parameter


@dataclass(frozen=True)
class SamplePeriod(Effect):
    """True over claimed period of a row: commands are held longer, and everything happens at another pace.

    Depends on the load of the computer, hence differs from log to log.
    """

    name = "sample_period"
    differs_per_log = True

    scale: float = parameter(1.0, "1", 0.8, 1.3)

    def change_period(self, period_s: float) -> float:
        """Stretch the time that passes a row; the number of steps a row stays."""
        return period_s * self.scale
