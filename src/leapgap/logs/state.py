"""Conversion between the columns of a log and the motion of a robot; no other file does it."""

from collections.abc import Sequence

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.base_estimate import BaseEstimate, check_base, estimate_base
from leapgap.logs.derivatives import velocity_fit
from leapgap.logs.log import Log
from leapgap.logs.missing_velocities import add_velocities
from leapgap.logs.noise import noise_of
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from leapgap.robot.motion import ANGULAR_VELOCITY_SLICE, VELOCITY_SLICE, Motion
from leapgap.robot.rotations import turn_between

FIT_WINDOW_S, FIT_ROWS = 0.03, 7
"""Velocities that were not logged are slopes of parabolas through the positions within this time, or so many rows."""


def motion_of(log: Log, robot: Robot, rows: slice = slice(None)) -> Motion:
    """The measured motion of the robot in some rows of a log.

    A free base needs a logged attitude (``InputError`` otherwise). Velocities of which no component was logged come
    from a fit through the positions (``fitted_velocities``), the position and velocity of a base without a logged
    position from its feet (``estimated_base``). A single component that is missing is zero.
    """
    motion, estimate = logged_motion(log, robot, rows), estimated_base(log, robot)
    if estimate is not None:
        motion.base_position[:] = estimate.position[rows]
        if not has_base_velocity(log):
            motion.base_velocity[:] = estimate.velocity[rows]
    return motion


def logged_motion(log: Log, robot: Robot, rows: slice = slice(None)) -> Motion:
    """The motion with its fitted velocities, and zero for the position of a base that was not logged."""
    log, _ = fitted_velocities(log, robot)
    number = len(range(*rows.indices(len(log))))
    motion = Motion(np.tile(robot.model.qpos0, (number, 1)), np.zeros((number, robot.model.nv)))
    if robot.has_free_base:
        if BASE_QUATERNION[0] not in log:
            raise InputError(
                log.name,
                f"no {', '.join(BASE_QUATERNION)}",
                f"the attitude of the free base of {robot.name}",
                "log it; a robot that hangs is diagnosed with robot.fix_base=true",
            )
        motion.base_position[:] = log.stack(BASE_POSITION)[rows] if BASE_POSITION[0] in log else 0.0
        motion.base_quaternion[:] = quaternions(log)[rows]
        for part, columns in (
            (motion.base_velocity, BASE_VELOCITY),
            (motion.base_angular_velocity, BASE_ANGULAR_VELOCITY),
        ):
            for axis, column in enumerate(columns):
                if column in log:
                    part[:, axis] = log[column][rows]
    motion.qpos[:, robot.joint_qpos] = log.per_joint("joint_pos", robot.joints)[rows]
    if f"joint_vel/{robot.joints[0]}" in log:
        motion.qvel[:, robot.joint_dofs] = log.per_joint("joint_vel", robot.joints)[rows]
    return motion


def has_base_velocity(log: Log) -> bool:
    """Whether any component of the base's velocity was logged."""
    return any(column in log for column in BASE_VELOCITY)


def estimated_base(log: Log, robot: Robot) -> BaseEstimate | None:
    """The base of a floating robot by its planted feet, where its position was not logged; None elsewhere; cached.

    It starts replays, and is compared with nothing.
    """
    if not robot.has_free_base or BASE_POSITION[0] in log:
        return None
    known, found = log.__dict__.get("_base", (None, None))
    if known is not robot:
        check_base(log, robot)
        motion = logged_motion(log, robot)
        found = estimate_base(log, robot, motion, motor_torques(log, robot, motion))
        log.__dict__["_base"] = (robot, found)
    return found


def motor_torques(log: Log, robot: Robot, motion: Motion) -> np.ndarray:
    """Torques that the log's commands ask for at a motion, within the limits of the motors, N·m, (rows, nv)."""
    torque = np.zeros_like(motion.qvel)
    at = [k for k, joint in enumerate(robot.joints) if joint in log.joints]
    joints, dofs = tuple(robot.joints[k] for k in at), robot.joint_dofs[at]
    spring, damper = pd_torques(log, joints, motion.qpos[:, robot.joint_qpos[at]], motion.qvel[:, dofs])
    limits = robot.torque_limits[at]
    torque[:, dofs] = np.clip(log.per_joint("cmd_tau", joints) + spring + damper, -limits, limits)
    return torque


def fitted_velocities(log: Log, robot: Robot) -> tuple[Log, frozenset[str]]:
    """The log with velocities from its positions where it has none, and the quantities that were fitted; cached.

    They start replays, and are compared with nothing.
    """
    if "_fitted" not in log.__dict__:
        window = max(FIT_WINDOW_S, FIT_ROWS * log.info.sample_period_s)
        joints = [joint for joint in robot.joints if f"joint_pos/{joint}" in log]
        enough = len(log) >= FIT_ROWS
        full, derived = add_velocities(log, joints, window) if enough else (log, {})
        log.__dict__["_fitted"] = (full, frozenset([*derived, *log.derived]))
    found: tuple[Log, frozenset[str]] = log.__dict__["_fitted"]
    return found


def fitted_noise(log: Log, motion: Motion, robot: Robot, rows: Sequence[int]) -> np.ndarray:
    """Standard deviation of states that were not measured, in their tangent, (rows, 2 nv).

    That of fitted velocities is by the noise of the positions, and largest at the ends of a log; that of an estimated
    base by how far its feet disagree. It is zero for what was logged. ``motion`` is that of the log.
    """
    nv, found = robot.model.nv, np.zeros((len(rows), 2 * robot.model.nv))
    _, fitted = fitted_velocities(log, robot)
    if fitted:
        window = max(FIT_WINDOW_S, FIT_ROWS * log.info.sample_period_s)
        gain = velocity_fit(log.time, log.time, window).noise_gain[list(rows)]
        sigma = noise_of(np.diff(tangent_of(motion, robot), axis=0), log.info.sample_period_s)
        for quantity, entries in entries_of(robot).items():
            if quantity in fitted:
                found[:, nv + entries] = gain[:, None] * sigma[entries]
    estimate = estimated_base(log, robot)
    if estimate is not None:
        found[:, VELOCITY_SLICE.stop - 1] = estimate.height_deviation[list(rows)]
        if not has_base_velocity(log):
            found[:, nv : nv + VELOCITY_SLICE.stop] = estimate.velocity_deviation[list(rows)]
    return found


def entries_of(robot: Robot) -> dict[str, np.ndarray]:
    """Entries of each velocity in ``qvel``, by its quantity."""
    base = {"base_linvel": np.arange(3), "base_angvel": np.arange(3, 6)} if robot.has_free_base else {}
    return base | {"joint_vel": robot.joint_dofs}


def tangent_of(motion: Motion, robot: Robot) -> np.ndarray:
    """Positions as departures from the first row, in the tangent of the state, (rows, nv)."""
    found = np.zeros((len(motion), robot.model.nv))
    if robot.has_free_base:
        found[:, VELOCITY_SLICE] = motion.base_position - motion.base_position[0]
        first = np.repeat(motion.base_quaternion[:1], len(motion), axis=0)
        found[:, ANGULAR_VELOCITY_SLICE] = turn_between(first, motion.base_quaternion)
    found[:, robot.joint_dofs] = motion.qpos[:, robot.joint_qpos]
    return found


def columns_of(motion: Motion, robot: Robot) -> dict[str, np.ndarray]:
    """The measured columns of a log that this motion fills, each (rows,)."""
    columns: dict[str, np.ndarray] = {}
    if robot.has_free_base:
        for names, values in (
            (BASE_POSITION, motion.base_position),
            (BASE_QUATERNION, motion.base_quaternion),
            (BASE_VELOCITY, motion.base_velocity),
            (BASE_ANGULAR_VELOCITY, motion.base_angular_velocity),
        ):
            columns |= dict(zip(names, np.ascontiguousarray(values.T), strict=True))
    for joint, position, velocity in zip(robot.joints, robot.joint_qpos, robot.joint_dofs, strict=True):
        columns[f"joint_pos/{joint}"] = np.ascontiguousarray(motion.qpos[:, position])
        columns[f"joint_vel/{joint}"] = np.ascontiguousarray(motion.qvel[:, velocity])
    return columns


def quaternions(log: Log) -> np.ndarray:
    """Base to world, w x y z, (rows, 4)."""
    return log.stack(BASE_QUATERNION)


def positions(log: Log) -> np.ndarray:
    """Origin of the base in the world, m, (rows, 3)."""
    return log.stack(BASE_POSITION)


def pd_torques(
    log: Log, joints: tuple[str, ...], joint_pos: np.ndarray, joint_vel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Spring and damper torque that the log's commands ask for at given joint angles and velocities.

    N·m, (rows, joints) each; positions rad and velocities rad/s, (rows, joints), in the order of ``joints``.
    """
    spring = log.per_joint("cmd_kp", joints) * (log.per_joint("cmd_pos", joints) - joint_pos)
    damper = log.per_joint("cmd_kd", joints) * (log.per_joint("cmd_vel", joints) - joint_vel)
    return spring, damper


def commanded_torque(log: Log, joints: tuple[str, ...] | None = None) -> np.ndarray:
    """Feed-forward plus joint PD torque at the measured joint state, N·m, (rows, joints)."""
    named = log.joints if joints is None else joints
    measured = (log.per_joint(quantity, named) for quantity in ("joint_pos", "joint_vel"))
    spring, damper = pd_torques(log, named, *measured)
    return log.per_joint("cmd_tau", named) + spring + damper
