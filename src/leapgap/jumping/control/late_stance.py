"""A stance that a robot could not measure before its jump is measured at its beginning, while all feet stand.

What follows from each stance is known before the jump: the goal, and how the plan changes. So nothing is searched for
while the robot jumps.
"""

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.shifted_plan import GOAL_AXES
from leapgap.simulation.controller import StateEstimate


@dataclass(frozen=True)
class LateStance:
    """How long a stance is measured, and where the jump goes from it."""

    pitches: np.ndarray
    """Pitches of the ground under the feet, rising, (p,), rad, nose-down. One beyond them is not believed."""
    goals: np.ndarray
    """Goal of a jump from each of them, (p, 3), m, m, rad; linear in between."""
    until_s: float = 0.049
    """Estimates before this time since the start are used. It is a tick before an update, so that choosing the goal and
    solving the first program for it do not come in one tick."""
    reach_s: float = 0.05
    """Time in which the plan from the measured stance is reached."""

    def goal(self, pitch: float) -> np.ndarray | None:
        """Goal of a jump from a stance, (3,); None where there is no such ground."""
        if not self.pitches[0] <= pitch <= self.pitches[-1]:
            return None
        return np.array([np.interp(pitch, self.pitches, self.goals[:, axis]) for axis in range(GOAL_AXES)])


class StanceMeter:
    """Mean pitch of the ground under the feet, and mean height of the base, over the estimates that were taken in."""

    def __init__(self, legs: LegKinematics) -> None:
        self.legs = legs
        self.count = 0
        self._pitch = self._height = 0.0

    def measure(self, estimate: StateEstimate) -> None:
        """Take in an estimate; one of which something is missing is left out."""
        if np.isfinite([*estimate.base_position, *estimate.base_quaternion, *estimate.joint_pos]).all():
            self.count += 1
            self._pitch += ground_pitch(estimate, self.legs)
            self._height += float(estimate.base_position[2])

    @property
    def pitch(self) -> float:
        """Of the ground, rad, nose-down; asked after the first estimate."""
        return self._pitch / self.count

    @property
    def height_m(self) -> float:
        """Of the base in the world, m; asked after the first estimate."""
        return self._height / self.count


@dataclass(frozen=True)
class Transition:
    """The way from the plan of the expected stance to that of the measured one, linear in time."""

    change: np.ndarray
    """Change of goal and stance, (4,), m, m, rad, rad."""
    begin_s: float
    lasts_s: float

    def share(self, time_s: float) -> float:
        """Share of the way that is gone at a time since the start of the jump, s."""
        return float(np.clip((time_s - self.begin_s) / self.lasts_s, 0, 1))

    def move(self, shift: np.ndarray, time_s: float) -> np.ndarray:
        """Shift of goal and stance, (4,), with a shift (3,) of the goal on the way."""
        return np.append(shift, 0.0) + self.share(time_s) * self.change

    def rate(self, rate: np.ndarray, time_s: float) -> np.ndarray:
        """Rate of that per s, (4,), with a rate (3,) of the goal's shift."""
        return np.append(rate, 0.0) + (self.share(time_s) < 1) / self.lasts_s * self.change


def ground_pitch(estimate: StateEstimate, legs: LegKinematics) -> float:
    """Pitch of the ground under a robot that stands, rad, nose-down: the slope from the rear to the front feet.

    Feet by forward kinematics of the measured joints and attitude.
    """
    front, rear = legs.pair_offsets(estimate.base_quaternion, estimate.joint_pos)
    return float(-np.arctan2(front[2] - rear[2], np.hypot(*(front - rear)[:2])))
