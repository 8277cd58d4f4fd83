"""Links that joints move: their masses, and where their centres lie seen from the joint."""

from collections.abc import Sequence

import mujoco
import numpy as np

from leapgap.effects.base import ForceContext
from leapgap.robot.model import Robot

LEAST_ARM_M = 1e-4
"""A centre of mass nearer to its joint's axis than this has no direction away from it."""
LEAST_INERTIA = 0.1
"""Share of a link's smallest inertia that always stays."""
MARGIN = 1e-3
"""By how much the inertias of a body are within what bodies can have, so that a file with rounded numbers is, too."""


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


def along(robot: Robot, body: int) -> np.ndarray:
    """Unit vector from a link's joint through its centre of mass, (3,), in the link's axes; else the joint's axis."""
    joint = joint_of_link(robot, body)
    away: np.ndarray = robot.model.body_ipos[body] - robot.model.jnt_pos[joint]
    length = float(np.linalg.norm(away))
    return away / length if length >= LEAST_ARM_M else np.asarray(robot.model.jnt_axis[joint])


def jacobians(at: ForceContext, bodies: Sequence[int]) -> np.ndarray:
    """How the centres of mass of bodies move with the robot at each step, (steps, bodies, 3, nv), world axes."""
    model, found = at.model, np.empty((len(at.qpos), len(bodies), 3, at.model.nv))
    data = mujoco.MjData(model)
    for qpos, of_step in zip(at.qpos, found, strict=True):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for body, of_body in zip(bodies, of_step, strict=True):
            mujoco.mj_jacBodyCom(model, data, of_body, None, body)
    return found


def add_mass(model: mujoco.MjModel, body: int, mass: float, moment: np.ndarray, inertia: np.ndarray) -> None:
    """Add mass to a body: kg, its first moment, kg·m, (3,), and its inertia, kg·m², (3, 3), about the body's centre.

    Axes are those of the body. Where more is taken away than a body can lose, its smallest inertia stays a tenth of its
    own and as large as the difference of the other two: no body, and no model file, has less.
    """
    whole = float(model.body_mass[body]) + mass
    model.body_mass[body] = whole
    if not (moment.any() or inertia.any()):
        return
    shift, axes = moment / whole, np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    turn = axes.reshape(3, 3)
    about_centre = turn @ np.diag(model.body_inertia[body]) @ turn.T + inertia - whole * square_to(shift)
    values, vectors = np.linalg.eigh(about_centre)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    values = np.maximum(values, LEAST_INERTIA * model.body_inertia[body].min())
    if values[0] + values[1] < values[2]:
        values[0] = (values[2] - values[1]) * (1 + MARGIN)
    model.body_inertia[body] = values
    mujoco.mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(vectors).ravel())
    move_centre(model, body, shift)


def square_to(away: np.ndarray) -> np.ndarray:
    """Inertia of one kilogram at a place (3,), m, seen from the origin, m², (3, 3)."""
    return np.asarray(away @ away * np.eye(3) - np.outer(away, away))


def move_centre(model: mujoco.MjModel, body: int, by: np.ndarray) -> None:
    """Move a body's inertial frame by (3,) m in the body's axes, its geoms staying where they are."""
    model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)  # a short cut where frames coincide
    model.geom_sameframe[model.geom_bodyid == body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
    model.body_ipos[body] += by
