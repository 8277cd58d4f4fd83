"""The same motions, commanded and logged more often."""

from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.experiments.base import Experiment, Repetition
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import commands_of, planned
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of

FINER_RATE, COARSE_S = 4, 0.004  # Rows of at least this length, s, may be logged and sent so many times as often


@dataclass(frozen=True)
class FinerRate(Experiment):
    """The same motions, commanded and logged more often."""

    name = "rate"
    cost = 2

    factor: int

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """Possible where the rows of all logs are coarse."""
        coarse = given.is_even and all(log.info.sample_period_s >= COARSE_S for log in given.logs)
        return [cls(FINER_RATE)] if coarse else []

    def plans(self, given: Given) -> list[Log]:
        """The logs' commands, each held for several shorter rows."""
        found = []
        for log in Repetition().plans(given):
            columns = {name: np.repeat(log[name], self.factor) for name in commands_of(log)}
            info = replace(log.info, sample_period_s=log.info.sample_period_s / self.factor)
            start = motion_of(log, given.robot, slice(1)).first_state
            found.append(planned(log.name, columns, start, info, given.robot))
        return found

    def words(self, given: Given) -> str:
        """What to do, with the rate in Hz."""
        rate = self.factor / min(log.info.sample_period_s for log in given.logs)
        return f"record the same motions again at {rate:.0f} Hz"

    @property
    def short(self) -> str:
        """The factor on the rate, in a few words."""
        return f"logged {self.factor} times as often"
