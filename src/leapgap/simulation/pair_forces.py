"""Ground forces on pairs of feet that are equivalent to joint PD torques."""

import numpy as np

from leapgap.logs.pair_force import per_axis, per_pair
from leapgap.logs.segments import ContactSchedule
from leapgap.robot.kinematics import joint_torque_to_foot_force
from leapgap.robot.model import Robot


def pd_pair_force(
    robot: Robot,
    schedule: ContactSchedule,
    time_s: np.ndarray,
    base_quaternion: np.ndarray,
    joint_pos: np.ndarray,
    torque: np.ndarray,
) -> np.ndarray:
    """u_pd = −(Jᵀ Rᵀ)⁻¹ τ_pd of each pair, front x z, rear x z, N on the robot, (rows, 4); paper, data collection.

    ``torque`` (rows, joints) is the torque of the joint PD, N·m. Zero where the schedule has the pair in the air.
    """
    force = per_pair(robot, joint_torque_to_foot_force(robot, base_quaternion, joint_pos, torque))
    return force * per_axis(schedule.in_contact(time_s))
