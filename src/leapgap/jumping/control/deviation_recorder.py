"""Keeps how far a robot is from its plan at each update of a jump, and joint PD that does so while it jumps."""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.horizon import ROUNDING_S
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.shift_horizon import ShiftGrid
from leapgap.jumping.control.shifted_plan import DEVIATIONS
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.control.tracking import JointPd
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate


@dataclass(frozen=True)
class Observation:
    """When the deviation from the plan is kept."""

    period_s: float = 0.025
    """Time from one update of the shift to the next, s."""
    average_s: float = 0.01
    """Time before each update over which the deviation is averaged."""


class DeviationRecorder:
    """Means of the latest measured deviations from the plan, one for each update.

    ``deviations`` (updates, 10) holds them; rows of updates that did not come are not finite.
    """

    def __init__(self, reference: Reference, observation: Observation) -> None:
        self.grid = ShiftGrid(reference.schedule, observation.period_s)
        self.deviations = np.full((self.grid.updates, DEVIATIONS), np.nan)
        self.kept_rows = max(1, round(observation.average_s / reference.period_s))
        self._latest: list[np.ndarray] = []

    def update_at(self, time_s: float) -> int:
        """Number of the update that is under way at a time since the start of the jump, s."""
        return int(np.clip((time_s + ROUNDING_S) / self.grid.period_s, 0, self.grid.updates - 1))

    def measure(self, deviation: np.ndarray) -> None:
        """Take in the deviation (10,) of one tick."""
        self._latest = [*self._latest, deviation][-self.kept_rows :]

    def keep(self, update: int) -> np.ndarray:
        """Keep the mean of the latest ticks for an update, and return it, (10,); not finite where there are none."""
        self.deviations[update] = np.mean(self._latest, axis=0) if self._latest else np.nan
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
