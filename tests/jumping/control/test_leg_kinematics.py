"""Feet and torques of the fast kinematics against MuJoCo's own, and a stand that needs nothing else."""

import mujoco
import numpy as np
import pytest

from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.models.rigid_body import RigidBody
from leapgap.robot.kinematics import feet_in_world
from leapgap.robot.model import Robot
from tests.jumping.rigid_motion import acceleration


def random_pose(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    quaternion = np.array([1.0, 0, 0, 0]) + 0.3 * rng.normal(size=4)
    joints = np.tile([0.0, 1.2, -2.2], 4) + 0.2 * rng.normal(size=12)
    return quaternion / np.linalg.norm(quaternion), joints


@pytest.mark.parametrize("seed", range(3))
def test_torques_cancel_what_ground_forces_do_to_the_joints_and_the_base_gets_them(robot: Robot, seed: int) -> None:
    """By virtual work: MuJoCo's generalised forces of pushes at the feet, on joints and base."""
    quaternion, joints = random_pose(seed)
    force = np.random.default_rng(seed).normal(size=(2, 3)) * 80
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[3:7], data.qpos[robot.joint_qpos] = quaternion, joints
    mujoco.mj_forward(model, data)
    total = np.zeros(model.nv)
    for pair, name in enumerate(("front", "rear")):
        for foot in robot.feet_at(name):
            geom = robot.foot_geoms[foot]
            one = np.zeros(model.nv)
            mujoco.mj_applyFT(
                model, data, force[pair] / 2, np.zeros(3), data.geom_xpos[geom], model.geom_bodyid[geom], one
            )
            total += one
    torque = LegKinematics(robot).torque(quaternion, joints, force)
    assert torque == pytest.approx(-total[robot.joint_dofs], abs=1e-9)
    assert total[:3] == pytest.approx(force.sum(axis=0))


def test_offsets_are_those_of_forward_kinematics(robot: Robot) -> None:
    quaternion, joints = random_pose(7)
    legs = LegKinematics(robot)
    expected = feet_in_world(robot, np.zeros((1, 3)), quaternion[None], joints[None])[0]
    assert legs.offsets(quaternion, joints) == pytest.approx(expected)
    front, rear = legs.pair_offsets(quaternion, joints)
    assert front == pytest.approx(expected[robot.feet_at("front")].mean(axis=0))
    assert rear == pytest.approx(expected[robot.feet_at("rear")].mean(axis=0))


def test_pitch_of_the_rigid_body_has_the_sign_of_mujoco(robot: Robot) -> None:
    """One rigid lump pushed at the feet: MuJoCo's accelerations against the planar model's."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.mass, body.inertia, body.explicitinertial = 12.453, [0.347] * 3, True
    model = spec.compile()
    data = mujoco.MjData(model)
    foot, force = np.array([0.2, -0.25, -0.15, -0.3]), np.array([10.0, 90.0, -15.0, 40.0])
    for pair in (slice(0, 2), slice(2, 4)):
        point, push = (np.array([each[pair][0], 0, each[pair][1]]) for each in (foot, force))
        mujoco.mj_forward(model, data)
        mujoco.mj_applyFT(model, data, push, np.zeros(3), point, 1, data.qfrc_applied)
    mujoco.mj_forward(model, data)
    expected = acceleration(RigidBody(12.453, 0.347), foot, force)
    nose_down_first = data.qacc[4]  # about y: from z to x
    assert (data.qacc[0], data.qacc[2], nose_down_first) == pytest.approx(tuple(expected))


def stand_for(robot: Robot, seconds: float, sign: float) -> float:
    """How far the base sinks when nothing but mapped forces holds it, m; joints brake a little, and are not sprung."""
    model, data, legs = robot.model, mujoco.MjData(robot.model), LegKinematics(robot)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    weight = np.array([[0, 0, robot.total_mass * 9.81 / 2]] * 2)
    start = float(data.qpos[2])
    for _ in range(round(seconds / model.opt.timestep)):
        torque = legs.torque(data.qpos[3:7], data.qpos[robot.joint_qpos], sign * weight)
        data.ctrl[robot.joint_actuators] = torque - 3.0 * data.qvel[robot.joint_dofs]
        mujoco.mj_step(model, data)
    return start - float(data.qpos[2])


def test_torques_of_the_weight_hold_the_robot(robot: Robot) -> None:
    assert abs(stand_for(robot, 0.3, +1.0)) < 0.01
    assert stand_for(robot, 0.3, 0.0) > 0.03, "the stand would hold by itself"
    assert stand_for(robot, 0.3, -1.0) > 0.05
