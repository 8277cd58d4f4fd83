"""Forward kinematics of motions against MuJoCo row by row, and momenta against conservation."""

import mujoco
import numpy as np
import pytest

from leapgap.robot.kinematics import centre_of_mass, configurations, feet_positions, momenta
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion


def drawn_configurations(robot: Robot, rows: int) -> np.ndarray:
    rng = np.random.default_rng(2)
    turn = rng.normal(size=(rows, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return configurations(robot, rng.uniform(-1, 1, (rows, len(robot.joints))), rng.normal(size=(rows, 3)), turn)


def test_feet_and_centre_of_mass_are_mujocos(robot: Robot) -> None:
    qpos = drawn_configurations(robot, 5)
    feet, centre = feet_positions(robot, qpos), centre_of_mass(robot, qpos)
    data = mujoco.MjData(robot.model)
    for row in range(5):
        data.qpos[:] = qpos[row]
        mujoco.mj_forward(robot.model, data)
        for foot, name in enumerate(robot.feet):
            assert feet[row, foot] == pytest.approx(data.geom(name).xpos)
        masses = robot.model.body_mass[:, None]
        assert centre[row] == pytest.approx((masses * data.xipos).sum(axis=0) / masses.sum())


def test_momentum_is_conserved_in_free_flight(robot: Robot) -> None:
    """Plain steps of MuJoCo high above the floor: angular momentum stays, linear momentum gains m g t."""
    model = robot.on_terrain(())
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    data.qpos[:] = configurations(robot, np.full((1, 12), 0.3), np.array([[0, 0, 5.0]]), np.array([[1.0, 0, 0, 0]]))[0]
    data.qvel[:] = np.random.default_rng(3).normal(size=model.nv)
    qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
    for _ in range(500):
        mujoco.mj_step(model, data)
        qpos.append(data.qpos.copy())
        qvel.append(data.qvel.copy())
    linear, angular = momenta(robot, Motion(np.array(qpos), np.array(qvel)))
    assert np.abs(angular - angular[0]).max() < 2e-3 * np.abs(angular[0]).max()
    fallen = robot.total_mass * 9.81 * 1e-4 * np.arange(501)
    assert linear[:, 2] - linear[0, 2] == pytest.approx(-fallen, abs=2e-3 * fallen[-1])
    assert np.abs(linear[:, :2] - linear[0, :2]).max() < 1e-3 * robot.total_mass


def test_configurations_keep_what_is_not_given(robot: Robot) -> None:
    (qpos,) = configurations(robot, np.array([[0.5]]), joints=["FL_calf"])
    rest = robot.model.key_qpos[0] if robot.model.nkey else robot.model.qpos0
    changed = np.flatnonzero(qpos != rest)
    assert list(changed) == [robot.joint_qpos[robot.joints.index("FL_calf")]]
