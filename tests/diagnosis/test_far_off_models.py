"""A double pendulum whose file has inertias about the joints where the format asks for those about the mass centres.

Plain MuJoCo swings it by torques, and then it rests. Beside what is looked for its drives have a cogging torque.
"""

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.engine.intervals import Intervals
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer

JOINTS = ("upper", "lower")
PENDULUM = """
<mujoco model="pendulum">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 1"><joint name="upper" axis="0 1 0" damping="0.002" frictionloss="0.05" armature="{rotor}"/>
      <inertial pos="0 0 -0.2" mass="0.5" diaginertia="{upper} {upper} {upper}"/>
      <body pos="0 0 -0.25"><joint name="lower" axis="0 1 0" damping="0.002" frictionloss="0.05" armature="{rotor}"/>
        <inertial pos="0 0 -0.2" mass="0.6" diaginertia="{lower} {lower} {lower}"/>
  </body></body></worldbody>
  <actuator><motor joint="upper" ctrlrange="-9 9"/><motor joint="lower" ctrlrange="-9 9"/></actuator>
</mujoco>"""
FILE, TRUE = {"upper": 0.03, "lower": 0.05, "rotor": 1e-4}, {"upper": 0.0045, "lower": 0.0075, "rotor": 0.0081}
PERIOD_S, MOVES_S, RESTS_S, COGGING = 0.002, 4.0, 8.0, 0.03


def swings(seed: int) -> Log:
    """Torques that swing the pendulum for some seconds; then a joint PD of the controller's own brings it to rest."""
    rng, steps = np.random.default_rng(seed), 4
    model = mujoco.MjModel.from_xml_string(PENDULUM.format(**TRUE))
    model.opt.timestep = PERIOD_S / steps
    data, rows = mujoco.MjData(model), round((MOVES_S + RESTS_S) / PERIOD_S)
    rates, phases, state, torque = (
        rng.uniform(0.5, 1.5, 2),
        rng.uniform(0, 6, 2),
        np.empty((rows, 4)),
        np.zeros((rows, 2)),
    )
    for row in range(rows):
        state[row] = *data.qpos, *data.qvel
        now = row * PERIOD_S
        torque[row] = -0.2 * data.qvel - 0.3 * data.qpos if now > MOVES_S else np.sin(2 * np.pi * rates * now + phases)
        for _ in range(steps):
            data.ctrl[:] = torque[row] + COGGING * np.sin(24 * data.qpos)
            mujoco.mj_step(model, data)
    state[:, :2] += 1e-4 * rng.standard_normal((rows, 2))
    state[:, 2:] += 0.01 * rng.standard_normal((rows, 2))
    columns = {"time": np.arange(rows) * PERIOD_S}
    for k, joint in enumerate(JOINTS):
        columns |= {f"joint_pos/{joint}": state[:, k], f"joint_vel/{joint}": state[:, 2 + k]}
        columns |= {f"cmd_{name}/{joint}": np.zeros(rows) for name in ("pos", "vel", "kp", "kd")}
        columns[f"cmd_tau/{joint}"] = torque[:, k]
    return Log(f"swing_{seed}", columns, LogInfo("pendulum", PERIOD_S, "a test"))


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("model") / "pendulum.xml"
    path.write_text(PENDULUM.format(**FILE))
    return Robot.load(path)


def test_the_parts_of_a_log_that_are_judged_are_those_in_which_the_robot_moves(robot: Robot) -> None:
    judged = JudgedLogs.of([swings(seed) for seed in range(2)], robot, {})
    intervals = Intervals.of(judged.states, Replayer(robot, 1, 1), 0.01)
    begins = np.concatenate([own.states.log.time[own.rows[own.begins]] for own in intervals.courses])
    assert (begins < MOVES_S + 1).mean() > 0.75


@pytest.mark.long
def test_inertias_seven_times_too_large_and_rotors_are_named(robot: Robot) -> None:
    logs = [swings(seed) for seed in range(3)]
    looked = (
        "link_inertia",
        "armature",
        "joint_friction",
        "joint_damping",
        "torque_gain",
        "link_mass",
        "torque_offset",
    )
    report = diagnose(logs, robot, Settings(effects=looked, best=False)).report
    assert report.verdict in ("partly", "named")
    assert ("link_inertia",) in report.answer and ("armature",) in report.answer, report.answer
    numbers = {cause.effect: next(iter(cause.parameters.values())).value for cause in report.causes}
    assert numbers["link_inertia"] == pytest.approx(0.15, abs=0.1)
    assert numbers["armature"] == pytest.approx(0.008, rel=0.3)
