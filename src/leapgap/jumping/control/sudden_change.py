"""Tells that a robot was kicked or pushed: it goes on in a way in which it never does while nothing happens.

A robot is never quite on its plan: it began from another crouch, its joints stick, the ground is uneven. All of that
goes on smoothly from update to update, in a way that jumps of the robot itself teach. A kick does not. So neither a
wrong crouch nor a wrong model of the robot is taken for one, and what was there before it is no part of what it did.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.shifted_plan import DEVIATIONS

RECENT = 5
"""Number of updates before an update of which all but the last are compared with it: a push that began just before the
last one has shown a little in that already."""


@dataclass(frozen=True)
class ChangeRule:
    """When something is taken for a sudden change."""

    least_surprise: float = 12.0
    """Smallest surprise of the update at which it shows. In practice jumps the largest is 2, in later jumps without
    a kick 10."""
    times_recent: float = 5.0
    """It is larger than the largest of the recent updates by this factor: a crouch far from the planned one surprises
    as much, but from the start on."""


@dataclass(frozen=True)
class CalmMotion:
    """How the deviation from the plan goes on from each of T updates to the next while nothing happens."""

    carry: np.ndarray
    """Deviation at an update from [1, that at the update before], (T, 11, 10)."""
    precision: np.ndarray
    """Inverse covariance of what is left, (T, 10, 10)."""

    def carried(self, update: int, before: np.ndarray) -> np.ndarray:
        """The deviation (10,) that is expected at an update after that of the update before (10,)."""
        found: np.ndarray = self.carry[update, 0] + before @ self.carry[update, 1:]
        return found

    def surprise(self, update: int, left: np.ndarray) -> float:
        """Mean square of what is unexpected of a deviation, ``left`` (10,), in squared standard deviations: 1 while
        nothing happens."""
        return float(left @ self.precision[update] @ left) / DEVIATIONS


class ChangeWatch:
    """Watches the deviations of a jump for its first sudden change, and tells what has come since.

    ``age`` counts the updates since the change, from 1 on; 0: nothing has happened.
    """

    def __init__(self, calm: CalmMotion, rule: ChangeRule) -> None:
        self.calm, self.rule = calm, rule
        self.age = 0
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._calm: np.ndarray | None = None
        """The deviation (10,) at the last update; since a change, what it would be without that."""
        self._since = np.zeros(DEVIATIONS)
        """What a change had added to it then."""
        self._update = -1

    def since(self, update: int, deviation: np.ndarray) -> np.ndarray | None:
        """What a sudden change has added to the deviation at an update, and at the last one that was told, (20,).

        ``deviation`` (10,) is that at the update. Updates come in turn; those that are missing or not finite are gone
        over. None while nothing has happened, and where the deviation is not finite.
        """
        gap, self._update = update - self._update, update
        finite = bool(np.isfinite(deviation).all())
        if self._calm is None:
            self._calm = deviation if finite else None
            return None
        calm = self._calm
        for passed in range(update - gap + 1, update + 1):
            calm = self.calm.carried(passed, calm)
        if self.age:
            self.age += gap
        elif finite and gap == 1 and self._is_sudden(self.calm.surprise(update, deviation - calm)):
            self.age = 1
        elif finite:
            calm = deviation
        self._calm = calm
        if not (self.age and finite):
            return None
        before, self._since = self._since, deviation - calm
        return np.concatenate([self._since, before])

    def _is_sudden(self, surprise: float) -> bool:
        """Whether an update surprises more than the recent ones but the last; it is remembered."""
        known = len(self._recent) == RECENT
        usual = max(1.0, *list(self._recent)[:-1]) if known else np.inf
        self._recent.append(surprise)
        return surprise > self.rule.least_surprise and surprise > self.rule.times_recent * usual
