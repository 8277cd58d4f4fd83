"""The guide's example data: by MuJoCo alone, the same motion in both forms, of a robot whose model is wrong."""

import ast
import runpy
from pathlib import Path

import mujoco
import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from tests.code import ROOT

SCRIPT = ROOT / "docs" / "examples" / "arm_logs.py"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm")
    runpy.run_path(str(SCRIPT))["main"](path, logs=1)
    return path


@pytest.mark.parametrize("script", sorted(SCRIPT.parent.glob("*.py")), ids=lambda path: path.stem)
def test_the_library_makes_none_of_its_own_example_data(script: Path) -> None:
    nodes = list(ast.walk(ast.parse(script.read_text(encoding="utf-8"))))
    imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    plain = {"json", "sys", "pathlib", "mujoco", "numpy", "pyarrow"}
    assert {name.split(".")[0] for name in imported} - {"importlib"} == plain


def test_servos_hold_where_their_true_gain_and_weight_agree(tmp_path: Path) -> None:
    """Where the servo arm rests, torque kp (action − angle) bears its weight, up to the friction of its joints."""
    servo = runpy.run_path(str(SCRIPT.with_name("servo_arm_logs.py")))
    model = mujoco.MjModel.from_xml_string(servo["MODEL"].format(**servo["TRUE"]))
    data = mujoco.MjData(model)
    action, measured = map(np.radians, servo["episode"](0))
    still = [i for i in range(5, len(action)) if not np.ptp(action[i - 4 : i + 1], axis=0).any()]
    still = [i for i in still if np.ptp(measured[i - 4 : i + 1], axis=0).max() < 2e-3]
    assert len(still) > 20
    for i in still:
        data.qpos[:] = measured[i]
        mujoco.mj_forward(model, data)
        torque = servo["TRUE"]["kp"] * (action[i] - measured[i])
        assert np.abs(torque - data.qfrc_bias).max() < servo["TRUE"]["friction"] + 0.05


def test_csv_in_degrees_and_parquet_in_radians_hold_one_motion(folder: Path) -> None:
    ours, theirs = pq.read_table(folder / "logs/swing_0.parquet"), pyarrow.csv.read_csv(folder / "measured/swing_0.csv")
    for column, other in (("joint_pos", "q"), ("joint_vel", "dq"), ("cmd_pos", "q_set"), ("cmd_vel", "dq_set")):
        degrees = theirs[f"{other}_elbow"].to_numpy()
        np.testing.assert_allclose(np.radians(degrees), ours[f"{column}/elbow"].to_numpy(), rtol=1e-12, atol=1e-15)


def test_logs_are_of_an_elbow_with_0_45_of_damping_where_the_model_states_0_05(folder: Path) -> None:
    """Torque balance at the elbow: what inertia and gravity leave of the joint PD's torque is damping times speed."""
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    data, table = mujoco.MjData(model), pq.read_table(folder / "logs/swing_0.parquet")
    assert model.joint("elbow").damping[0] == 0.05
    joints = ("shoulder", "elbow")
    columns = {
        name: np.stack([table[f"{name}/{joint}"].to_numpy() for joint in joints], axis=1)
        for name in ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    }
    position, velocity = columns["joint_pos"], columns["joint_vel"]
    torque = columns["cmd_kp"] * (columns["cmd_pos"] - position) + columns["cmd_kd"] * (columns["cmd_vel"] - velocity)
    box = np.ones(41) / 41  # rows, against the noise of the speeds
    smooth = np.stack([np.convolve(velocity[:, i], box, "same") for i in range(2)], axis=1)
    acceleration = np.gradient(smooth, 0.001, axis=0)
    lost, speed = [], []
    for row in range(100, len(position) - 100, 10):
        data.qpos[:], data.qvel[:], data.qacc[:] = position[row], smooth[row], acceleration[row]
        mujoco.mj_inverse(model, data)  # with the damping of the model, which is taken off
        lost.append(torque[row, 1] - (data.qfrc_inverse[1] - 0.05 * smooth[row, 1]))
        speed.append(smooth[row, 1])
    assert np.polyfit(speed, lost, 1)[0] == pytest.approx(0.45, abs=0.03)
