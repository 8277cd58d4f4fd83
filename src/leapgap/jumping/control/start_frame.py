"""The frame in which a jump begins."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from leapgap.logs.pair_force import by_pair, flat
from leapgap.robot.rotations import pitch_of, yaw_of
from leapgap.simulation.controller import StateEstimate


class Legs(Protocol):
    """What a frame asks of the legs (``LegKinematics``)."""

    def pair_offsets(self, base_quaternion: np.ndarray, joint_pos: np.ndarray) -> np.ndarray:
        """Foot − base in the world, mean of each pair, m, (2, 3)."""


@dataclass(frozen=True)
class StartFrame:
    """Frame of a jump's start: x along the heading from the start, z up from the ground there."""

    x_m: float
    y_m: float
    yaw_rad: float
    level_m: float = 0.0
    """Height in the world of the reference's z = 0."""

    @staticmethod
    def of(estimate: StateEstimate, level_m: float = 0.0) -> "StartFrame":
        """The frame at the robot's present position and heading."""
        x, y, _ = estimate.base_position
        return StartFrame(float(x), float(y), float(yaw_of(estimate.base_quaternion)), level_m)

    @cached_property
    def forward(self) -> np.ndarray:
        """Unit vector of the heading in the world, (3,)."""
        return np.array([np.cos(self.yaw_rad), np.sin(self.yaw_rad), 0.0])

    def state(self, estimate: StateEstimate) -> np.ndarray:
        """Measured x z pitch and their rates in this frame, as in ``Reference``, (6,)."""
        x, y, z = estimate.base_position
        return np.array(
            [
                (x - self.x_m) * self.forward[0] + (y - self.y_m) * self.forward[1],
                z - self.level_m,
                pitch_of(estimate.base_quaternion),
                estimate.base_velocity @ self.forward,
                estimate.base_velocity[2],
                estimate.base_angular_velocity[1],
            ]
        )

    def foot(self, estimate: StateEstimate, legs: Legs) -> np.ndarray:
        """Foot − base, mean of each pair, front x z, rear x z, m, as in ``Reference``, (4,)."""
        offset = legs.pair_offsets(estimate.base_quaternion, estimate.joint_pos)
        return flat(np.stack([offset @ self.forward, offset[:, 2]], axis=1))

    def in_world(self, force: np.ndarray) -> np.ndarray:
        """Planar pair forces (4,) along the heading as vectors in the world, (2, 3)."""
        planar = by_pair(force)
        return planar[:, :1] * self.forward + planar[:, 1:] * np.array([0.0, 0.0, 1.0])
