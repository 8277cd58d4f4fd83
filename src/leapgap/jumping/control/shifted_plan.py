"""A plan that can be moved to neighbouring goals, and to another stance, while it is carried out.

Set points, velocities, torques and forces of a smooth family of plans are nearly linear in the goal and in the pitch of
the ground they start from. Their slopes are differences to the plans of neighbouring goals, and of a neighbouring
stance. All of them move together, so that joint PD and feed-forward agree.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.condensed_qp import ROUNDING_S
from leapgap.jumping.control.leg_kinematics import StartFrame
from leapgap.jumping.control.tracking import JointPd, PhaseGains, Reference
from leapgap.jumping.task import ContactSchedule
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate

QUANTITIES = ("state", "foot", "joint_pos", "joint_vel", "torque", "force")
GOAL_AXES = 3  # x and z of the landing, m, and its pitch, rad
DEVIATIONS = 10  # Trunk (x z pitch and their rates) and feet (front x z, rear x z, from the base) − those of a plan


@dataclass(frozen=True)
class ShiftedPlan:
    """A plan and its slopes: ``slopes[quantity]`` of shape (axes, rows, n), per m, m, rad and rad.

    The axes are those of the goal and, where the plan can be moved to another stance, the pitch of the ground at the
    start, rad, nose-down.
    """

    reference: Reference
    slopes: dict[str, np.ndarray]

    @staticmethod
    def of(reference: Reference, neighbours: Sequence[Reference], steps: Sequence[float]) -> "ShiftedPlan":
        """From the plans of the goals that are ``steps`` (m, m, rad) farther along each axis."""
        of_axes = [differences(reference, other, step) for other, step in zip(neighbours, steps, strict=True)]
        return ShiftedPlan(reference, {name: np.stack([slopes[name] for slopes in of_axes]) for name in QUANTITIES})

    def with_stance(self, slopes: Mapping[str, np.ndarray]) -> "ShiftedPlan":
        """The same with slopes by the stance, (rows, n) for each quantity, per rad."""
        return ShiftedPlan(self.reference, {name: np.stack([*self.slopes[name], slopes[name]]) for name in QUANTITIES})

    @property
    def axes(self) -> int:
        """Number of axes along which the plan can be moved: 3, or 4 with the stance."""
        return len(self.slopes["state"])

    def at(self, quantity: str, row: int | np.ndarray, shift: np.ndarray) -> np.ndarray:
        """A quantity at one or several rows, (n,) or (rows, n), for a shift (3,) or, with the stance, (4,)."""
        values: np.ndarray = getattr(self.reference, quantity)[row]
        return values + np.tensordot(shift, self.slopes[quantity][: len(shift), row], axes=1)


def differences(reference: Reference, other: Reference, step: float) -> dict[str, np.ndarray]:
    """(Other plan − plan) / step of each quantity, (rows, n)."""
    return {name: (getattr(other, name) - getattr(reference, name)) / step for name in QUANTITIES}


@dataclass(frozen=True)
class ShiftGrid:
    """Updates while feet push, one every ``period_s``; the last shift is held through the flight."""

    schedule: ContactSchedule
    period_s: float = 0.025
    steps: int = 6  # Steps of a horizon, while as many updates remain: first one update, then equal shares of the rest

    on_rear_feet: bool = True  # Whether the shift still changes when only the rear feet push; else it is held then

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


@dataclass(frozen=True)
class Observation:
    """When the deviation from the plan is kept."""

    period_s: float = 0.025  # Time from one update of the shift to the next, s
    average_s: float = 0.01  # Time before each update over which the deviation is averaged


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
            measured = np.concatenate([frame.state(estimate), frame.foot(estimate, self.legs)])
            self.recorder.measure(measured - np.concatenate([self.reference.state[row], self.reference.foot[row]]))
        update = self.recorder.update_at(time_s)
        if update >= self._updates:
            self._updates = update + 1
            self.recorder.keep(update)
        return super().feed_forward(time_s, estimate, frame)
