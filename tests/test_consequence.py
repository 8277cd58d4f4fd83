"""A policy with and without causes, beside a loop in plain MuJoCo and a robot that cannot stand."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.cli import main
from leapgap.effects.base import Effect
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import write_corrected
from tests import plain_arm

torch = pytest.importorskip("torch")
KP, KD, PERIOD_S, SECONDS = 30.0, 0.5, 0.01, 1.0
GAIN = torch.tensor([[0.3, 0.1, 0.02, 0.0, 0.5, 0.2], [0.0, -0.4, 0.0, 0.03, -0.1, 0.6]])
ALWAYS = torch.tensor([[0.5, -0.3]])
"""A linear policy: actions by position, velocity and the last action, and those at rest."""


class Linear(torch.nn.Module):
    """Actions that follow the observation, and one that stands."""

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """(1, 6) → (1, 2)."""
        return seen @ GAIN.T + ALWAYS


def report(folder: Path, robot: Robot, *causes: Effect) -> Path:
    """A folder with these causes."""
    write_corrected(folder / "report" / "corrected", robot, causes)
    return folder / "report"


def plain_course(xml: str) -> np.ndarray:
    """The same loop by plain MuJoCo: joint positions after each period, (periods, 2)."""
    model = mujoco.MjModel.from_xml_string(xml)
    data, last, course = mujoco.MjData(model), np.zeros(2), []
    for _ in range(round(SECONDS / PERIOD_S)):
        seen = np.concatenate([data.qpos, 0.1 * data.qvel, last])
        last = Linear()(torch.tensor(seen[None], dtype=torch.float32)).numpy()[0].astype(float)
        for _ in range(round(PERIOD_S / model.opt.timestep)):
            data.qfrc_applied[:] = KP * (0.5 * last - data.qpos) - KD * data.qvel
            mujoco.mj_step(model, data)
        course.append(data.qpos.copy())
    return np.array(course)


def write_policy(path: Path) -> Path:
    """The linear policy as TorchScript or, by ``onnx`` alone, as ONNX."""
    if path.suffix != ".onnx":
        torch.jit.trace(Linear(), torch.zeros(1, 6)).save(str(path))
        return path
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    constants = [onnx.numpy_helper.from_array(one.numpy(), name) for one, name in ((GAIN, "gain"), (ALWAYS, "always"))]
    ends = [
        [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, size])]
        for name, size in (("observation", 6), ("action", 2))
    ]
    node = onnx.helper.make_node("Gemm", ["observation", "gain", "always"], ["action"], transB=1)
    graph = onnx.helper.make_graph([node], "policy", *ends, initializer=constants)
    version = [onnx.helper.make_opsetid("", 18)]
    onnx.save(onnx.helper.make_model(graph, opset_imports=version, ir_version=10), str(path))
    return path


def command(folder: Path, policy: Path, map: Path) -> list[str]:
    """Arguments of the command for a report, a policy and its map."""
    return ["consequence", str(folder), "--policy", str(policy), "--map", str(map)]


@pytest.mark.parametrize("file", ["policy.pt", "policy.onnx"])
def test_a_policy_departs_as_it_does_in_plain_mujoco(
    file: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = Robot.load(plain_arm.write_model(tmp_path))
    folder = report(tmp_path, robot, effects.effect("joint_damping", "elbow", damping=0.4))
    policy = write_policy(tmp_path / file)
    terms = [{"of": "joint_pos"}, {"of": "joint_vel", "scale": 0.1}, {"of": "last_action"}]
    stated = {"observation": terms, "kp": KP, "kd": KD, "period_s": PERIOD_S, "seconds": SECONDS, "scale": 0.5}
    (tmp_path / "map.json").write_text(json.dumps(stated))
    arguments = command(folder, policy, tmp_path / "map.json")
    assert main([*arguments, "--json", str(tmp_path / "out.json"), "--quiet"]) == 0
    assert "joint_damping at elbow" in capsys.readouterr().out
    none, damped = json.loads((tmp_path / "out.json").read_text())["courses"]
    assert (none["joints_rad"], none["fell_s"], none["drift_m"]) == (0, None, None)
    apart = plain_course(plain_arm.arm(plain_arm.EXAMPLE.TRUE)) - plain_course(plain_arm.arm())
    expected = np.sqrt((apart**2).mean())
    assert expected > 0.01
    assert damped["joints_rad"] == pytest.approx(expected, rel=0.02)


def test_a_robot_without_torque_falls(tmp_path: Path) -> None:
    """The A1 on soft legs with set points that stand: with three tenths of its torque it goes down."""

    class Stand(torch.nn.Module):
        def forward(self, seen: torch.Tensor) -> torch.Tensor:
            return 0 * seen[:, :12]

    robot = Robot.load()
    folder = report(tmp_path, robot, effects.effect("torque_gain", scale=0.3), effects.effect("payload", mass_kg=0.2))
    torch.jit.trace(Stand(), torch.zeros(1, 15)).save(str(tmp_path / "policy.pt"))
    terms = [{"of": "joint_pos"}, {"of": "gravity"}]
    start = [0, 0, 0.27, 1, 0, 0, 0, *[0, 0.8, -1.6] * 4]
    stated = {"observation": terms, "kp": 10.0, "kd": 0.5, "period_s": 0.01, "seconds": 1.5, "start": start}
    (tmp_path / "map.json").write_text(json.dumps(stated))
    arguments = command(folder, tmp_path / "policy.pt", tmp_path / "map.json")
    assert main([*arguments, "--json", str(tmp_path / "out.json"), "--quiet"]) == 0
    courses = {one["name"]: one for one in json.loads((tmp_path / "out.json").read_text())["courses"]}
    assert list(courses) == ["none of them", "torque_gain", "payload", "all of them"]
    assert courses["none of them"]["fell_s"] is None
    assert courses["payload"]["fell_s"] is None
    assert 0 < courses["payload"]["drift_m"] < 0.05
    assert courses["torque_gain"]["fell_s"] < 1.5
    assert courses["all of them"]["drift_m"] is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"observation": [{"of": "base_height"}]}, "expected one of joint_pos, joint_vel, last_action, values"),
        ({"joints": ["knee"]}, "found knee; expected joints among shoulder, elbow"),
        ({"start": [0.0]}, "found 1 numbers; expected 2 positions"),
        ({"offset": [0.0]}, "found 1 numbers; expected 2, one a joint"),
        ({"kp": "much"}, "expected a value of type float"),
        ({"observation": []}, "observation: found no item"),
        ({"seconds": 0.0}, "found 0 s in periods of 0.02 s; expected one period or more"),
        ({"seconds": float("inf")}, "found inf s in periods of 0.02 s"),
        ({"period_s": 0.0}, "found 10 s in periods of 0 s"),
    ],
)
def test_a_map_that_does_not_fit_is_refused(
    change: dict, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = Robot.load(plain_arm.write_model(tmp_path))
    folder = report(tmp_path, robot, effects.effect("joint_damping", "elbow", damping=0.4))
    torch.jit.trace(Linear(), torch.zeros(1, 6)).save(str(tmp_path / "policy.pt"))
    (tmp_path / "map.json").write_text(
        json.dumps({"observation": [{"of": "joint_pos"}], "kp": 1.0, "kd": 0.0, **change})
    )
    arguments = command(folder, tmp_path / "policy.pt", tmp_path / "map.json")
    assert main([*arguments, "--quiet"]) == 2
    assert message in capsys.readouterr().err
