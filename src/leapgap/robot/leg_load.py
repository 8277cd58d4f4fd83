"""What load the feet of a robot bear, by the torques of its motors: the legs weigh the ground's push against them."""

import copy

import mujoco
import numpy as np

from leapgap.robot.kinematics import each_pose
from leapgap.robot.model import Robot
from leapgap.robot.motion import VELOCITY_SLICE, Motion


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
