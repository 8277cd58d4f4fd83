"""Keeps how far a robot is from its plan at each update of a jump, and joint PD that does so while it jumps."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.horizon import ROUNDING_S
from leapgap.jumping.control.reference import Reference, StartFrame
from leapgap.jumping.control.shift_horizon import ShiftGrid
from leapgap.jumping.control.shifted_plan import DEVIATIONS
from leapgap.jumping.control.tracking import JointPd
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate

POSTURE = (0, 1, 2, 6, 7, 8, 9)
"""Places of what is no rate in a deviation: x, z and pitch of the trunk, and the feet."""
WITH_PAST = DEVIATIONS + 2 * len(POSTURE)
"""Numbers of a deviation that is told with its past; see ``DeviationHistory``."""
FIRST_S = 0.1
"""Nothing counts as moved before this time: a plan from a stance that was measured late is reached then."""
TURN_S = 0.25
"""Time of the deepest crouch, about. From then on joints with friction hold a robot off its plan to the same side."""
LATELY_S = 0.05
"""What moved within this time moved lately."""


@dataclass(frozen=True)
class Observation:
    """When the deviation from the plan is kept."""

    period_s: float = 0.025
    """Time from one update of the shift to the next, s."""
    average_s: float = 0.01
    """Time before each update over which the deviation is averaged."""


@dataclass(frozen=True)
class PastUpdates:
    """The updates that tell how a robot has moved off its plan."""

    period_s: float
    """Time from one update to the next."""

    def lately(self, update: int) -> int:
        """The update with which one is compared: some time before it, or itself where that is too early to tell."""
        return max(update - self._number(LATELY_S), min(update, self._number(FIRST_S)))

    def turned(self, update: int) -> int:
        """The update with which that one is compared: the turn from crouching to pushing, or itself before it."""
        return min(self.lately(update), self._number(TURN_S))

    def _number(self, time_s: float) -> int:
        return int((time_s + ROUNDING_S) / self.period_s)


class DeviationHistory:
    """Tells a robot that left its plan lately from one that has been off it for long.

    A kick moves trunk and feet by millimetres off the plan, and the landing by centimetres. In a wrong crouch a robot
    with friction in its joints is off it as far, all of the time, and lands where it would have landed.
    """

    def __init__(self, updates: int, period_s: float) -> None:
        self.past = PastUpdates(period_s)
        self.known = np.zeros((updates, DEVIATIONS))
        """Deviation at each update, or at the last one before at which it was measured."""

    def at(self, update: int, deviation: np.ndarray) -> np.ndarray:
        """The deviation (10,) at an update with its past, (24,); the updates come in their order.

        First the deviation, but of posture its change lately; then the change of posture from the turn until then; then
        posture at the turn.
        """
        if np.isfinite(deviation).all():
            self.known[update:] = deviation
        then, turned = (self.known[past(update), POSTURE] for past in (self.past.lately, self.past.turned))
        lately = deviation.copy()
        lately[list(POSTURE)] -= then
        return np.concatenate([lately, then - turned, turned])


class DeviationRecorder:
    """Means of the latest measured deviations from the plan, one for each update.

    ``deviations`` (updates, 24) holds them with their past; rows of updates that did not come are not finite.
    """

    def __init__(self, reference: Reference, observation: Observation) -> None:
        self.grid = ShiftGrid(reference.schedule, observation.period_s)
        self.deviations = np.full((self.grid.updates, WITH_PAST), np.nan)
        self.kept_rows = max(1, round(observation.average_s / reference.period_s))
        self._latest: list[np.ndarray] = []
        self._history = DeviationHistory(self.grid.updates, observation.period_s)

    def update_at(self, time_s: float) -> int:
        """Number of the update that is under way at a time since the start of the jump, s."""
        return int(np.clip((time_s + ROUNDING_S) / self.grid.period_s, 0, self.grid.updates - 1))

    def measure(self, deviation: np.ndarray) -> None:
        """Take in the deviation (10,) of one tick."""
        self._latest = [*self._latest, deviation][-self.kept_rows :]

    def keep(self, update: int) -> np.ndarray:
        """Keep the mean of the latest ticks for an update, and return it with its past, (24,).

        Not finite where there are none.
        """
        if self._latest:
            self.deviations[update] = self._history.at(update, np.mean(self._latest, axis=0))
        return self.deviations[update]


class ObservedJointPd(JointPd):
    """Joint PD with the torques of the plan, which keeps how far trunk and feet are from the plan."""

    def __init__(self, reference: Reference, robot: Robot, gains: PhaseGains, observation: Observation) -> None:
        super().__init__(reference, robot, gains)
        self.recorder = DeviationRecorder(reference, observation)
        self._updates = 0

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """The planned torques (joints,), N·m, and pair forces (4,), N."""
        if time_s <= self.reference.schedule.take_off_s:
            row = self.reference.row(time_s)
            state = frame.state(estimate) - self.reference.state[row]
            foot = frame.foot(estimate, self.legs) - self.reference.foot[row]
            self.recorder.measure(np.concatenate([state, foot]))
        update = self.recorder.update_at(time_s)
        if update >= self._updates:
            self._updates = update + 1
            self.recorder.keep(update)
        return super().feed_forward(time_s, estimate, frame)
