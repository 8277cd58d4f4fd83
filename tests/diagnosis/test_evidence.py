"""Numbers of a robot without a simulation: an A1 of other numbers than its file, by plain MuJoCo and a PD by hand."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.evidence import gather
from leapgap.diagnosis.evidence.base import Evidence
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.metadata import Segment
from leapgap.robot.model import Robot
from tests.plain_simulation import BASE, BASE_RATES

COM_X, HIPS_X, INERTIA = 0.02, 0.005, 1.4
"""How much further forward the trunk's centre of mass is than the file says, how much wider apart the hips, m, and how
much harder the trunk turns than the file says."""
STEP_S = 0.001
CROUCH = np.array([0.0, 0.9, -1.8] * 4)


@pytest.fixture(scope="module")
def true_model(robot: Robot) -> mujoco.MjModel:
    """The robot's file with other numbers."""
    text = Path(robot.path).read_text()
    text = text.replace('<inertial pos="0 0.0041', f'<inertial pos="{COM_X} 0.0041')
    text = text.replace('pos="0.183 ', f'pos="{0.183 + HIPS_X} ').replace('pos="-0.183 ', f'pos="{-0.183 - HIPS_X} ')
    model = mujoco.MjModel.from_xml_string(text)
    model.body_inertia[1] *= INERTIA
    return model


def log_of(
    model: mujoco.MjModel,
    robot: Robot,
    name: str,
    start: np.ndarray,
    speed: np.ndarray,
    steps: int,
    swings: float = 1.0,
) -> Log:
    """A log of the robot from a state, while its joints are asked to swing about the crouch.

    ``swings``: how far, over a gentle usual swing.
    """
    data, rng = mujoco.MjData(model), np.random.default_rng(len(name) + steps)
    data.qpos[:], data.qvel[:] = start, speed
    size, rate, phase = rng.uniform(0.06, 0.12, 4), rng.uniform(0.7, 1.1), rng.uniform(0, 6, 4)
    feet = [model.geom(foot).id for foot in robot.feet]
    rows = []
    for step in range(steps):
        swing = np.repeat(size[:2], 2) * np.sin(2 * np.pi * rate * step * STEP_S + np.repeat(phase[:2], 2))
        swing *= swings * min(1.0, step * STEP_S)  # gently, so that feet which stand keep standing
        wanted = CROUCH + np.column_stack([0 * swing, swing, -2 * swing]).ravel()
        mujoco.mj_forward(model, data)
        force, each = np.zeros(4), np.zeros(6)
        for number, contact in enumerate(data.contact):
            for foot in set(feet) & {int(contact.geom1), int(contact.geom2)}:
                mujoco.mj_contactForce(model, data, number, each)
                force[feet.index(foot)] += each[0]
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        rows.append(np.concatenate([data.qpos, data.qvel, force]))
        data.qfrc_applied[6:] = 300 * (wanted - data.qpos[7:]) - 3 * data.qvel[6:]
        mujoco.mj_step(model, data)
    table = np.array(rows)
    columns = {"time": STEP_S * np.arange(steps)}
    columns |= dict(zip((*BASE, *BASE_RATES), np.column_stack([table[:, :7], table[:, 19:25]]).T, strict=True))
    for i, joint in enumerate(robot.joints):
        columns |= {f"joint_pos/{joint}": table[:, 7 + i], f"joint_vel/{joint}": table[:, 25 + i]}
        columns |= {f"{c}/{joint}": np.zeros(steps) for c in ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}
    columns |= {f"foot_force/{foot}": table[:, 37 + i] for i, foot in enumerate(robot.feet)}
    columns |= {f"contact/{foot}": (table[:, 37 + i] > 0).astype(float) for i, foot in enumerate(robot.feet)}
    info = LogInfo(robot.name, STEP_S, "plain MuJoCo", stated_segments=(Segment("all", 0.0, np.inf),))
    return Log(name, {key: np.ascontiguousarray(value) for key, value in columns.items()}, info)


def logs_that_stand(model: mujoco.MjModel, robot: Robot, number: int, steps: int, swings: float = 1.0) -> list[Log]:
    """Logs of the robot on its feet."""
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([[0, 0, 0, 1, 0, 0, 0], CROUCH])
    mujoco.mj_forward(model, data)
    start = data.qpos.copy()
    start[2] = 0.02 - min(data.geom(foot).xpos[2] for foot in robot.feet)
    return [log_of(model, robot, f"stands_{k}", start, np.zeros(18), steps + k, swings) for k in range(number)]


def log_of_throw(model: mujoco.MjModel, robot: Robot, number: int, turn: float, swings: float = 1.0) -> Log:
    """A log of the robot in the air, thrown so that it pitches by ``turn``, rad/s."""
    start = np.concatenate([[0, 0, 2.0, 1, 0, 0, 0], CROUCH])
    speed = np.concatenate([[1.0, 0, 1.5], [0, turn, 0], np.zeros(12)])
    return log_of(model, robot, f"thrown_{number}", start, speed, 450, swings)


def told(logs: list[Log], robot: Robot) -> dict[str, Evidence]:
    """The evidence of some logs, by quantity."""
    return {one.quantity: one for one in gather(logs, robot)}


def test_flights_tell_gravity_and_the_centre_of_mass(robot: Robot, true_model: mujoco.MjModel) -> None:
    rng = np.random.default_rng(0)
    found = told([log_of_throw(true_model, robot, k, rng.uniform(-5, 5)) for k in range(4)], robot)
    assert found["gravity"].value == pytest.approx(9.81, abs=0.01)
    assert found["com_offset.x_m"].value == pytest.approx(COM_X, abs=0.001)
    assert found["com_offset.z_m"].value == pytest.approx(0.0, abs=0.001)


def test_flights_that_no_common_centre_of_mass_explains_say_nothing(robot: Robot) -> None:
    """Each throw carries its load elsewhere: no offset is sure, and without one no flight is a parabola."""
    logs = []
    for k, x in enumerate((-0.15, 0.15, -0.14, 0.14)):
        model = mujoco.MjModel.from_xml_path(str(robot.path))
        model.body_ipos[1, 0] += x
        logs.append(log_of_throw(model, robot, k, 5.0))
    assert told(logs, robot) == {}


def test_legs_that_swing_in_the_air_tell_how_hard_the_trunk_turns(robot: Robot, true_model: mujoco.MjModel) -> None:
    """Where the hips are is told by logs that stand, and where the trunk's centre of mass is by the flights."""
    rng, logs = np.random.default_rng(1), logs_that_stand(true_model, robot, 4, 2000)
    logs += [log_of_throw(true_model, robot, k, rng.uniform(-3, 3), swings=10.0) for k in range(4)]
    found = told(logs, robot)
    assert found["trunk_inertia.scale"].value == pytest.approx(INERTIA, rel=0.03)
    assert found["trunk_inertia.scale"].spread < 0.05


def test_feet_that_stand_tell_how_the_legs_are_made(robot: Robot, true_model: mujoco.MjModel) -> None:
    found = told(logs_that_stand(true_model, robot, 4, 2000), robot)
    assert found["leg_geometry.hip_x_m"].value == pytest.approx(HIPS_X, abs=0.0015)
    assert found["leg_geometry.hip_x_m"].spread < 0.002


@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_feet_that_stand_still_tell_the_mass_unless_their_forces_are_not_in_newtons(robot: Robot, scale: float) -> None:
    heavier = mujoco.MjModel.from_xml_path(str(robot.path))
    heavier.body_mass[1] += 1.5
    mujoco.mj_setConst(heavier, mujoco.MjData(heavier))
    logs = []
    for log in logs_that_stand(heavier, robot, 3, 1000, swings=0.0):
        forces = {name: scale * v for name, v in log.columns.items() if name.startswith("foot_force")}
        logs.append(Log(log.name, log.columns | forces, log.info))
    found = told(logs, robot)
    if scale == 1.0:
        assert found["payload.mass_kg"].value == pytest.approx(1.5, abs=0.1)
        assert not found["payload.mass_kg"].held
    else:
        assert "payload.mass_kg" not in found
        assert found["weight_borne"].says.endswith("their forces are not in newtons, so they do not show its mass")


def test_logs_without_a_base_say_nothing(robot: Robot, true_model: mujoco.MjModel) -> None:
    start = np.concatenate([[0, 0, 2.0, 1, 0, 0, 0], CROUCH])
    log = log_of(true_model, robot, "thrown", start, np.zeros(18), 300)
    blind = Log("blind", {name: v for name, v in log.columns.items() if not name.startswith("base_pos")}, log.info)
    assert told([blind] * 4, robot) == {}
