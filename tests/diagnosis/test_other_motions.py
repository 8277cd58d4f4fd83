"""Logs of other robots and motions, by plain MuJoCo: uneven clocks, different rates, chaotic motions."""

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.checks import run_checks
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.gap import candidate_squares, headline_gap
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer

ACROBOT = """<mujoco model="acrobot">
  <option timestep="0.0005"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.002"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" axis="0 1 0" damping="0.002" frictionloss="{friction}"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.4" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="elbow" ctrlrange="-6 6"/></actuator>
</mujoco>
"""
STEP_S = 0.0005


def swing(seed: int, steps: np.ndarray, friction: float, kp: float = 0.0, kd: float = 0.0) -> Log:
    """One log whose rows last so many simulation steps each; the elbow follows sines by torque and a PD by hand."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(ACROBOT.format(friction=friction))
    data = mujoco.MjData(model)
    data.qpos[:] = rng.uniform(-0.3, 0.3, 2)
    time = np.concatenate([[0], np.cumsum(steps)[:-1]]) * STEP_S
    size, rate, phase = rng.uniform([0.3, 0.5, 0], [0.6, 1.5, 6])
    wanted = size * np.sin(2 * np.pi * rate * time + phase)
    if kp:  # the PD begins without a jerk
        data.qpos[1], data.qvel[1] = wanted[0], size * 2 * np.pi * rate * np.cos(phase)
    push = (2.0 if kp == 0 else 0.0) * np.sin(2 * np.pi * rate * time + phase)
    qpos, qvel = np.empty((len(time), 2)), np.empty((len(time), 2))
    for row, number in enumerate(steps):
        qpos[row], qvel[row] = data.qpos, data.qvel
        for _ in range(number):
            data.qfrc_applied[1] = push[row] + kp * (wanted[row] - data.qpos[1]) - kd * data.qvel[1]
            mujoco.mj_step(model, data)
    noise = rng.standard_normal((len(time), 4)) * [2e-4, 2e-4, 5e-3, 5e-3]
    columns = {"time": time}
    for i, joint in enumerate(("shoulder", "elbow")):
        columns |= {f"joint_pos/{joint}": qpos[:, i] + noise[:, i], f"joint_vel/{joint}": qvel[:, i] + noise[:, 2 + i]}
    sent = {"tau": push, "pos": wanted, "vel": 0 * wanted, "kp": kp + 0 * wanted, "kd": kd + 0 * wanted}
    columns |= {f"cmd_{quantity}/elbow": values for quantity, values in sent.items()}
    period = float(time[-1] / (len(time) - 1))
    return Log(f"swing_{seed}", columns, LogInfo("acrobot", period, "plain MuJoCo"))


def even(rate_hz: int, seconds: float) -> np.ndarray:
    """Rows of equal length."""
    return np.full(round(seconds * rate_hz), round(1 / rate_hz / STEP_S))


def uneven(seed: int, rows: int) -> np.ndarray:
    """Rows of 8 to 13 ms, most of them of 10 ms, as a real arm's logger wrote them."""
    rng = np.random.default_rng(seed)
    return rng.choice([16, 20, 20, 20, 22, 26], rows)


@pytest.fixture(scope="module")
def acrobot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("acrobot") / "acrobot.xml"
    path.write_text(ACROBOT.format(friction=0.0))
    return Robot.load(path)


def gap(logs: list[Log], robot: Robot) -> float:
    judged = JudgedLogs.of(logs, robot)
    return headline_gap(candidate_squares(judged, Replayer(robot), [[()] * len(logs)])[0], judged)


SETTINGS = Settings(
    effects=["joint_friction", "joint_damping", "torque_gain", "armature", "command_delay", "sample_period"],
    folds=3,
    bootstrap_draws=100,
    best=False,
)


def test_uneven_rows_are_replayed_on_their_own_instants(acrobot: Robot) -> None:
    """Nothing is wrong with the robot: the gap stays small, and no clock is blamed. By a mean period it is not."""
    logs = [swing(seed, uneven(seed, 300), 0.0, kp=20.0, kd=0.3) for seed in range(3)]
    right = gap(logs, acrobot)
    assert right < 0.1
    mean = [
        Log(log.name, dict(log.columns) | {"time": np.arange(300) * log.info.sample_period_s}, log.info) for log in logs
    ]
    assert gap(mean, acrobot) > 5 * right
    found = diagnose(logs, acrobot, SETTINGS)
    assert found.report.verdict == "none", found.report.sentence
    assert all(check.passed for check in found.report.checks), [check.says for check in found.report.checks]


def test_an_uneven_clock_is_told_by_the_checks_only_where_times_are_wrong(acrobot: Robot) -> None:
    logs = [swing(seed, uneven(seed, 300), 0.0, kp=20.0, kd=0.3) for seed in range(3)]
    assert all(check.passed for check in run_checks(logs, acrobot, {}))


@pytest.mark.long
def test_logs_of_different_rates_are_diagnosed_together(acrobot: Robot) -> None:
    logs = [swing(seed, even(rate, 3.0), 0.08, kp=20.0, kd=0.3) for seed, rate in enumerate((500, 200, 1000, 500))]
    found = diagnose(logs, acrobot, SETTINGS)
    assert found.report.answer == (("joint_friction",),), found.report.sentence
    assert found.report.causes[0].parameters["torque_nm"].value == pytest.approx(0.08, rel=0.1)


@pytest.mark.long
def test_a_torque_driven_pendulum_is_judged_over_the_time_it_can_be_foretold(acrobot: Robot) -> None:
    """Without a PD the pendulum's whole motion is chaotic; within the horizon its friction is found."""
    logs = [swing(seed, even(500, 8.0), 0.08) for seed in range(4)]
    found = diagnose(logs, acrobot, SETTINGS)
    assert found.report.headline.horizon_s in (0.1, 0.3, 1.0)
    assert found.report.answer == (("joint_friction",),), found.report.sentence
    assert found.report.causes[0].location in ("elbow", "all")
    assert found.report.causes[0].parameters["torque_nm"].value == pytest.approx(0.08, rel=0.1)
    assert found.report.closure_of_answer.value > 0.5


def without_velocities(log: Log) -> Log:
    """The log of a robot whose driver reports angles alone."""
    kept = {name: values for name, values in log.columns.items() if not name.startswith("joint_vel/")}
    return Log(log.name, kept, log.info)


def test_missing_velocities_do_not_start_replays_at_rest(acrobot: Robot) -> None:
    """Nothing is wrong with the robot; with starts at rest its short replays are off by its speed."""
    logs = [without_velocities(swing(seed, even(500, 3.0), 0.0, kp=20.0, kd=0.3)) for seed in range(3)]
    found = diagnose(logs, acrobot, SETTINGS)
    assert found.report.verdict == "none", found.report.sentence
    assert any("joint_vel" in line and "fit" in line for line in found.report.not_judged)


@pytest.mark.long
def test_friction_is_found_without_velocities(acrobot: Robot) -> None:
    logs = [without_velocities(swing(seed, even(500, 3.0), 0.08, kp=20.0, kd=0.3)) for seed in range(4)]
    found = diagnose(logs, acrobot, SETTINGS)
    assert found.report.answer == (("joint_friction",),), found.report.sentence
    assert found.report.causes[0].parameters["torque_nm"].value == pytest.approx(0.08, rel=0.1)


def test_velocities_that_an_importer_computed_are_not_judged(acrobot: Robot) -> None:
    log = swing(0, even(500, 3.0), 0.0, kp=20.0, kd=0.3)
    derived = LogInfo("acrobot", log.info.sample_period_s, "a test", extra={"derived": {"joint_vel": "a fit"}})
    judged = JudgedLogs.of([Log(log.name, log.columns, derived)], acrobot)
    assert {channel.quantity for channel in judged.channels} == {"joint_pos"}
