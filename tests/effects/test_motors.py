"""Effects at the motors against their laws."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.log import Log
from leapgap.robot.actuators import MotorConstants
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.conftest import standing

DISC = """<mujoco model="disc"><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
  <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/><joint name="j" axis="0 0 1"/></body></worldbody>
  <actuator><general joint="j" biastype="affine" forcerange="-33.5 33.5"/></actuator></mujoco>"""


def in_the_air(jump: Log) -> Log:
    return replace(jump, columns=dict(jump.columns) | {"base_pos_z": jump["base_pos_z"] + 2.0})


def random_forces(robot: Robot, jump: Log, *found: effects.Effect) -> tuple[np.ndarray, ...]:
    """Commanded torque (by the joint PD's formula), joint velocity and delivered torque, at many random states."""
    replayer = Replayer(robot)
    trial = Rollout(jump, found)
    model = replayer.model(trial)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    control = replayer._controls(trial, 2)[0]
    kp, kd = (jump.per_joint(gain)[0] for gain in ("cmd_kp", "cmd_kd"))
    asked, speed, delivered = [], [], []
    for _ in range(500):
        q = jump.per_joint("joint_pos")[0] + rng.uniform(-0.1, 0.1, 12)
        v = rng.uniform(-30, 30, 12)
        push = rng.uniform(-150, 150, 12)
        data.qpos[robot.joint_qpos], data.qvel[robot.joint_dofs] = q, v
        data.ctrl[:] = control
        gain = replayer.drive(trial).control_gain
        data.ctrl[robot.joint_actuators] += push * gain
        mujoco.mj_forward(model, data)
        asked.append(push + kp * (jump.per_joint("cmd_pos")[0] - q) + kd * (jump.per_joint("cmd_vel")[0] - v))
        speed.append(v)
        delivered.append(data.actuator_force[robot.joint_actuators].copy())
    return np.array(asked), np.array(speed), np.array(delivered)


def test_torque_and_speed_stay_within_the_law(robot: Robot) -> None:
    """What is asked is delivered wherever |0.34602 τ + q̇| ≤ 21.5 and |τ| ≤ 33.5; elsewhere the nearest torque is."""
    asked, speed, delivered = random_forces(
        robot, standing(robot, 10), effects.effect("torque_speed_limit", voltage_v=21.5)
    )
    low, high = (-21.5 - speed) / 0.34602, (21.5 - speed) / 0.34602
    assert delivered == pytest.approx(np.clip(np.clip(asked, low, high), -33.5, 33.5), abs=1e-9)
    assert (asked > high).mean() > 0.1 and (asked < low).mean() > 0.1
    within = (np.abs(0.34602 * asked + speed) <= 21.5) & (np.abs(asked) <= 33.5)
    assert within.mean() > 0.1
    assert delivered[within] == pytest.approx(asked[within])


def test_the_law_has_the_published_corner(robot: Robot) -> None:
    """Full torque to 9.91 rad/s, none at 21.5 rad/s."""
    _, speed, delivered = random_forces(
        robot, standing(robot, 10, kp=3000.0, kd=0.0), effects.effect("torque_speed_limit", voltage_v=21.5)
    )
    slow = np.abs(speed) < 9.9
    assert np.abs(delivered[slow]).max() == pytest.approx(33.5)
    fast = speed > 21.5
    assert delivered[fast].max() <= 0


def test_a_weak_motor_with_a_voltage_limit_delivers_its_share_within_the_law(robot: Robot) -> None:
    found = (effects.effect("torque_gain", scale=0.5), effects.effect("torque_speed_limit", voltage_v=16.0))
    asked, speed, delivered = random_forces(robot, standing(robot, 10), *found)
    law = np.clip(0.5 * asked, (-16 - speed) / 0.34602, (16 - speed) / 0.34602)
    assert delivered == pytest.approx(np.clip(law, -0.5 * 33.5, 0.5 * 33.5), abs=1e-9)


def test_a_motor_with_voltage_to_spare_moves_as_the_nominal_one(robot: Robot, reference: Log) -> None:
    """The DC motor and the affine actuator are two ways to the same joint PD, implicit damping included."""
    jump = reference.first_rows(500)
    ample = effects.effect("torque_speed_limit", voltage_v=32.9)
    bare, same = Replayer(robot).motions([Rollout(jump), Rollout(jump, (ample,))])
    assert np.abs(bare.qpos - same.qpos).max() < 1e-9


def test_voltage_limits_a_free_spin_up(tmp_path: Path) -> None:
    """A joint pushed with constant torque ends at the no-load speed; compared with the law, integrated finely."""
    velocity = spin_up(tmp_path, effects.effect("torque_speed_limit", voltage_v=21.5), rows=300)
    speed, fine = 0.0, []
    for _ in range(299):
        fine.append(speed)
        for _ in range(100):
            speed += 1e-5 * min(33.5, (21.5 - speed) / 0.34602) / 0.05
    assert velocity[:299] == pytest.approx(np.array(fine), abs=0.15)
    assert velocity[-1] == pytest.approx(21.5, abs=0.01)


def test_motor_lag_is_a_first_order_step_response(tmp_path: Path) -> None:
    """A disc driven from rest by a step of torque T: ω = (T/I)(t − τ + τ e^{−t/τ})."""
    for lag in (0.002, 0.005, 0.010):
        velocity = spin_up(tmp_path, effects.effect("motor_lag", time_constant_s=lag), rows=60, torque=10.0, first=0.0)
        time = (np.arange(60) - 1).clip(0) * 0.001  # the step of torque comes with row 1
        exact = 10 / 0.05 * (time - lag + lag * np.exp(-time / lag))
        assert velocity == pytest.approx(exact, abs=10 / 0.05 * 0.001)
        delayed = np.interp(exact[-1], velocity, np.arange(60)) - 59
        assert abs(delayed) < 0.6  # rows


def spin_up(
    folder: Path, found: effects.Effect, rows: int, torque: float = 100.0, first: float | None = None
) -> np.ndarray:
    """Velocity of a disc under a constant torque command (``first`` on its first row), by the replay itself."""
    (folder / "disc.xml").write_text(DISC)
    disc = Robot.load(folder / "disc.xml", MotorConstants(resistance=0.34602, top_speed_rad_s=21.0))
    command = np.full(rows, torque)
    command[0] = torque if first is None else first
    still = {f"{q}/j": np.zeros(rows) for q in ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}
    info = jump_info("disc", 0.001, ContactSchedule(), Target(0.0), "made for a test")
    jump = Log("disc", {"time": np.arange(rows) / 1000, "cmd_tau/j": command} | still, info)
    (motion,) = Replayer(disc).motions([Rollout(jump, (found,))])
    return motion.qvel[:, 0]


def test_a_standing_robot_with_lagging_motors_stands_from_its_first_row(robot: Robot) -> None:
    """Its motors start with the torque they are asked for, so nothing sags."""
    jump = standing(robot, 800)
    (settled,) = Replayer(robot).motions([Rollout(jump)])
    start = np.concatenate([settled.qpos[-1], settled.qvel[-1]])
    (motion,) = Replayer(robot).motions(
        [Rollout(jump, (effects.effect("motor_lag", time_constant_s=0.005),), first_state=start)]
    )
    assert np.abs(motion.qpos - start[:19]).max() < 1e-3


def test_command_delay_shifts_whole_rows_and_keeps_the_impulse_of_parts(robot: Robot) -> None:
    rows = 60
    rng = np.random.default_rng(2)
    jump = standing(robot, rows, **{f"cmd_tau/{j}": rng.standard_normal(rows) for j in robot.joints})
    sent = Replayer(robot)._controls(Rollout(jump), rows)
    for delay in (0.003, 0.0045):
        late = Replayer(robot)._controls(Rollout(jump, (effects.effect("command_delay", delay_s=delay),)), rows)
        fine = np.repeat(sent, 10, axis=0)  # ten parts a row: a zero-order hold shifted by tenths of a row
        shift = round(delay * 10_000)
        exact = np.concatenate([np.repeat(fine[:1], shift, axis=0), fine])[: 10 * rows].reshape(rows, 10, -1)
        assert late == pytest.approx(exact.mean(axis=1))
    slow = (effects.effect("sample_period", scale=1.2), effects.effect("command_delay", delay_s=0.0036))
    assert Replayer(robot)._controls(Rollout(jump, slow), rows)[10:] == pytest.approx(sent[7:-3])


def test_a_biased_encoder_lets_the_joints_settle_off_by_its_bias(robot: Robot) -> None:
    """In the air, without gravity's help: reported angles reach the set points, the true ones miss by the bias."""
    jump = in_the_air(standing(robot, 500))
    bias = effects.effect("encoder_bias", location="front", bias_rad=0.03)
    replayer, trial = Replayer(robot), Rollout(jump, (bias,))
    (true,), (reported,) = replayer.true_motions([trial]), replayer.motions([trial])
    expected = np.where(np.arange(12) < 6, 0.03, 0.0)
    wanted = jump.per_joint("cmd_pos")[0]
    assert (reported.qpos - true.qpos)[:, robot.joint_qpos] == pytest.approx(np.tile(expected, (500, 1)))
    assert reported.qpos[0, robot.joint_qpos] == pytest.approx(wanted)
    assert reported.qpos[-1, robot.joint_qpos] == pytest.approx(wanted, abs=1e-3)
    assert np.array_equal(reported.qpos[:, :7], true.qpos[:, :7])


def test_state_latency_reports_the_base_of_before_and_the_joints_of_now(robot: Robot, reference: Log) -> None:
    replayer, jump = Replayer(robot), reference.first_rows(900)
    late = effects.effect("state_latency", delay_s=0.0155)
    (true,), (reported,) = replayer.true_motions([Rollout(jump, (late,))]), replayer.motions([Rollout(jump, (late,))])
    middle = (true.qpos[100:800] + true.qpos[101:801]) / 2  # 15.5 rows ago
    assert reported.qpos[116:816, :3] == pytest.approx(middle[:, :3], abs=1e-12)
    assert reported.qvel[116:816, :6] == pytest.approx((true.qvel[100:800] + true.qvel[101:801])[:, :6] / 2)
    assert np.array_equal(reported.qpos[:, 7:], true.qpos[:, 7:])
    assert np.linalg.norm(reported.qpos[:, 3:7], axis=1) == pytest.approx(1)


def test_a_replay_starts_from_the_state_that_was_reported(robot: Robot, reference: Log) -> None:
    """Latency and bias are taken off the first row, and put on again in what the replay reports."""
    moving = {"base_linvel_x": 1.0, "base_linvel_z": 1.5, "base_angvel_y": 0.8}
    columns = dict(reference.columns) | {k: np.full(len(reference), v) for k, v in moving.items()}
    jump = in_the_air(Log("moving", columns, reference.info)).first_rows(50)
    found = (effects.effect("state_latency", delay_s=0.015), effects.effect("encoder_bias", bias_rad=0.05))
    replayer = Replayer(robot)
    true, reported = replayer.true_motions([Rollout(jump, found)])[0], replayer.motions([Rollout(jump, found)])[0]
    plain = replayer.first_state(Rollout(jump))
    assert reported.qpos[0] == pytest.approx(plain[:19], abs=1e-12)
    assert true.qpos[0, 0] - plain[0] == pytest.approx(0.015)
    assert true.qpos[0, 2] - plain[2] == pytest.approx(0.015 * 1.5)
