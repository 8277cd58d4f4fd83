"""Conversion between the columns of a log and the motion of a robot; no other file does it."""

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


def motion_of(log: Log, robot: Robot, rows: slice = slice(None)) -> Motion:
    """The measured motion of the robot in some rows of a log.

    A free base needs a logged pose (``InputError`` otherwise). Velocities that were not logged are zero, and
    joints that were not logged keep the model's ``qpos0``.
    """
    number = len(range(*rows.indices(len(log))))
    motion = Motion(np.tile(robot.model.qpos0, (number, 1)), np.zeros((number, robot.model.nv)))
    if robot.has_free_base:
        motion.base_position[:], motion.base_quaternion[:] = log.stack(BASE_POSITION)[rows], quaternions(log)[rows]
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
