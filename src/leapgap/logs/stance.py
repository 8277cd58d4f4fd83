"""Which feet stand, by what a log holds of them: contact, forces, or how low their soles are and what they bear."""

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.segments import runs_of
from leapgap.robot.model import Robot

LOADED = 0.3
"""A foot stands while its force is above this share of its own range in the log."""
OUTLIERS = 2
"""Percent of the forces of a foot at either end that do not count in its range: impacts."""
LEAST_LOAD, LEAST_FLIGHT_S = 0.2, 0.03
"""Without contact or forces, a robot flies where its feet bear less than this share of its weight for this time."""
MEAN_LOAD = (0.5, 2.0)
"""Over a log the feet bear the weight of the robot on average, within these factors."""
NEAR_M = 0.02
"""Without contact or forces, soles that are higher than the lowest by less than this may stand."""


def contact_columns(log: Log, robot: Robot) -> np.ndarray | None:
    """Measured contact of each foot, bool, (rows, feet); None where the log lacks that of some foot."""
    columns = columns_of_feet(log, robot, "contact")
    return None if columns is None else columns > 0


def stance_by_force(log: Log, robot: Robot) -> np.ndarray | None:
    """Feet whose force is well above its least in the log, bool, (rows, feet); None where forces were not logged."""
    force = columns_of_feet(log, robot, "foot_force")
    if force is None:
        return None
    least, most = np.percentile(force, [OUTLIERS, 100 - OUTLIERS], axis=0)
    always = least > LOADED * most  # a foot that is never lifted
    return np.asarray(always | (force > least + LOADED * (most - least)))


def measured_stance(log: Log, robot: Robot) -> np.ndarray | None:
    """Feet that stand in each row, bool, (rows, feet), by contact, else by force; None where neither was logged."""
    for measured in (contact_columns(log, robot), stance_by_force(log, robot)):
        if measured is not None and measured.any():
            return measured
    return None


def stance_by_height(time: np.ndarray, height: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Feet that stand in each row, bool, (rows, feet): those with the lowest soles, and none while nothing is borne.

    ``height`` (rows, feet), m, is the height of each sole above any level surface, ``load`` (rows,) what all feet bear
    by the torques of the motors, as a share of the weight. On average that is all of it, in flights or not; torques
    that say otherwise are not those of the robot, and tell no flight.
    """
    lowest = np.asarray(height < height.min(axis=1, keepdims=True) + NEAR_M)
    if not MEAN_LOAD[0] < load.mean() < MEAN_LOAD[1]:
        return lowest
    for run in runs_of(load < LEAST_LOAD):
        if time[run.stop - 1] - time[run.start] >= LEAST_FLIGHT_S:
            lowest[run] = False
    return lowest


def columns_of_feet(log: Log, robot: Robot, quantity: str) -> np.ndarray | None:
    """One quantity of all feet, (rows, feet); None where the log lacks that of some foot."""
    names = [f"{quantity}/{foot}" for foot in robot.feet]
    return log.stack(names) if names and all(name in log for name in names) else None
