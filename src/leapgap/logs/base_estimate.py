"""Where the base is and how fast it moves, where no log says so: from feet that stand, attitude, gyro and joints.

The sole of a foot that stands is at rest on level ground. So the base moves as that sole seems to move, seen from the
base, with the opposite sign, and it is as high as the sole is below it. The estimate starts replays and is compared
with nothing.
"""

from dataclasses import dataclass

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.stance import stance
from leapgap.robot.ground_load import sinking_depths
from leapgap.robot.kinematics import soles
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion

LEVEL_M = 0.003
"""A foot that stands counts less by e for each such height of its sole above the lowest: it may have just lifted."""
POSES = 60
"""Number of poses, evenly over the log, of which the median depth in the ground is taken."""
SPREAD_S = 0.05
"""Feet are compared over this time: while one foot stands, its neighbours in time tell the spread."""
LEAST_VELOCITY_M_PER_S = 0.02
LEAST_HEIGHT_M = 0.002
"""Smallest standard deviations: feet slip and roll, and the ground gives way under a changing load."""
GRAVITY = 9.81


@dataclass(frozen=True)
class BaseEstimate:
    """The base in each row, with standard deviations."""

    position: np.ndarray
    """(rows, 3), m; x and y begin at zero."""
    velocity: np.ndarray
    """(rows, 3), m/s, of the origin of the base in the world."""
    height_deviation: np.ndarray
    """(rows,), m."""
    velocity_deviation: np.ndarray
    """(rows, 3), m/s."""


def check_base(log: Log, robot: Robot) -> None:
    """Raise ``InputError`` for a log from which the base of a floating robot cannot be estimated."""
    lacks = [
        (robot.feet, "feet of the model", "name them (names.feet), or log the position of the base"),
        (not log.info.terrain, "level ground", "log the position of the base: it walks on blocks"),
        (
            all(f"joint_pos/{joint}" in log for joint in robot.joints),
            "positions of all joints",
            "log them, or the position of the base",
        ),
    ]
    for has, what, do in lacks:
        if not has:
            found = "no base_pos_x, base_pos_y, base_pos_z"
            raise InputError(log.name, found, f"the position of the base, or {what} to estimate it from", do)


def estimate_base(log: Log, robot: Robot, motion: Motion, torque: np.ndarray) -> BaseEstimate:
    """Estimate position and velocity of the base.

    ``motion`` has attitude, gyro and joints as logged, and a base at rest in the origin. ``torque`` (rows, nv) are the
    torques of the motors.
    """
    place, velocity = soles(robot, motion)
    height = place[..., 2]
    stands = stance(log, robot, height)
    planted = stands.any(axis=1)
    weight = weights(height, stands)
    seen = -np.einsum("rf,rfc->rc", weight, velocity)
    above = -(weight * height).sum(axis=1)
    spread = np.einsum("rf,rfc->rc", weight, (velocity + seen[:, None]) ** 2)
    uneven = (weight * (height + above[:, None]) ** 2).sum(axis=1)
    above -= sinking(robot, motion, height, stands, torque)
    above, seen = through_flights(log.time, above, seen, planted)
    steps = np.diff(log.time)[:, None] * (seen[1:, :2] + seen[:-1, :2]) / 2
    position = np.column_stack([np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), above])
    rows = log.info.rows(SPREAD_S)
    return BaseEstimate(
        position,
        seen,
        deviation(uneven[:, None], planted, rows, LEAST_HEIGHT_M)[:, 0],
        deviation(spread, planted, rows, LEAST_VELOCITY_M_PER_S),
    )


def weights(height: np.ndarray, stands: np.ndarray) -> np.ndarray:
    """Weight of each foot, (rows, feet), sum 1: the lower a sole that stands the more; zero in flight."""
    lowest = np.where(stands, height, np.inf).min(axis=1, keepdims=True)
    lowest = np.where(np.isfinite(lowest), lowest, 0.0)
    raw = np.where(stands, np.exp(-np.maximum(height - lowest, 0.0) / LEVEL_M), 0.0)
    return np.asarray(raw / np.maximum(raw.sum(axis=1, keepdims=True), 1e-300))


def sinking(robot: Robot, motion: Motion, height: np.ndarray, stands: np.ndarray, torque: np.ndarray) -> float:
    """How far weighted soles are below the surface of the model's ground, m: the median over some poses.

    The replay's ground is soft, whatever the real one is: a robot that starts on its surface would fall.
    """
    planted = np.flatnonzero(stands.any(axis=1))
    if not len(planted):
        return 0.0
    rows = planted[np.unique(np.linspace(0, len(planted) - 1, POSES).astype(int))]
    lowest = -height[rows].min(axis=1)
    qpos = motion.qpos[rows].copy()
    Motion(qpos, motion.qvel[rows]).base_position[:, 2] = lowest
    weighted = -(weights(height[rows], stands[rows]) * height[rows]).sum(axis=1)
    return float(np.median(sinking_depths(robot, qpos, torque[rows]) - (lowest - weighted)))


def through_flights(
    time: np.ndarray, height: np.ndarray, velocity: np.ndarray, planted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Height (rows,) and velocity (rows, 3) with flights as arcs between the rows in which feet stand.

    A flight at an end of the log goes on from the row beside it; a log without a stance rests at its first height.
    """
    height, velocity = height.copy(), velocity.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], planted, [True]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        rows, before, after = np.arange(begin, end), begin - 1, end
        if before < 0 and after >= len(time):
            continue
        if before < 0 or after >= len(time):
            at = after if before < 0 else before
            velocity[rows, :2] = velocity[at, :2]
            rise = velocity[at, 2]
        else:
            at, lasts = before, time[after] - time[before]
            share = ((time[rows] - time[before]) / lasts)[:, None]
            velocity[rows, :2] = (1 - share) * velocity[before, :2] + share * velocity[after, :2]
            rise = (height[after] - height[before]) / lasts + GRAVITY * lasts / 2
        age = time[rows] - time[at]
        height[rows] = height[at] + rise * age - GRAVITY * age**2 / 2
        velocity[rows, 2] = rise - GRAVITY * age
    return height, velocity


def deviation(square: np.ndarray, planted: np.ndarray, rows: int, least: float) -> np.ndarray:
    """Standard deviation from the spread of feet (rows, channels), averaged over so many rows, at least ``least``.

    Rows of a flight have that of the whole log's stances beside.
    """
    if not planted.any():
        return np.full(square.shape, least)
    typical = square[planted].mean(axis=0)
    known = np.where(planted[:, None], square, typical)
    window = np.ones(max(1, rows))
    number = np.convolve(np.ones(len(known)), window, "same")
    local = np.stack([np.convolve(channel, window, "same") for channel in known.T], axis=1) / number[:, None]
    return np.asarray(np.sqrt(least**2 + local))
