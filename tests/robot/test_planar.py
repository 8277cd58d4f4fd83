"""The planar robot read from a MuJoCo model, against MuJoCo's own sums."""

import mujoco
import numpy as np
import pytest

from leapgap.planning.dynamics import centre_of_mass, legs
from leapgap.planning.layout import CROUCH
from leapgap.robot.model import Robot
from leapgap.robot.planar import A1_JOINTS, PlanarRobot, planar_robot


def pose(robot: Robot, planar: PlanarRobot, q: np.ndarray) -> mujoco.MjData:
    """The 3-D robot in a planar pose."""
    data = mujoco.MjData(robot.model)
    data.qpos[:7] = [q[0], 0, q[1], np.cos(q[2] / 2), 0, np.sin(q[2] / 2), 0]
    data.qpos[robot.joint_qpos] = 0
    for leg in planar.joints:
        at = 3 if leg.pair == "front" else 5
        for i, joint in enumerate(leg.pitch):
            data.joint(joint).qpos = leg.sign[i] * q[at + i] + leg.offset[i]
    mujoco.mj_forward(robot.model, data)
    return data


def test_the_a1s_joints_count_as_published(robot: Robot) -> None:
    assert set(planar_robot(robot).joints) == set(A1_JOINTS)


def test_mass_feet_centre_and_inertia_are_mujocos_in_any_pose(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    planar = planar_robot(robot)
    assert planar.total_mass == pytest.approx(robot.total_mass)
    for _ in range(5):
        q = np.array([*rng.normal(size=3), *CROUCH + 0.3 * rng.normal(size=4)])
        data = pose(robot, planar, q)
        assert centre_of_mass(planar, q) == pytest.approx(data.subtree_com[1, [0, 2]], abs=2e-4)  # hips swing with none
        for leg, pair in zip(legs(planar, q), ("front", "rear"), strict=True):
            feet = [data.geom(foot).xpos[[0, 2]] for foot in robot.feet_of_pair(pair)]
            for foot in feet:
                assert [float(leg.foot.x), float(leg.foot.z)] == pytest.approx(foot, abs=1e-9)


def test_armature_and_damping_are_those_of_two_joints(robot: Robot) -> None:
    planar = planar_robot(robot)
    assert (planar.armature, planar.damping) == pytest.approx((0.02, 0.02))
