from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.errors import InputError
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.pair_force import per_pair
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION
from leapgap.robot.kinematics import feet_in_world, joint_torque_to_foot_force
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box
from tests.conftest import CROUCH


def test_mass_and_pitch_inertia_are_the_stated_ones(robot: Robot) -> None:
    assert robot.total_mass == pytest.approx(12.453, abs=1e-9)
    data = mujoco.MjData(robot.model)
    mujoco.mj_resetDataKeyframe(robot.model, data, 0)
    mujoco.mj_forward(robot.model, data)
    mass = np.zeros((robot.model.nv, robot.model.nv))
    mujoco.mj_fullM(robot.model, data, mass)
    arm = data.subtree_com[1] - data.qpos[:3]
    assert mass[4, 4] - robot.total_mass * (arm[0] ** 2 + arm[2] ** 2) == pytest.approx(0.347, abs=5e-4)


def test_names_and_order_are_the_contract(robot: Robot) -> None:
    assert robot.name == "a1"
    assert robot.feet == ("FR", "FL", "RR", "RL")
    assert robot.joints[:4] == ("FR_hip", "FR_thigh", "FR_calf", "FL_hip")
    assert robot.model.body(1).name == "trunk"
    assert robot.has_free_base


def test_left_mirrors_right(robot: Robot) -> None:
    feet = feet_in_world(robot, np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.array([CROUCH * 4]))[0]
    assert feet[0] * [1, -1, 1] == pytest.approx(feet[1])
    assert feet[2] * [1, -1, 1] == pytest.approx(feet[3])
    assert feet[0, 0] - feet[2, 0] == pytest.approx(2 * 0.183)


@pytest.mark.parametrize(
    ("location", "joints"),
    [
        ("all", range(12)),
        ("front", range(6)),
        ("rear", range(6, 12)),
        ("calf", (2, 5, 8, 11)),
        ("RR", (6, 7, 8)),
        ("RR_calf", (8,)),
    ],
)
def test_locations_of_joints(robot: Robot, location: str, joints: range) -> None:
    assert robot.joints_at(location).tolist() == list(joints)


def test_unknown_location_lists_the_known(robot: Robot) -> None:
    with pytest.raises(InputError, match="found XX; expected one of all, front, rear, hip"):
        robot.joints_at("XX")
    assert robot.feet_at("rear").tolist() == [2, 3]


def test_joint_torques_stand_for_the_forces_that_cause_them(robot: Robot) -> None:
    """τ = −Jᵀ Rᵀ u is inverted: against MuJoCo's generalised force of a point force on the foot."""
    angles = np.array([CROUCH * 4]) + 0.1 * np.random.default_rng(0).standard_normal((1, 12))
    quaternion = np.array([[np.cos(0.1), 0, np.sin(0.1), 0]])
    on_robot = np.array([3.0, -5.0, 40.0])
    data = mujoco.MjData(robot.model)
    data.qpos[3:7], data.qpos[7:] = quaternion[0], angles[0]
    mujoco.mj_forward(robot.model, data)
    generalised = np.zeros(robot.model.nv)
    foot = robot.foot_geoms[3]
    mujoco.mj_applyFT(
        robot.model, data, on_robot, np.zeros(3), data.geom_xpos[foot], robot.model.geom_bodyid[foot], generalised
    )
    force = joint_torque_to_foot_force(robot, quaternion, angles, -generalised[None, robot.joint_dofs])
    assert force[0, 3] == pytest.approx(on_robot)
    assert np.abs(force[0, :3]).max() < 1e-9
    assert per_pair(robot, force)[0] == pytest.approx([0, 0, 3, 40])


def test_terrain_of_different_jumps_has_one_size(robot: Robot) -> None:
    bare, box = robot.on_terrain((), slots=2), robot.on_terrain((Box(0.2, 0.0, (0.2, 0.5, 0.03), 0.03),), slots=2)
    assert bare.ngeom == box.ngeom
    top = box.geom("terrain_0")
    assert top.pos[2] + top.size[2] == pytest.approx(0.03)


def test_a_foot_deep_in_a_thin_block_is_pushed_up(robot: Robot) -> None:
    """Past the middle of a box that ends at the floor it would be pushed out of the underside, and held there."""
    model = robot.on_terrain((Box(0.18, 0.0, (0.24, 0.6, 0.03), 0.03),))
    data = mujoco.MjData(model)
    data.qpos[:7] = 0, 0, 0.17, 1, 0, 0, 0
    data.qpos[robot.joint_qpos] = CROUCH * 4
    mujoco.mj_forward(model, data)
    foot = model.geom(robot.feet[0]).id
    data.qpos[2] -= data.geom_xpos[foot][2] - 0.012  # its centre, 3 mm below the middle
    mujoco.mj_forward(model, data)
    block = model.geom("terrain_0").id
    normals = [c.frame[:3] * (1 if c.geom2 == foot else -1) for c in data.contact if {foot, block} == set(c.geom)]
    assert len(normals) == 1
    assert normals[0] == pytest.approx([0, 0, 1])


def test_models_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        Robot.load(tmp_path / "none.xml")
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    with pytest.raises(InputError, match="no valid MuJoCo model"):
        Robot.load(tmp_path / "broken.xml")
    (tmp_path / "idle.xml").write_text(
        "<mujoco><worldbody><body><joint name='a_b'/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InputError, match="no actuator at a_b"):
        Robot.load(tmp_path / "idle.xml")


def test_a_free_body_without_motors_loads_and_has_no_effects_of_joints(tmp_path: Path) -> None:
    """Its log needs a pose alone; that of a robot without commands, or without the base's place, is refused."""
    floor = "<geom type='plane' size='0 0 1'/>"
    path = tmp_path / "ball.xml"
    path.write_text(
        f"<mujoco><worldbody>{floor}<body><freejoint/><geom name='ball' size='0.1'/></body></worldbody></mujoco>"
    )
    ball = Robot.load(path)
    assert (ball.joints, ball.feet, ball.is_free_body) == ((), ("ball",), True)
    there = {name for name, kind in effects.known().items() if kind.lacks(ball) is None}
    assert {"foot_friction", "payload"} <= there
    assert not there & {"joint_friction", "armature", "motor_lag", "command_delay", "position_gain", "leg_mass"}
    pose = dict.fromkeys((*BASE_POSITION, *BASE_QUATERNION), np.full(3, 0.5))
    info = LogInfo("ball", 0.01, "by hand")
    log = Log("toss", {"time": np.arange(3.0), **pose}, info)
    assert log.joints == () and log.per_joint("joint_pos", ball.joints).shape == (3, 0)
    for columns in ({}, {**pose, "joint_pos/hinge": np.ones(3)}):
        with pytest.raises(InputError, match="no column cmd_tau"):
            Log("toss", {"time": np.arange(3.0), **columns}, info)


def test_a_phase_holds_its_first_instant_and_not_its_last() -> None:
    schedule = ContactSchedule()
    planned = schedule.in_contact(np.array([0.0, 0.499, 8 * 0.0625, 0.799, 8 * 0.1, 1.0]))
    assert planned.tolist() == [
        [True, True],
        [True, True],
        [False, True],
        [False, True],
        [False, False],
        [False, False],
    ]
    assert schedule.landing_s == pytest.approx(1.2)
