"""The legs as tables of links: followed link by link, feet and joint torques are those of MuJoCo."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.export.leg_chains import LegChains
from leapgap.robot.model import Robot


def followed(
    chains: LegChains, quaternion: np.ndarray, joint_pos: np.ndarray, pair_force: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean foot − base of each pair, (2, 3), and the joint torques −Jᵀ u of pair forces (2, 3)."""
    feet, torque = [], np.zeros(len(joint_pos))
    for foot, (first, last) in enumerate(zip(chains.links_of_foot[:-1], chains.links_of_foot[1:], strict=True)):
        place, turned, joints = np.zeros(3), Rotation.from_quat(quaternion, scalar_first=True), []
        for link in range(first, last):
            place = place + turned.apply(chains.link_position[link])
            turned = turned * Rotation.from_matrix(chains.link_rotation[link].reshape(3, 3))
            if chains.link_joint[link] >= 0:
                anchor, axis = turned.apply(chains.link_anchor[link]), turned.apply(chains.link_axis[link])
                joints.append((chains.link_joint[link], place + anchor, axis))
                angle = joint_pos[chains.link_joint[link]] - chains.link_zero[link]
                turned = turned * Rotation.from_rotvec(angle * chains.link_axis[link])
                place = place + anchor - turned.apply(chains.link_anchor[link])
        feet.append(place + turned.apply(chains.foot_point[foot]))
        force = chains.foot_share[foot] @ pair_force
        for joint, anchor, axis in joints:
            torque[joint] -= axis @ np.cross(feet[-1] - anchor, force)
    return chains.foot_share.T @ np.array(feet), torque


@pytest.mark.parametrize("anchors_m", [0.0, 0.03])
def test_feet_and_torques_are_those_of_mujoco(anchors_m: float) -> None:
    """Also of a robot whose joints do not turn about the origins of their links."""
    robot, rng = Robot.load(), np.random.default_rng(4)
    robot.model.jnt_pos[1:] = anchors_m * rng.normal(size=(12, 3))
    by_mujoco, chains = LegKinematics(robot), LegChains.of(robot)
    for _ in range(10):
        quaternion, joint_pos, force = rng.normal(size=4), rng.normal(size=12), 100 * rng.normal(size=(2, 3))
        quaternion /= np.linalg.norm(quaternion)
        offsets, torque = followed(chains, quaternion, joint_pos, force)
        assert offsets == pytest.approx(by_mujoco.pair_offsets(quaternion, joint_pos), abs=1e-12)
        assert torque == pytest.approx(by_mujoco.torque(quaternion, joint_pos, force), abs=1e-9)
