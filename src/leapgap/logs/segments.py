"""Which feet are planned to push when: the contact schedule of a jump."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ContactSchedule:
    """Lengths of the phases of a jump, s, in their order.

    The published jumps use 500/300/400 ms: all feet, rear feet, none.
    """

    double_contact_s: float = 0.5
    rear_contact_s: float = 0.3
    flight_s: float = 0.4

    @property
    def front_lift_off_s(self) -> float:
        """When the front pair is planned to leave the ground."""
        return self.double_contact_s

    @property
    def take_off_s(self) -> float:
        """When the rear pair leaves the ground too, and flight begins."""
        return self.double_contact_s + self.rear_contact_s

    @property
    def landing_s(self) -> float:
        """End of the scheduled flight: where the landing error is read."""
        return self.take_off_s + self.flight_s

    def in_contact(self, time_s: np.ndarray) -> np.ndarray:
        """Planned contact of the (front, rear) pair; shape ``time_s.shape + (2,)``, bool.

        A phase holds its first instant and not its last; times within a microsecond of a boundary count
        as on it, so that 0.8 written as 8 × 0.1 does not push one tick too long.
        """
        t = np.asarray(time_s, dtype=float) + 1e-6
        return np.stack([t < self.front_lift_off_s, t < self.take_off_s], axis=-1)


@dataclass(frozen=True)
class Target:
    """Where the jump was meant to land, relative to its start, m."""

    x_m: float
    z_m: float = 0.0
