"""The motion of a robot in MuJoCo's coordinates; only this file holds the indices of a free base in them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

POSITION_SLICE, QUATERNION_SLICE = slice(0, 3), slice(3, 7)  # free base in ``qpos``: origin, m; base to world, w x y z
VELOCITY_SLICE, ANGULAR_VELOCITY_SLICE = slice(0, 3), slice(3, 6)
"""A free base in ``qvel``: of its origin in the world, m/s; in base axes, as a gyro reads it, rad/s."""
TWIST_SLICE = slice(0, 6)  # all of a free base in ``qvel``


@dataclass(frozen=True)
class Motion:
    """Positions and velocities of a robot over time, SI units; the base parts exist for a free base only."""

    qpos: np.ndarray  # (rows, nq): position and quaternion w x y z of a free base, then joints, in MuJoCo's order
    qvel: np.ndarray  # (rows, nv): velocity of a free base in the world, its angular velocity in base axes, then joints
    sensors: np.ndarray | None = None
    """(rows, sensors): what sensors beside the state measured, in an order that the caller knows; None without any."""
    time: np.ndarray | None = None  # (rows,), s, of uneven rows while effects change what is measured; None elsewhere

    @staticmethod
    def of_states(states: np.ndarray, nq: int) -> "Motion":
        """The motion of states (rows, nq + nv), positions first."""
        return Motion(*np.split(states, [nq], axis=1))

    def __len__(self) -> int:
        return len(self.qpos)

    def __getitem__(self, rows: slice | np.ndarray) -> "Motion":
        """The motion in some of its rows."""
        sensors, time = (None if one is None else one[rows] for one in (self.sensors, self.time))
        return Motion(self.qpos[rows], self.qvel[rows], sensors, time)

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Positions and velocities row by row."""
        return zip(self.qpos, self.qvel, strict=True)

    @property
    def base_position(self) -> np.ndarray:
        """(rows, 3), m, origin of the base in the world."""
        return self.qpos[:, POSITION_SLICE]

    @property
    def base_quaternion(self) -> np.ndarray:
        """(rows, 4), w x y z, base to world."""
        return self.qpos[:, QUATERNION_SLICE]

    @property
    def base_velocity(self) -> np.ndarray:
        """(rows, 3), m/s, of the origin of the base in the world."""
        return self.qvel[:, VELOCITY_SLICE]

    @property
    def base_angular_velocity(self) -> np.ndarray:
        """(rows, 3), rad/s, in base axes."""
        return self.qvel[:, ANGULAR_VELOCITY_SLICE]

    def copy(self) -> "Motion":
        """A copy with arrays of its own."""
        sensors, time = (None if one is None else one.copy() for one in (self.sensors, self.time))
        return Motion(self.qpos.copy(), self.qvel.copy(), sensors, time)

    @property
    def first_state(self) -> np.ndarray:
        """Positions and velocities of the first row, (nq + nv,)."""
        return np.concatenate([self.qpos[0], self.qvel[0]])

    @property
    def last_state(self) -> np.ndarray:
        """Positions and velocities of the last row, (nq + nv,)."""
        return np.concatenate([self.qpos[-1], self.qvel[-1]])
