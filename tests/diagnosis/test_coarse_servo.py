"""A servo that is equal to its model, read by the registers of hobby servos: no cause is found in what these do."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot

SERVO = """
<mujoco model="servo"><compiler angle="radian" autolimits="true"/><option timestep="{step}" integrator="implicitfast"/>
<worldbody><body name="link">
<joint name="servo" axis="0 1 0" range="-2 2" damping="0.5" armature="0.03" frictionloss="0.04"/>
<geom type="capsule" fromto="0 0 0 0.11 0 0" size=".012" mass=".13"/></body></worldbody>
<actuator><position joint="servo" kp="16" forcerange="-3 3"/></actuator></mujoco>"""
TICK = 2 * np.pi / 4096
STEP_S, ROW_S, LATE_ROWS = 0.00025, 0.01, 5


def log_of(seed: int, size: float, seconds: float, coarse: bool) -> Log:
    """Sines by plain MuJoCo in steps of 0.25 ms; positions in ticks and stale rows, or velocities 50 ms late."""
    model = mujoco.MjModel.from_xml_string(SERVO.format(step=STEP_S))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds / ROW_S)) * ROW_S
    phases, rates = rng.uniform(0, 2 * np.pi, 3), rng.uniform(1.5, 7, 3)
    command = size * sum(np.sin(rate * time + phase) - np.sin(phase) for rate, phase in zip(rates, phases, strict=True))
    position, velocity = np.zeros(len(time)), np.zeros(len(time))
    for row, set_point in enumerate(command):
        position[row], velocity[row] = data.qpos[0], data.qvel[0]
        data.ctrl[0] = set_point
        for _ in range(round(ROW_S / STEP_S)):
            mujoco.mj_step(model, data)
    if coarse:
        shown = np.arange(len(time)) // 2 * 2
        position = np.round(np.round(position / TICK) * TICK, 7)[shown]
        velocity = np.round(velocity / 0.024)[shown] * 0.024
    else:
        position = np.round(position, 5)
        velocity = np.concatenate([np.zeros(LATE_ROWS), velocity[:-LATE_ROWS]])
    columns = {"time": time, "joint_pos/servo": position, "joint_vel/servo": velocity, "cmd_pos/servo": command}
    zero = np.zeros(len(time))
    columns |= {"cmd_vel/servo": zero, "cmd_tau/servo": zero, "cmd_kp/servo": zero + 16.0, "cmd_kd/servo": zero}
    return Log(f"run_{seed}", columns, LogInfo("servo", ROW_S, "registers"))


@pytest.mark.parametrize(("size", "coarse"), [(0.02, True), (0.15, False)])
def test_registers_of_a_servo_are_no_cause(size: float, coarse: bool, tmp_path: Path) -> None:
    (tmp_path / "servo.xml").write_text(SERVO.format(step=0.001))
    logs = [log_of(seed, size, 8.0, coarse) for seed in range(3)]
    found = diagnose(logs, Robot.load(tmp_path / "servo.xml"), Settings(best=False))
    assert found.report.verdict == "none", found.report.sentence
    assert not found.report.answer
