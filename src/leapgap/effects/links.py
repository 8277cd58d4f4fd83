"""Links that joints move: their masses, and where their centres lie seen from the joint."""

import mujoco
import numpy as np

from leapgap.robot.model import Robot

LEAST_ARM_M = 1e-4
"""A centre of mass nearer to its joint's axis than this has no direction away from it."""


def links_at(robot: Robot, location: str) -> np.ndarray:
    """Bodies that the joints at a location move, each once, in the order of the model."""
    return np.unique(robot.joint_bodies[robot.joints_at(location)])


def joint_of_link(robot: Robot, body: int) -> int:
    """MuJoCo's index of the last joint that moves a link against its parent."""
    of_body = np.flatnonzero(robot.joint_bodies == body)
    return int(robot.model.dof_jntid[robot.joint_dofs[of_body[-1]]])


def arm_of_centre(robot: Robot, body: int) -> np.ndarray:
    """From a link's joint to its centre of mass, square to the axis of a hinge, m, (3,), in the link's axes."""
    model, joint = robot.model, joint_of_link(robot, body)
    away: np.ndarray = model.body_ipos[body] - model.jnt_pos[joint]
    if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_HINGE):
        away = away - (away @ model.jnt_axis[joint]) * model.jnt_axis[joint]
    return away


def outward(robot: Robot, body: int) -> np.ndarray:
    """Unit vector from a link's joint towards its centre of mass, (3,), in the link's axes.

    Where the centre lies on the axis, it is the one of the link's axes that is nearest to square to the joint's.
    """
    away = arm_of_centre(robot, body)
    length = float(np.linalg.norm(away))
    if length >= LEAST_ARM_M:
        return away / length
    axis = robot.model.jnt_axis[joint_of_link(robot, body)]
    square: np.ndarray = np.eye(3)[int(np.abs(axis).argmin())]
    square = square - (square @ axis) * axis
    return np.asarray(square / np.linalg.norm(square))


def move_centre(model: mujoco.MjModel, body: int, by: np.ndarray) -> None:
    """Move a body's inertial frame by (3,) m in the body's axes, its geoms staying where they are."""
    model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)  # a short cut where frames coincide
    model.geom_sameframe[model.geom_bodyid == body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
    model.body_ipos[body] += by
