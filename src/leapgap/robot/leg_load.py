"""What load the feet of a robot bear, by the torques of its motors: the legs weigh the ground's push against them."""

import copy

import mujoco
import numpy as np

from leapgap.robot.kinematics import each_pose
from leapgap.robot.model import Robot
from leapgap.robot.motion import POSITION_SLICE, VELOCITY_SLICE, Motion


def feet_load(robot: Robot, motion: Motion, acceleration: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Upward force of the ground on all feet together in each row, N, (rows,).

    The joints of a robot in free fall need the torques of ``mj_inverse`` without contacts, for the accelerations
    (rows, nv) of its joints. What the motors deliver besides, (rows, nv), N·m, is the transposed Jacobian of the feet
    times the force of the ground. The acceleration of the base counts as free fall, since its share in the torques of
    light legs is small.
    """
    model, data = copy.copy(robot.model), mujoco.MjData(robot.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    falling = acceleration.copy()
    falling[:, VELOCITY_SLICE] = model.opt.gravity
    jacobian, load = np.zeros((3, model.nv)), np.zeros(len(motion))
    for row, posed in enumerate(each_pose(robot.model, motion.qpos, motion.qvel)):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.qpos[row], motion.qvel[row], falling[row]
        mujoco.mj_inverse(model, data)
        lacks = data.qfrc_inverse - torque[row]
        for geom in robot.foot_geoms:
            mujoco.mj_jacGeom(robot.model, posed, jacobian, None, int(geom))
            dofs = robot.joint_dofs[np.abs(jacobian[:, robot.joint_dofs]).sum(axis=0) > 0]
            load[row] += np.linalg.lstsq(jacobian[:, dofs].T, lacks[dofs], rcond=None)[0][2]
    return load


DEEPEST_M = 0.015
"""Ground that bears the weight of a robot no sooner than at this depth does not: the motors give way instead."""
HALVINGS = 9
"""Number of times that this depth is halved: to 0.03 mm."""


def sinking_depths(robot: Robot, qpos: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """How far the base is lower than in each given pose where the ground bears the weight, m, (poses,).

    ``qpos`` is (poses, nq), with the lowest soles just at the ground; ``torque`` (poses, nv) are the torques of the
    motors. At the depth that is found, the model's ground pushes up as much as the robot weighs, at rest. It is NaN
    where the model has no ground, or the motors do not hold the robot up.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    weight = robot.total_mass * float(-model.opt.gravity[2])
    up = POSITION_SLICE.stop - 1
    found = np.full(len(qpos), np.nan)

    def bears(pose: np.ndarray, motors: np.ndarray, depth: float) -> bool:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = pose
        data.qpos[up] -= depth
        data.qfrc_applied[:] = motors
        mujoco.mj_forward(model, data)
        return bool(data.qfrc_constraint[up] >= weight)

    for k, (pose, motors) in enumerate(zip(qpos, torque, strict=True)):
        low, high = 0.0, DEEPEST_M
        if not bears(pose, motors, high):
            continue
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if bears(pose, motors, middle) else (middle, high)
        found[k] = (low + high) / 2
    return found
