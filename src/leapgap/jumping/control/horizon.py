"""Steps of the prediction from any moment of a jump: short in contact, long in flight, ending at the landing.

The nodes of a jump are fixed: counted back from take-off in contact steps, forward from it in flight steps, the last
of which ends at the landing. A horizon begins now and goes on with nodes, so that

* every step ends exactly at take-off or lies on one side of it, and contact steps grow fewer as take-off nears;
* all but the first sample are the same at every update: what a model says there is a constant of the jump;
* on the grid (the paper's 40 Hz) the first step is a whole one. Between nodes it is what is left of one, at least
  half of it, else the rest and the next one together (the first force is the one that is sent, and in a very short
  step it would hardly change the cost). Take-off and landing are never skipped.

A ballistic prediction does not hold after the landing: the horizon ends there, with fewer than K steps.
"""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.task import ContactSchedule

ROUNDING_S = 1e-6
"""Times closer than this count as equal, as in ``ContactSchedule.in_contact``."""


@dataclass(frozen=True)
class Horizon:
    """The n ≤ K steps of one prediction."""

    time_s: np.ndarray
    """Start of each step and end of the last one, since the start of the jump, (n + 1,)."""
    share: np.ndarray
    """Part of each step during which the front and the rear pair are planned to push, 0…1, (n, 2)."""

    def __len__(self) -> int:
        return len(self.share)

    @property
    def step_s(self) -> np.ndarray:
        """Length of each step, (n,)."""
        return np.diff(self.time_s)

    @property
    def contact(self) -> np.ndarray:
        """Whether each step begins before take-off, bool, (n,)."""
        return np.asarray(self.share.any(axis=1))


def nodes(grid: TimeGrid, schedule: ContactSchedule) -> np.ndarray:
    """Ends of the steps of a whole jump, s, increasing; phases need not be whole numbers of steps."""
    take_off, flight = schedule.take_off_s, schedule.flight_s
    in_contact = int(np.floor(take_off / grid.contact_step_s - ROUNDING_S))
    in_flight = max(1, round(flight / grid.flight_step_s))
    before = take_off - grid.contact_step_s * np.arange(in_contact, 0, -1)
    after = take_off + grid.flight_step_s * np.arange(in_flight)
    return np.concatenate([before, after, [schedule.landing_s]])


def horizon(grid: TimeGrid, schedule: ContactSchedule, time_s: float) -> Horizon:
    """The horizon from a moment of the jump, s since its start; from the landing on it has no step."""
    ends = nodes(grid, schedule)
    first = int(np.searchsorted(ends, time_s + ROUNDING_S))
    if first < len(ends):
        contact = time_s < schedule.take_off_s - ROUNDING_S
        whole = grid.contact_step_s if contact else grid.flight_step_s
        phase_ends = np.isclose(ends[first], [schedule.take_off_s, schedule.landing_s], rtol=0, atol=ROUNDING_S).any()
        if ends[first] - time_s < whole / 2 - ROUNDING_S and not phase_ends:
            first += 1
    times = np.concatenate([[time_s], ends[first : first + grid.steps]])
    return Horizon(times, contact_share(schedule, times))


def contact_share(schedule: ContactSchedule, times_s: np.ndarray) -> np.ndarray:
    """Part of each interval between times (n + 1,) before the front and the rear pair lift off, (n, 2)."""
    begin, length = times_s[:-1, None], np.diff(times_s)[:, None]
    lift_off = np.array([schedule.front_lift_off_s, schedule.take_off_s])
    share = np.clip((lift_off - begin) / length, 0.0, 1.0)
    share[share * length < ROUNDING_S] = 0.0
    share[(1 - share) * length < ROUNDING_S] = 1.0
    return share
