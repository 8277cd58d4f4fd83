import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.conftest import standing


def moving(robot: Robot, rows: int = 200, kp: float = 300.0) -> Log:
    """Standing, with commands that move every joint its own way."""
    jump = standing(robot, rows, kp=kp)
    wave = {
        f"cmd_pos/{joint}": jump[f"cmd_pos/{joint}"] + 0.05 * np.sin(np.arange(rows) / 20 + i)
        for i, joint in enumerate(robot.joints)
    }
    push = {f"cmd_tau/{joint}": np.full(rows, 2.0 - i) for i, joint in enumerate(robot.joints)}
    return standing(robot, rows, kp=kp, **wave, **push)


def python_loop(robot: Robot, replayer: Replayer, jump: Log) -> tuple[np.ndarray, np.ndarray]:
    """The same by plain steps, checking each tick's torque against the law of the log's contract."""
    model = replayer.model(Rollout(jump))
    data = mujoco.MjData(model)
    state = replayer.first_state(Rollout(jump))
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    positions = [data.qpos.copy()]
    worst = []
    tau, pos, vel, kp, kd = (jump.per_joint(q) for q in ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"))
    for row in range(len(jump) - 1):
        model.actuator_biasprm[robot.joint_actuators, 1] = -kp[row]
        model.actuator_biasprm[robot.joint_actuators, 2] = -kd[row]
        data.ctrl[robot.joint_actuators] = tau[row] + kp[row] * pos[row] + kd[row] * vel[row]
        q, v = data.qpos[robot.joint_qpos].copy(), data.qvel[robot.joint_dofs].copy()
        law = np.clip(tau[row] + kp[row] * (pos[row] - q) + kd[row] * (vel[row] - v), -33.5, 33.5)
        mujoco.mj_step(model, data)
        worst.append(np.abs(data.actuator_force[robot.joint_actuators] - law).max())
        positions.append(data.qpos.copy())
    return np.array(positions), np.array(worst)


def test_replay_is_the_plain_loop_and_its_torque_the_commanded_law(robot: Robot) -> None:
    jump, replayer = moving(robot), Replayer(robot)
    (motion,) = replayer.motions([Rollout(jump)])
    positions, torque_errors = python_loop(robot, replayer, jump)
    assert np.array_equal(motion.qpos, positions)
    assert torque_errors.max() < 1e-9


def test_gains_that_change_on_the_way_act_from_their_row(robot: Robot) -> None:
    rows = 120
    kp = {f"cmd_kp/{joint}": np.where(np.arange(rows) < 60, 300.0, 40.0) for joint in robot.joints[:6]}
    base = moving(robot, rows)
    jump = Log(base.name, dict(base.columns) | kp, base.info)
    replayer = Replayer(robot)
    (motion,) = replayer.motions([Rollout(jump)])
    # Not to the bit: the contact solver starts cold where the gains change.
    assert np.abs(motion.qpos - python_loop(robot, replayer, jump)[0]).max() < 1e-6


def test_alone_in_company_and_at_any_number_of_threads_bits_are_equal(robot: Robot, reference: Log) -> None:
    from leapgap.simulation.open_loop import Course, MotionPlan, with_block

    block = with_block(reference, MotionPlan("b", reference, 0.03), robot, Course())
    trials = [Rollout(reference), Rollout(block), Rollout(reference, (effects.effect("payload", mass_kg=1.0),))] * 3
    together = Replayer(robot, terrain_slots=1, threads=2).motions(trials)
    for trial, motion in zip(trials[:3], together[:3], strict=True):
        (alone,) = Replayer(robot, terrain_slots=1, threads=1).motions([trial])
        assert np.array_equal(alone.qpos, motion.qpos)
        assert np.array_equal(alone.qvel, motion.qvel)
    assert not np.array_equal(together[0].qpos, together[1].qpos)


def test_gains_that_change_at_other_rows_and_threads_change_no_bit(robot: Robot) -> None:
    rows = 90
    logs = []
    for change in (30, 50, 70):
        kp = {f"cmd_kp/{joint}": np.where(np.arange(rows) < change, 300.0, 90.0) for joint in robot.joints}
        base = moving(robot, rows, kp=300.0)
        logs.append(Log(f"change_{change}", dict(base.columns) | kp, base.info))
    alone, several = (Replayer(robot, threads=threads).motions([Rollout(log) for log in logs]) for threads in (1, 3))
    for one, other in zip(alone, several, strict=True):
        assert np.array_equal(one.qpos, other.qpos) and np.array_equal(one.qvel, other.qvel)


def test_in_the_air_the_centre_of_mass_falls_and_angular_momentum_stays(robot: Robot) -> None:
    """Joint torques are internal: whatever they do, gravity alone moves the whole."""
    jump = moving(robot, 200)
    air = Log(jump.name, dict(jump.columns) | {"base_pos_z": np.full(200, 2.0)}, jump.info)
    replayer = Replayer(robot)
    (motion,) = replayer.motions([Rollout(air)])
    model = replayer.model(Rollout(air))
    data = mujoco.MjData(model)
    centre, momentum = [], []
    for q, v in zip(motion.qpos, motion.qvel, strict=True):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        centre.append(data.subtree_com[1].copy())
        momentum.append(data.subtree_angmom[1].copy())
    time = np.arange(200) / 1000
    fall = np.array(centre)[:, 2] - centre[0][2]
    assert fall == pytest.approx(-9.81 * time * (time + 0.001) / 2, abs=2e-4)
    assert np.abs(np.array(centre)[:, :2] - centre[0][:2]).max() < 2e-4
    assert np.abs(np.array(momentum) - momentum[0]).max() < 2e-3  # of legs that swing with 0.3 kg·m²/s


def test_a_standing_robot_stands(robot: Robot) -> None:
    (motion,) = Replayer(robot).motions([Rollout(standing(robot, 1000, kp=300.0))])
    assert abs(motion.qpos[-1, 2] - 0.1726) < 0.02
    assert np.abs(motion.qvel[-1]).max() < 0.02


def test_a_log_of_another_robot_is_refused_by_its_joints(robot: Robot) -> None:
    jump = standing(robot, 10)
    renamed = {name.replace("RL_calf", "RL_knee"): values for name, values in jump.columns.items()}
    with pytest.raises(InputError, match="joints RL_knee and no RL_calf"):
        Replayer(robot).motions([Rollout(Log("other", renamed, jump.info))])
