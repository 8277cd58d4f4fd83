"""Where the base is and how fast it moves, where no log says so: from feet that stand, attitude, gyro and joints.

The sole of a foot that stands is at rest on level ground. So the base moves as that sole seems to move, seen from the
base, with the opposite sign, and it is as high as the sole is below it. The estimate starts replays and is compared
with nothing.
"""

from dataclasses import dataclass

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.log import Log
from leapgap.logs.metadata import runs_of
from leapgap.robot.kinematics import feet_load, sinking_depths, soles
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of
from leapgap.robot.motion import Motion

LOADED = 0.3  # a foot stands while its force is above this share of its own range in the log
OUTLIERS = 2  # percent of the forces of a foot at either end that do not count in its range: impacts
LEAST_LOAD, LEAST_FLIGHT_S = 0.2, 0.03
"""Without contact or forces, a robot flies where its feet bear less than this share of its weight for this time."""
MEAN_LOAD = (0.5, 2.0)  # over a log the feet bear the weight of the robot on average, within these factors
NEAR_M = 0.02  # without contact or forces, soles that are higher than the lowest by less than this may stand


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


LEVEL_M = 0.002  # a foot counts less by e for each such height of its sole above the lowest: it may have lifted
POSES = 60  # number of poses, evenly over the log, of which the median depth in the ground is taken
SMOOTHED_S = 0.025
"""Each row is the value of a line through the rows up to this time before and after it. Those in which feet disagree,
because some just lift or land, count less."""
LEAST_DEVIATION = (0.01, 0.01, 0.03, 0.002)
"""Smallest standard deviations of velocity x, y, z, m/s, and of height, m: feet slip, and the ground gives way under a
changing load."""
ACCELERATION_S, ACCELERATION_ROWS = 0.03, 7  # slopes of parabolas through velocities in this time, or so many rows


@dataclass(frozen=True)
class BaseEstimate:
    """The base in each row, with standard deviations."""

    position: np.ndarray  # (rows, 3), m; x and y begin at zero
    velocity: np.ndarray  # (rows, 3), m/s, of the origin of the base in the world
    height_deviation: np.ndarray  # (rows,), m
    velocity_deviation: np.ndarray  # (rows, 3), m/s

    def first_rows(self, rows: int) -> "BaseEstimate":
        """The estimate of the first rows."""
        return BaseEstimate(**{name: values[:rows] for name, values in vars(self).items()})


def check_base(log: Log, robot: Robot) -> None:
    """Raise ``InputError`` for a log from which the base of a floating robot cannot be estimated."""
    has_joints = all(f"joint_pos/{joint}" in log for joint in robot.joints)
    for has, what, do in (
        (robot.feet, "feet of the model", "name them (names.feet), or log the position of the base"),
        (not log.info.terrain, "level ground", "log the position of the base: it walks on blocks"),
        (has_joints, "positions of all joints", "log them, or the position of the base"),
    ):
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
    measured = measured_stance(log, robot)
    stands = (
        stance_by_height(log.time, height, borne_share(log, robot, motion, torque)) if measured is None else measured
    )
    planted, weight = np.any(stands, axis=1), weights(height, stands)
    # Of each foot that stands: the base's velocity and height if this foot were at rest on the ground.
    told = np.concatenate([-velocity, robot.ground_height - height[..., None]], axis=2)
    mean = np.einsum("rf,rfc->rc", weight, told)
    spread = np.einsum("rf,rfc->rc", weight, (told - mean[:, None]) ** 2)
    variance = spread + np.square(LEAST_DEVIATION)
    smooth, deviation = weighted_lines(mean, variance, planted, log.info.rows(SMOOTHED_S))
    above, seen = smooth[:, 3] - sinking(robot, motion, height, stands, torque), smooth[:, :3]
    above, seen = through_flights(log.time, above, seen, planted, gravity_of(robot.model))
    steps = np.diff(log.time)[:, None] * (seen[1:, :2] + seen[:-1, :2]) / 2
    position = np.column_stack([np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]), above])
    return BaseEstimate(position, seen, height_deviation=deviation[:, 3], velocity_deviation=deviation[:, :3])


def borne_share(log: Log, robot: Robot, motion: Motion, torque: np.ndarray) -> np.ndarray:
    """Share of the robot's weight that its feet bear by the torques of its motors, (rows,)."""
    rates = velocity_fit(log.time, motion.qvel, max(ACCELERATION_S, ACCELERATION_ROWS * log.info.sample_period_s))
    weight = robot.total_mass * float(np.linalg.norm(robot.model.opt.gravity))
    share = feet_load(robot, motion, rates.velocity, torque) / weight
    reach = log.info.rows(ACCELERATION_S / 2)
    kernel = np.ones(2 * reach + 1)
    return np.asarray(np.convolve(share, kernel, "same") / np.convolve(np.ones(len(share)), kernel, "same"))


def weights(height: np.ndarray, stands: np.ndarray) -> np.ndarray:
    """Weight of each foot, (rows, feet), sum 1: the lower a sole that stands the more; zero in flight."""
    lowest = np.where(stands, height, np.inf).min(axis=1, keepdims=True)
    lowest = np.where(np.isfinite(lowest), lowest, 0.0)
    raw = np.where(stands, np.exp(-np.maximum(height - lowest, 0.0) / LEVEL_M), 0.0)
    return np.asarray(raw / np.maximum(raw.sum(axis=1, keepdims=True), 1e-300))


def sinking(robot: Robot, motion: Motion, height: np.ndarray, stands: np.ndarray, torque: np.ndarray) -> float:
    """How far weighted soles are below the surface of the model's ground, m: the median over some poses.

    The replay's ground is soft, whatever the real one is: a robot that starts on its surface would fall. It is zero
    where the ground bears the robot in no pose.
    """
    planted = np.flatnonzero(stands.any(axis=1))
    if not len(planted):
        return 0.0
    rows = planted[np.unique(np.linspace(0, len(planted) - 1, POSES).astype(int))]
    lowest = robot.ground_height - height[rows].min(axis=1)
    qpos = motion.qpos[rows].copy()
    Motion(qpos, motion.qvel[rows]).base_position[:, 2] = lowest
    weighted = robot.ground_height - (weights(height[rows], stands[rows]) * height[rows]).sum(axis=1)
    depth = sinking_depths(robot, qpos, torque[rows])
    borne = np.isfinite(depth)
    return float(np.median((depth - (lowest - weighted))[borne])) if borne.any() else 0.0


def through_flights(
    time: np.ndarray, height: np.ndarray, velocity: np.ndarray, planted: np.ndarray, gravity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Height (rows,) and velocity (rows, 3) with flights as arcs between the rows in which feet stand.

    ``gravity`` (3,), m/s², is the model's; one that leans drives the base sideways, too. A flight at an end of
    the log goes on from the row beside it; a log without a stance rests at its first height.
    """
    height, velocity = height.copy(), velocity.copy()

    def sideways(at: int, rows: np.ndarray) -> np.ndarray:
        return velocity[at, :2] + (time[rows] - time[at])[:, None] * gravity[:2]

    for flight in runs_of(~planted):
        rows, before, after = np.arange(flight.start, flight.stop), flight.start - 1, flight.stop
        if before < 0 and after >= len(time):
            continue
        if before < 0 or after >= len(time):
            at = after if before < 0 else before
            velocity[rows, :2] = sideways(at, rows)
            rise = velocity[at, 2]
        else:
            at, lasts = before, time[after] - time[before]
            share = ((time[rows] - time[before]) / lasts)[:, None]
            velocity[rows, :2] = (1 - share) * sideways(before, rows) + share * sideways(after, rows)
            rise = (height[after] - height[before]) / lasts - gravity[2] * lasts / 2
        age = time[rows] - time[at]
        height[rows] = height[at] + rise * age + gravity[2] * age**2 / 2
        velocity[rows, 2] = rise + gravity[2] * age
    return height, velocity


def weighted_lines(
    values: np.ndarray, variance: np.ndarray, known: np.ndarray, reach: int
) -> tuple[np.ndarray, np.ndarray]:
    """Lines through the neighbours of each row, and standard deviations, (rows, channels) each.

    ``values`` and their ``variance`` are (rows, channels), ``known`` (rows,) says which rows count. A row up to
    ``reach`` rows away counts the less the farther it is and the larger its variance. The deviation is the weighted
    mean of these variances: errors of neighbours are alike. Without a known neighbour values stay, and the deviation
    is that of the whole log.
    """
    age = np.arange(-reach, reach + 1)
    near = 1 - np.abs(age) / (reach + 1)

    def total(of: np.ndarray, power: int) -> np.ndarray:
        kernel = (near * age**power)[::-1]
        return np.stack([np.convolve(channel, kernel, "full")[reach : reach + len(of)] for channel in of.T], axis=1)

    weight = known[:, None] / variance
    s0, s1, s2 = (total(weight, power) for power in range(3))
    v0, v1 = (total(weight * values, power) for power in range(2))
    line = s0 * s2 - s1**2
    sloped, alone = line > 1e-9 * np.maximum(s0 * s2, 1e-300), s0 > 0
    level = np.where(alone, v0 / np.where(alone, s0, 1.0), values)
    smooth = np.where(sloped, (s2 * v0 - s1 * v1) / np.where(sloped, line, 1.0), level)
    typical = variance[known].mean(axis=0) if known.any() else variance.mean(axis=0)
    own = np.where(alone, total(weight * variance, 0) / np.where(alone, s0, 1.0), typical)
    return np.where(known[:, None], smooth, values), np.sqrt(own)
