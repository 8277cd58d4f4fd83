"""Layout of forces and positions of the front and the rear pair of feet in the x–z plane: front x z, rear x z."""

from typing import Any

import numpy as np

from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS

AXES = ("x", "z")
FORCES = len(PAIR_FORCE_AXES)

FRONT_X, FRONT_Z, REAR_X, REAR_Z = range(FORCES)
OF_PAIR = ((FRONT_X, FRONT_Z), (REAR_X, REAR_Z))  # entries of each pair, x then z
FORCE_X, FORCE_Z = slice(FRONT_X, FORCES, len(AXES)), slice(FRONT_Z, FORCES, len(AXES))
"""The x, or the z, of both pairs; of feet as of forces."""
WORLD_X_Z = (0, 2)  # which axes of the world (x, y, z) the plane holds


def per_axis(of_pairs: Any) -> np.ndarray:
    """Values of each pair, (…, 2), repeated for each entry of its force, (…, 4)."""
    return np.repeat(of_pairs, len(AXES), axis=-1)


def by_pair(force: np.ndarray) -> np.ndarray:
    """Pair forces (…, 4) as (…, pair, axis), shape (…, 2, 2)."""
    return force.reshape(*force.shape[:-1], len(PAIRS), len(AXES))


def flat(of_pairs: np.ndarray) -> np.ndarray:
    """The inverse of ``by_pair``: (…, 2, 2) to (…, 4)."""
    return of_pairs.reshape(*of_pairs.shape[:-2], FORCES)


def per_pair(robot: Robot, of_feet: np.ndarray) -> np.ndarray:
    """Sum over the feet of each pair, in the planar axes: (rows, feet, 3) to front x z, rear x z, (rows, 4)."""
    sums = [of_feet[:, robot.feet_at(pair)].sum(axis=1) for pair in PAIRS]
    return np.concatenate([s[:, WORLD_X_Z] for s in sums], axis=1)
