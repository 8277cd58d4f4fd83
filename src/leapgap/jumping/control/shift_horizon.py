"""Time grid of a goal shift: intervals of one update, and the steps of a horizon that always reaches the landing."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.horizon import ROUNDING_S
from leapgap.jumping.task import ContactSchedule


@dataclass(frozen=True)
class ShiftGrid:
    """Updates while feet push, one every ``period_s``; the last shift is held through the flight."""

    schedule: ContactSchedule
    period_s: float = 0.025
    steps: int = 6
    """Number of steps of a horizon, while as many updates remain: first one update, then equal shares of the rest."""

    on_rear_feet: bool = True
    """Whether the shift still changes when only the rear feet push; else it is held from then on."""

    @property
    def free_updates(self) -> int:
        """Number of updates at which the shift may change: the first ones."""
        if self.on_rear_feet:
            return self.updates
        return int(np.ceil((self.schedule.double_contact_s - ROUNDING_S) / self.period_s))

    @property
    def updates(self) -> int:
        """Number of updates of a jump."""
        return int(np.ceil((self.schedule.take_off_s - ROUNDING_S) / self.period_s))

    @property
    def times_s(self) -> np.ndarray:
        """Times of the updates since the start of the jump, s, (updates,)."""
        return self.period_s * np.arange(self.updates)

    def horizon(self, update: int) -> np.ndarray:
        """First update of each step from ``update`` on, and the end of the contact, (steps + 1,).

        The steps after the first one share what is left of the updates at which the shift may change, so they shrink as
        the take-off nears; the last one is held to the end.
        """
        rest = self.free_updates - update - 1
        steps = min(self.steps - 1, rest)
        if steps < 1:
            return np.array([update, self.updates])
        edges = np.append(update, update + 1 + np.round(np.linspace(0, rest, steps + 1)).astype(int))
        edges[-1] = self.updates
        return edges
