"""Links whose mass centre lies on the axis of their joint, simple bodies for MuJoCo, may change like others.

Beside plain MuJoCo, which compiles the changed link from its file.
"""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.effects.model_field import ModelField, effect_class
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import read_corrected, write_corrected
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

HORN = """<mujoco model="horn"><option timestep="0.001"/><worldbody>
  <body name="case"><geom type="box" size="0.02 0.02 0.03" mass="0.15"/>
    <body name="horn" {simple}><joint name="servo" axis="0 1 0" armature="0.001"/>
      <inertial pos="{com}" mass="{mass}" diaginertia="{inertia}"/></body></body></worldbody>
  <actuator><general joint="servo" biastype="affine" forcerange="-9 9"/></actuator></mujoco>"""
AS_IT_IS = {"com": "0 0 0", "mass": 0.1, "inertia": "2e-4 3e-4 4e-4"}
CHANGES = [
    (effects.effect("link_com", outward_m=0.05), {"com": "0.05 0 0"}),
    (effects.effect("link_inertia", scale=3.0), {"inertia": "6e-4 9e-4 12e-4"}),
    (effects.effect("leg_mass", scale=1.6), {"mass": 0.16, "inertia": "3.2e-4 4.8e-4 6.4e-4"}),
    (effects.effect("link_payload", mass_kg=0.1, moment_kg_m=0.0), {"mass": 0.2}),
    (effect_class(ModelField("body_ipos", -0.1, 0.1, "horn"))(value=0.04), {"com": "0.04 0 0"}),
]
"""An effect, and what it makes of the file; the horn's outward axis is its x axis."""
ROWS, KP, KD = 400, 2.0, 0.05
WANTED = 0.8 * np.sin(0.02 * np.arange(ROWS))


def horn(**own: object) -> str:
    return HORN.format(**{"simple": ""} | AS_IT_IS | own)


def swing(**own: object) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of the horn (rows,) under a joint PD written here, by ``mj_step``."""
    model = mujoco.MjModel.from_xml_string(horn(**own))
    data, rows = mujoco.MjData(model), []
    for row in range(ROWS):
        rows.append((data.qpos[0], data.qvel[0]))
        data.qfrc_applied[0] = KP * (WANTED[row] - data.qpos[0]) - KD * data.qvel[0]
        mujoco.mj_step(model, data)
    position, velocity = np.array(rows).T
    return position, velocity


def log_of(position: np.ndarray, velocity: np.ndarray) -> Log:
    columns = {"time": 0.001 * np.arange(ROWS), "joint_pos/servo": position, "joint_vel/servo": velocity}
    columns |= {"cmd_pos/servo": WANTED, "cmd_vel/servo": 0 * WANTED, "cmd_tau/servo": 0 * WANTED}
    columns |= {"cmd_kp/servo": 0 * WANTED + KP, "cmd_kd/servo": 0 * WANTED + KD}
    columns = {name: np.ascontiguousarray(values) for name, values in columns.items()}
    return Log("horn", columns, LogInfo("horn", 0.001, "plain MuJoCo"))


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    (tmp_path / "horn.xml").write_text(horn())
    return Robot.load(tmp_path / "horn.xml")


def test_mujoco_takes_the_horn_for_a_simple_body() -> None:
    assert mujoco.MjModel.from_xml_string(horn()).body_simple[2]


@pytest.mark.parametrize(("effect", "own"), CHANGES, ids=lambda one: getattr(one, "name", None))
def test_a_link_on_its_axis_changes_as_its_file_would(effect: effects.Effect, own: dict, robot: Robot) -> None:
    plain = swing(**own)
    found = Replayer(robot).motions([Rollout(log_of(*plain), (effect,))])[0].qpos[:, 0]
    nominal = Replayer(robot).motions([Rollout(log_of(*plain))])[0].qpos[:, 0]
    if effect.name != "link_payload":  # a mass at the axis is not felt
        assert np.abs(nominal - plain[0]).max() > 1e-3
    assert np.abs(found - plain[0]).max() < 1e-9


@pytest.mark.parametrize(("effect", "own"), CHANGES[:4], ids=lambda one: getattr(one, "name", None))
def test_a_corrected_file_holds_the_changed_link(
    effect: effects.Effect, own: dict, robot: Robot, tmp_path: Path
) -> None:
    write_corrected(tmp_path / "corrected", robot, (effect,))
    assert "simple=" not in (tmp_path / "corrected" / "robot.xml").read_text()
    changed = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected" / "robot.xml"))
    expected = mujoco.MjModel.from_xml_string(horn(**own))
    for field in ("body_mass", "body_ipos", "body_inertia"):
        assert getattr(changed, field) == pytest.approx(getattr(expected, field), abs=1e-12)
    assert read_corrected(tmp_path / "corrected")[1] == (effect,)


CUBE = """<mujoco model="cube"><option timestep="0.001"/><worldbody>
  <body name="cube" pos="0 0 5"><freejoint/>{}</body>
  <body pos="3 0 1"><joint name="a" axis="0 1 0"/><geom size="0.05" mass="1"/></body></worldbody>
  <actuator><motor joint="a"/></actuator></mujoco>"""
BOX = '<geom type="box" size="0.05 0.05 0.05" mass="{}"/>'


@pytest.mark.parametrize(
    ("effect", "mass", "com", "inertia"),
    [
        (effects.effect("com_offset", x_m=0.02, z_m=-0.01), 0.4, (0.02, 0.0, -0.01), 1.0),
        (effects.effect("payload", mass_kg=0.2), 0.6, (0.0, 0.0, 0.0), 1.0),
        (effects.effect("trunk_inertia", scale=2.0), 0.4, (0.0, 0.0, 0.0), 2.0),
    ],
    ids=lambda one: getattr(one, "name", None),
)
def test_a_free_box_changes_as_its_file_would(
    effect: effects.Effect, mass: float, com: tuple[float, ...], inertia: float, tmp_path: Path
) -> None:
    """It spins about a centre that is elsewhere, so that its frame's origin moves on a circle."""
    (tmp_path / "cube.xml").write_text(CUBE.format(BOX.format(0.4)))
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "cube.xml")).body_simple[1]
    robot = Robot.load(tmp_path / "cube.xml")
    model = Replayer(robot).model(Rollout(replace(log_of(WANTED, WANTED), columns=columns_of_cube()), (effect,)))
    about = 0.4 * 2 * 0.05**2 * 2 / 6 * inertia
    numbers = f'pos="{com[0]} {com[1]} {com[2]}" mass="{mass}" diaginertia="{about} {about} {about}"'
    plain = mujoco.MjModel.from_xml_string(CUBE.format(f"<inertial {numbers}/>"))
    moved = []
    for own in (model, plain):
        data = mujoco.MjData(own)
        data.qvel[:6] = 0.1, 0.2, 0.3, 2.0, 3.0, 1.0
        for _ in range(300):
            mujoco.mj_step(own, data)
        moved.append(data.qpos[:7].copy())
    assert moved[0] == pytest.approx(moved[1], abs=1e-9)


def columns_of_cube() -> dict[str, np.ndarray]:
    names = (f"{name}/a" for name in ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"))
    return dict.fromkeys(names, np.zeros(2)) | {"time": np.array([0.0, 0.001])}
