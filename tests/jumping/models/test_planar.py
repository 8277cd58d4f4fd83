"""The planar robot read from a MuJoCo model, against MuJoCo's own sums."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.models.planar import A1_JOINTS, PlanarRobot, planar_robot
from leapgap.jumping.planning.dynamics import CROUCH, legs
from leapgap.jumping.planning.problem import Problem
from leapgap.jumping.planning.reference import to_jump
from leapgap.jumping.planning.solve import solve
from leapgap.jumping.task import Target
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION
from leapgap.robot.kinematics import feet_in_world
from leapgap.robot.model import DEFAULT_MODEL, Robot
from tests.jumping.planning.centre_of_mass import centre_of_mass
from tests.robot.quadrupeds import FIGURES, write


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


@pytest.mark.parametrize("name", FIGURES)
def test_another_quadruped_jumps_without_a_change_of_code(name: str, tmp_path: Path) -> None:
    other = Robot.load(write(FIGURES[name], tmp_path))
    planar = planar_robot(other)
    assert planar.total_mass == pytest.approx(other.total_mass)
    assert other.joint_groups == ("hip", "thigh", "calf")
    solution = solve(Problem(Target(0.4), robot=planar))
    assert solution.solved, solution.status
    assert np.abs(solution.trajectory.torque[:, ::2]).max() <= 2 * FIGURES[name].thigh_torque + 1e-6
    jump = to_jump(solution)
    assert jump.info.robot == name
    positions, quaternions = jump.stack(BASE_POSITION), jump.stack(BASE_QUATERNION)
    feet = feet_in_world(other, positions, quaternions, jump.per_joint("joint_pos", other.joints))
    lowest = feet[..., 2] - other.foot_radius
    assert np.abs(lowest[:490]).max() < 1e-3  # stands on the floor, by the 3-D model's own kinematics
    assert lowest[850:1150].min() > 0.02
    assert lowest[-1] == pytest.approx(0, abs=1e-3)


def test_motors_of_another_quadruped_limit_its_plans(tmp_path: Path) -> None:
    for name in FIGURES:
        planar = planar_robot(Robot.load(write(FIGURES[name], tmp_path)))
        assert planar.torque_limit == (FIGURES[name].thigh_torque, FIGURES[name].calf_torque)


def test_the_torque_speed_limit_is_that_of_the_motors_stated_in_the_file(robot: Robot, tmp_path: Path) -> None:
    """The A1's file states them; a Go2 as published does not, and gets no limit of another robot's motors."""
    text = DEFAULT_MODEL.read_text().replace('data="0.34602"', 'data="0.5"')
    (tmp_path / "strong.xml").write_text(text)
    assert (planar_robot(robot).speed_per_torque, planar_robot(robot).no_load_speed) == (0.34602, 21.5)
    assert planar_robot(Robot.load(tmp_path / "strong.xml")).speed_per_torque == 0.5
    go2 = planar_robot(Robot.load(write(FIGURES["go2"], tmp_path)))
    assert (go2.speed_per_torque, go2.no_load_speed) == (0.0, np.inf)


def test_a_robot_without_four_legs_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        "<mujoco><worldbody><body><joint name='a'/><geom size='1'/></body></worldbody>"
        "<actuator><motor joint='a'/></actuator></mujoco>"
    )
    with pytest.raises(InputError, match="found no free base"):
        planar_robot(Robot.load(tmp_path / "arm.xml"))
