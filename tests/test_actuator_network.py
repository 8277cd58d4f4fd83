"""Actuator networks, on logs of an arm with dry friction that plain MuJoCo made."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from leapgap import effects
from leapgap.cli import main
from leapgap.errors import InputError
from leapgap.learning.actuator_network import actuator_logs
from leapgap.logs.log import read_logs
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import write_corrected
from tests import plain_arm
from tests.export.schemas import LEARNED, record

pytest.importorskip("onnx")
torch = pytest.importorskip("torch")
onnxruntime = pytest.importorskip("onnxruntime")
STICKY = plain_arm.arm('damping="0.05" frictionloss="0.6"')


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """The command's output beside a report that names the friction."""
    folder = tmp_path_factory.mktemp("net")
    model, logs = plain_arm.write_model(folder), plain_arm.write_parquet(folder / "logs", 3, STICKY)
    robot = Robot.load(model)
    cause = effects.effect("joint_friction", "elbow", torque_nm=0.6)
    write_corrected(folder / "report" / "corrected", robot, (cause,))
    arguments = [str(logs), str(model), "--out", str(folder / "net"), "--report", str(folder / "report"), "--quiet"]
    assert main(["actuator-net", *arguments]) == 0
    return SimpleNamespace(net=folder / "net", logs=read_logs(logs), robot=robot, folder=folder)


def config_of(file: Path, module: str, name: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The configurations of a written file, by a stand-in for the library that takes its documented fields alone."""
    stand_in = ModuleType(module)
    setattr(stand_in, name, record(name, LEARNED[name]))
    monkeypatch.setitem(sys.modules, module.partition(".")[0], ModuleType(module.partition(".")[0]))
    monkeypatch.setitem(sys.modules, module, stand_in)
    return dict(runpy.run_path(str(file))["ACTUATORS"])


@pytest.mark.long
def test_a_network_in_the_convention_of_mjlab_feels_the_friction(
    trained: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `LearnedMlpActuator` runs it: errors of the set point, newest first, then velocities, each times its scale.

    The torque that the arm's elbow felt beside its own damping is that of its PD and the friction of 0.6 N·m.
    """
    cfg = config_of(trained.net / "for_mjlab.py", "mjlab.actuator", "LearnedMlpActuatorCfg", monkeypatch)["elbow"]
    network, log = torch.jit.load(cfg.network_file), trained.logs[0]
    assert cfg.input_order == "pos_vel"
    assert cfg.frictionloss == 0.0
    rows = np.arange(100, 1900, 5)
    error = log["cmd_pos/elbow"] - log["joint_pos/elbow"]
    columns = [error[rows - 5 * lag] * cfg.pos_scale for lag in range(cfg.history_length)]
    columns += [log["joint_vel/elbow"][rows - 5 * lag] * cfg.vel_scale for lag in range(cfg.history_length)]
    inputs = torch.tensor(np.stack(columns, axis=1), dtype=torch.float32)
    torque = network(inputs).detach().numpy()[:, 0] * cfg.torque_scale
    velocity = log["joint_vel/elbow"][rows]
    joint_pd = plain_arm.KP * error[rows] + plain_arm.KD * (log["cmd_vel/elbow"][rows] - velocity)
    moving = np.abs(velocity) > 0.3
    felt = (torque - joint_pd)[moving] * np.sign(velocity[moving])
    assert felt.mean() == pytest.approx(-0.6, abs=0.15)
    session = onnxruntime.InferenceSession(str(trained.net / "elbow.onnx"))
    (of_onnx,) = session.run(None, {"input": inputs.numpy()})
    assert of_onnx[:, 0] * cfg.torque_scale == pytest.approx(torque, abs=1e-4)


@pytest.mark.long
def test_errors_stand_beside_those_of_the_named_cause(
    trained: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    import json

    groups = json.loads((trained.net / "errors.json").read_text())["groups"]
    elbow = groups["elbow"]
    assert elbow["joint_pd"] == pytest.approx(0.6, rel=0.15)
    assert elbow["named_causes"] < 0.5 * elbow["joint_pd"]
    assert elbow["network"] < elbow["torque"]
    cfg = config_of(trained.net / "for_isaac_lab.py", "isaaclab.actuators", "ActuatorNetMLPCfg", monkeypatch)["elbow"]
    assert cfg.joint_names_expr == ["elbow"]
    assert cfg.input_idx == [0, 1, 2]
    assert Path(cfg.network_file).is_file()


def test_one_log_and_a_senseless_step_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, logs = plain_arm.write_model(tmp_path), plain_arm.write_parquet(tmp_path / "logs", 1)
    arguments = ["actuator-net", str(logs), str(model), "--out", str(tmp_path / "net"), "--quiet"]
    assert main(arguments) == 2
    assert "found 1 log; expected two or more" in capsys.readouterr().err
    assert main([*arguments, "--step", "9"]) == 2
    assert not (tmp_path / "net").exists()


def test_logs_that_are_shorter_than_the_windows_at_their_ends_are_refused(tmp_path: Path) -> None:
    robot, logs = Robot.load(plain_arm.write_model(tmp_path)), read_logs(plain_arm.write_parquet(tmp_path / "logs", 2))
    with pytest.raises(InputError, match=r"swing_0: found 50 rows of 0\.001 s; expected more than 0\.06 s"):
        actuator_logs([log.first_rows(50) for log in logs], robot, 0.005)
