"""Ground forces on the pairs of feet that are equivalent to the torques of the joint PD; paper, data collection."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.jumping.task import of_latest_jump, schedule_of
from leapgap.logs.log import Log
from leapgap.logs.pair_force import per_axis, per_pair
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.logs.state import motion_of, pd_torques
from leapgap.robot.kinematics import joint_torque_to_foot_force
from leapgap.robot.model import Robot

MOST_N = 1e4
"""A foot's force that is larger is none: the leg's Jacobian is singular, as where the foot is as high as the hip."""


def with_pd_force(jump: Log, robot: Robot, begins_s: Sequence[float]) -> Log:
    """The log with u_pd = −(Jᵀ Rᵀ)⁻¹ τ_pd of each pair as columns ``pd_force``, N on the robot.

    It is zero where the schedule has the pair in the air; jumps begin at ``begins_s``. A foot counts for nothing where
    no force at it can stand for the torques of its leg, as may be once a robot has fallen.
    """
    motion = motion_of(jump, robot)
    joint_pos = motion.qpos[:, robot.joint_qpos]
    spring, damper = pd_torques(jump, robot.joints, joint_pos, motion.qvel[:, robot.joint_dofs])
    of_feet = joint_torque_to_foot_force(robot, motion.base_quaternion, joint_pos, spring + damper)
    planned = schedule_of(jump).in_contact(of_latest_jump(jump.time, begins_s))
    stands_for = np.abs(of_feet).max(axis=2) < MOST_N
    force = per_pair(robot, np.where(stands_for[..., None], of_feet, 0.0)) * per_axis(planned)
    columns = {f"pd_force/{axis}": force[:, i].copy() for i, axis in enumerate(PAIR_FORCE_AXES)}
    return replace(jump, columns=dict(jump.columns) | columns)
