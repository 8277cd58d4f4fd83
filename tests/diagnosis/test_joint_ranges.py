"""Joints that go beyond the ranges of a model: told, and replayed without stops."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.checks.joint_ranges import JointRanges
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.reach import without_false_stops
from leapgap.reports.diagnosis import Report, diagnose_logs
from leapgap.robot.model import Robot

PENDULUM = """
<mujoco model="pendulum"><option timestep="0.001"/><worldbody><body name="link">
  <joint name="hinge" type="hinge" axis="0 1 0" armature="0.001" damping="{damping}" {range}/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
</body></worldbody><actuator><motor name="hinge" joint="hinge" ctrlrange="-6 6"/></actuator></mujoco>"""
RANGE = 'range="-180 180"'


def tumbles(torques: Sequence[float], seed: int = 3) -> list[Log]:
    """Logs of a pendulum without stops that turns over, by plain ``mj_step``; its damping is 0.05 N·m·s/rad."""
    rng, logs = np.random.default_rng(seed), []
    model = mujoco.MjModel.from_xml_string(PENDULUM.format(damping=0.05, range=""))
    model.opt.timestep = 0.00025
    for number, size in enumerate(torques):
        data, rows = mujoco.MjData(model), []
        for row in range(1500):
            torque = size * np.sin(2 * np.pi * 0.7 * row * 0.002 + number)
            rows.append((0.002 * row, data.qpos[0], data.qvel[0], torque))
            for _ in range(8):
                data.ctrl[0] = torque
                mujoco.mj_step(model, data)
        time, position, velocity, torque = np.array(rows).T
        columns = {
            "time": time,
            "joint_pos/hinge": position + 1e-4 * rng.standard_normal(len(time)),
            "joint_vel/hinge": velocity + 1e-3 * rng.standard_normal(len(time)),
            "cmd_tau/hinge": torque,
            **{f"cmd_{name}/hinge": np.zeros(len(time)) for name in ("pos", "vel", "kp", "kd")},
        }
        logs.append(Log(f"swing_{number}", columns, LogInfo("pendulum", 0.002, "plain MuJoCo")))
    return logs


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    """The pendulum's model with ends at ±π, which the logs go beyond, and no damping."""
    (tmp_path / "pendulum.xml").write_text(PENDULUM.format(damping=0.0, range=RANGE))
    return Robot.load(tmp_path / "pendulum.xml")


def test_a_range_that_logs_leave_has_no_stops_and_is_told(robot: Robot) -> None:
    logs = tumbles([4.0, 0.5])
    assert np.abs(logs[0]["joint_pos/hinge"]).max() > 4 > 2 > np.abs(logs[1]["joint_pos/hinge"]).max()
    within, said = without_false_stops(logs[1:], robot)
    assert within is robot and not said
    opened, (sentence,) = without_false_stops(logs, robot)
    assert "outside of -3.14 to 3.14, the model's range: replays have no stops there" in sentence
    assert robot.model.jnt_limited[0] and not opened.model.jnt_limited[0]
    assert opened.sha256 != robot.sha256


def test_one_wrong_row_opens_no_range(robot: Robot) -> None:
    (log,) = tumbles([0.5])
    position = log["joint_pos/hinge"].copy()
    position[700] = 9.0
    assert without_false_stops([replace(log, columns={**log.columns, "joint_pos/hinge": position})], robot)[0] is robot


def test_the_check_fails_with_where_the_joint_was(robot: Robot) -> None:
    failed = JointRanges().run(tumbles([4.0, 0.5]), robot, JointRanges.threshold)
    assert failed is not None and not failed.passed and "hinge was logged at" in failed.says
    assert failed.per_log["swing_1"] == 0.0 < failed.per_log["swing_0"]
    passed = JointRanges().run(tumbles([0.5]), robot, JointRanges.threshold)
    assert passed is not None and passed.passed


def test_a_pendulum_that_turns_over_is_diagnosed_beyond_the_range_of_its_file(robot: Robot) -> None:
    """With the stops its replays would end at π, and the whole gap would be theirs."""
    settings = Settings(effects=["joint_damping", "joint_friction", "armature"], best=False, noise_draws=1)
    report: Report = diagnose_logs(tumbles([4.0, 3.0, 0.5, 3.5]), robot, settings)
    assert any("no stops" in note for note in report.content.notes)
    assert report.verdict == "named" and report.answer == (("joint_damping",),)
    assert report.causes[0].parameters["damping"].value == pytest.approx(0.05, rel=0.05)
