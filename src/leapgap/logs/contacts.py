"""Which feet stand and which are in the air, as measured: by contact columns, else by the height of the soles."""

import numpy as np

from leapgap.logs.base_estimate import contact_columns
from leapgap.logs.log import Log
from leapgap.logs.metadata import FLIGHT, runs_of, segment_of_rows
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import feet_positions
from leapgap.robot.model import Robot

LIFTED_M = 0.015  # a sole this much above the height at which it stands has left the ground
LOW = 20  # percentile of the heights of a foot at which it stands
STILL_M_PER_S = 0.1  # largest speed of a foot that counts as standing
MOST_OF_THE_TIME = 75  # percentile of the speed of feet that must be below it
LOOK_S = 0.1  # time over which the speed of feet is taken


def has_feet_in_world(log: Log, robot: Robot) -> bool:
    """Whether the places of the feet follow from the log: feet, pose of the base, joint positions."""
    columns = ("base_pos_x", "base_quat_w", *(f"joint_pos/{joint}" for joint in robot.joints[:1]))
    return robot.stands and all(column in log for column in columns)


def feet_in_world(log: Log, robot: Robot, rows: slice = slice(None)) -> np.ndarray:
    """Centres of the feet, m, (rows, feet, 3), by forward kinematics of what was logged."""
    return feet_positions(robot, motion_of(log, robot, rows).qpos)


def sole_heights(log: Log, robot: Robot, rows: slice = slice(None)) -> np.ndarray:
    """Height of each sole above the stated ground, m, (rows, feet)."""
    feet = feet_in_world(log, robot, rows)
    ground = np.full(feet.shape[:2], robot.ground_height)
    for box in log.info.terrain:
        inside = (np.abs(feet[..., 0] - box.x_m) < box.size_m[0] / 2) & (
            np.abs(feet[..., 1] - box.y_m) < box.size_m[1] / 2
        )
        ground = np.where(inside, np.maximum(ground, box.top_m), ground)
    return feet[..., 2] - robot.foot_radius - ground


def in_flight(log: Log, robot: Robot) -> np.ndarray:
    """Rows in which no foot touches anything, bool, (rows,); within the planned flight where the log states one."""
    contact = contact_columns(log, robot)
    if contact is not None:
        flies = ~contact.any(axis=1)
    else:
        height = feet_in_world(log, robot)[..., 2]
        flies = (height - ground_level(height) > LIFTED_M).all(axis=1)
    segments = log.info.segments
    planned = [k for k, segment in enumerate(segments) if segment.name == FLIGHT]
    return np.asarray(flies & np.isin(segment_of_rows(segments, log.time), planned) if planned else flies)


def ground_level(height: np.ndarray) -> np.ndarray:
    """Height at which each foot stands, m, (feet,): a low percentile, since soft feet sink in when they land."""
    return np.asarray(np.percentile(height, LOW, axis=0))


def longest_stance(log: Log, robot: Robot) -> slice:
    """The longest time in which all feet stand; empty where they never do.

    Without contact columns all soles must be low, and slow most of the time: a foot that seems to move for a moment is
    what a check of planted feet looks for.
    """
    contact = contact_columns(log, robot)
    if contact is not None:
        return longest_run(np.asarray(contact.all(axis=1)))
    feet = feet_in_world(log, robot)
    height = feet[..., 2]
    stance = longest_run((height - ground_level(height) < LIFTED_M).all(axis=1))
    look = log.info.rows(LOOK_S)
    if stance.stop - stance.start <= look:
        return slice(0, 0)
    moved = np.linalg.norm(feet[stance][look:] - feet[stance][:-look], axis=2).max(axis=1)
    speed = moved / (look * log.info.sample_period_s)
    return stance if np.percentile(speed, MOST_OF_THE_TIME) < STILL_M_PER_S else slice(0, 0)


def longest_run(rows: np.ndarray) -> slice:
    """The longest unbroken run of rows (bool) that are true, as a slice; empty where none is."""
    return max(runs_of(rows), key=lambda run: run.stop - run.start, default=slice(0, 0))
